# SPDX-License-Identifier: GPL-3.0-or-later
"""Begins a segment of a long capture from the one before: what stands still there is taken over and held, and the rest is trained.

freeze_still() makes Gaussians of a trained segment that hardly move stand still exactly.  The next segment takes them as they are, number
for number, so that no still pixel flickers where segments change over, and a file keeps them once (run/segments.py).
"""
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ...captures.capture import Capture, Shot, by_view
from ...captures.pixels.store import Pixels
from ...model.appearance import Features
from ...model.gaussians import GaussianModel
from ...model.joining import FLAT
from ...model.slicing import positions_at, quaternions_at, sigmoid, slice_model
from ...model.temporal import Radial
from ...util import rotations
from ..core.moving_pixels import LOOKS, MovingPixels
from ..core.settings import Settings
from ..core.start import Start
from ..core.targets import use_of_mask
from . import starting_points
from .dense import spread
from .first_model import depth_of, model_from_points
from .geometry import project, sample, visible

SAMPLES = 9
"""Times of a segment at which its Gaussians are looked at."""
MOVED, FADED = 3.0, 0.5
"""Pixels in the nearest camera, and the share of its opacity, by which a Gaussian may change that films show at rest: so much is noise."""
MOVED_LITTLE, FADED_LITTLE = 1.5, 0.25
"""The same for a Gaussian behind what moves."""
CALM = 0.25
"""Share of the cameras that see a Gaussian in whose films nothing moves there: others may see it behind what moves."""
WIDE = 0.5
"""Standard deviations around a Gaussian in which nothing may move."""
SURE = 0.5
"""Of moving_pixels.py's share, from which on a pixel moves."""
WAYS = np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)], float)


def freeze_still(model: GaussianModel, capture: Capture, store: Any, settings: Settings) -> GaussianModel:
    """The model with the Gaussians of which the films show that they stand still as they are on average, without motion."""
    times = np.linspace(0, (model.clip.frame_count - 1) / model.clip.frame_count, SAMPLES)
    places = np.stack([positions_at(model, t) for t in times])
    turns = rotations.one_sign(np.stack([rotations.unit(quaternions_at(model, t)) for t in times]))
    middle, turn = places.mean(0), rotations.unit(turns.mean(0))
    pixel = np.min([np.linalg.norm(middle - centre, axis=1) for centre in capture.centres()], 0)
    pixel /= max(shot.camera.fx for shot in capture.training if shot.camera)
    shown = np.stack([model.temporal_kind.factor(t, model.mu_tau, model.temporal) for t in times])
    moved = np.linalg.norm(places - middle, axis=-1).max(0) / pixel
    calm = _calm(middle, np.exp(model.scale.max(1)), capture, store, settings)
    still = ((moved < MOVED) & (calm >= CALM) | (calm == 1)) & (shown.min(0) > 1 - FADED)
    still |= (moved < MOVED_LITTLE) & (shown.min(0) > 1 - FADED_LITTLE)
    arrays = {name: array.copy() for name, array in model.arrays.items()}
    arrays["position"][still], arrays["rotation"][still] = middle[still], turn[still]
    arrays["motion"][still], arrays["rotation_motion"][still], arrays["mu_tau"][still] = 0, 0, 0.5
    odds = np.clip(sigmoid(model.opacity) * shown.mean(0), 1e-6, 1 - 1e-6)[still]
    arrays["opacity"][still] = np.log(odds / (1 - odds))
    if isinstance(model.appearance, Features):
        arrays["features"][still, 6:9] = 0
    if isinstance(model.temporal_kind, Radial):
        arrays["temporal"][still] = FLAT
    return replace(model, **arrays)  # type: ignore[arg-type]


def _calm(places: np.ndarray, sizes: np.ndarray, capture: Capture, store: Any, settings: Settings,
          earlier: Capture | None = None) -> np.ndarray:
    """The share [N] of the films that show Gaussians at these places [N, 3], of these sizes [N], in which nothing moves there; 1 of those
    that none shows.  0 where all cameras move, so that films do not tell.

    earlier  the segment before: now what counts is that films show for most of the time, in a part of it, what stood still before
    """
    masked = partial(_within_mask, settings, capture)
    before = None if earlier is None else MovingPixels(store, earlier.training, masked)
    moving, seen, calm = MovingPixels(store, capture.training, masked), np.zeros(len(places)), np.zeros(len(places))
    told = False
    for shots in by_view(capture.training).values():
        found = [moving.share(shot, store.pixels(shot)) for shot in spread(shots, LOOKS)]
        shares, camera = [share for share in found if share is not None], shots[0].camera
        if not shares or camera is None:
            continue
        most = np.max(shares, axis=0) if before is None else np.median(shares, axis=0)
        if before is not None:
            changed = moving.changed(before, shots[0].view, *most.shape)
            most = np.ones_like(most) if changed is None else np.maximum(most, changed)
        told = True
        pixels, depth = project(camera, places)
        rows = np.flatnonzero(visible(camera, places))
        reach = WIDE * sizes[rows] * camera.fx / depth[rows]
        parts = [sample(most[..., None], pixels[rows] + reach[:, None] * way)[:, 0] for way in WAYS]
        here = np.max(parts, axis=0) if before is None else np.min(parts, axis=0)
        seen[rows] += 1
        calm[rows] += here < SURE
    return np.where(seen > 0, calm / np.maximum(seen, 1), float(told))


def _within_mask(settings: Settings, capture: Capture, shot: Shot, pixels: Pixels) -> np.ndarray:
    """What the model is to show of a picture [h, w, 3], over black."""
    use = use_of_mask(settings, capture, shot, pixels.mask)
    cover = pixels.mask if use in ("cut", "only") else pixels.alpha
    return pixels.rgb if use == "off" or cover is None else pixels.rgb * cover[..., None]


def stands(model: GaussianModel) -> np.ndarray:
    """Which Gaussians [N] of such a model stand still and stay."""
    moves = model.motion.any((1, 2)) | model.rotation_motion.any((1, 2))
    tinted = model.features[:, 6:9].any(1) if isinstance(model.appearance, Features) else False
    return ~(moves | tinted) & (model.temporal == FLAT).all(1)


def start_after(before: GaussianModel, earlier: Capture, at: float, capture: Capture, store: Any, settings: Settings,
                say: Callable[[str], Any] = print, progress: Callable[[int, int], Any] = lambda done, of: None) -> Start:
    """What training on a segment begins with: what stands still in the model of the one before, first and held; the rest of it as it is
    where this one begins, its time `at`; and points of this one that belong to a moment.

    earlier  the capture of the segment before, capture: of this one
    """
    found, store = starting_points.initial_points(capture, store, settings, say, progress)
    timed = found.take(np.flatnonzero(np.isfinite(found.t))) if found.t is not None else found.take(slice(0, 0))
    sizes = np.exp(before.scale.max(1))
    frozen = stands(before) & (_calm(before.position, sizes, capture, store, settings, earlier) > 0)
    places, sizes = np.concatenate([positions_at(before, at), timed.xyz]), np.concatenate([sizes, np.zeros(len(timed))])
    calm, around = np.split(_calm(places, sizes, capture, store, settings), [len(before)])
    models = [before.take(np.flatnonzero(frozen)), _going_on(before.take(np.flatnonzero(~frozen)), at, settings, calm[~frozen] >= CALM)]
    room = max(settings.max_gaussians - sum(map(len, models)), 0)
    timed = timed.take(np.flatnonzero(around < 1 - CALM))  # what rests is known by now
    if len(timed):
        timed = starting_points.thinned(timed, max(room, 1), settings.seed)
        models.append(model_from_points(timed, settings, capture.clip, capture.axes, capture.extent))
    arrays = {name: np.concatenate([model.arrays[name] for model in models]) for name in before.arrays}
    first = replace(before, **arrays, clip=capture.clip)
    say(f"beginning with the segment before: {frozen.sum()} Gaussians are held, {len(models[1])} go on, {len(timed)} are new")
    return Start(first, None, depth_of(found, capture), frozen=int(frozen.sum()))


def _going_on(model: GaussianModel, at: float, settings: Settings, rests: np.ndarray) -> GaussianModel:
    """Gaussians as they are at a time, which becomes 0, at rest, to be seen as long as a starting point: of all times where nothing moves
    now (rests [N]), else of that moment.  If films show no place at rest, those are of all times that were seen all the time so far."""
    now = slice_model(model, at)
    part = model.take(now.index)
    odds = np.clip(now.opacity, 1e-4, 1 - 1e-4)
    long = rests[now.index] if rests.any() else model.temporal_kind.factor(0.0, part.mu_tau, part.temporal) > 1 - FADED
    life = np.where(long, settings.init_duration_static, settings.init_duration)
    temporal = np.broadcast_to(-2 * np.log(life)[:, None], part.temporal.shape)
    features = part.features.copy()
    if isinstance(model.appearance, Features):
        features[:, 6:9] = 0
    return replace(part, position=now.position, rotation=now.rotation, opacity=np.log(odds / (1 - odds)), features=features,
                   motion=np.zeros_like(part.motion), rotation_motion=np.zeros_like(part.rotation_motion), mu_tau=np.where(long, 0.5, 0.0),
                   temporal=temporal)

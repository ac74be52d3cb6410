# SPDX-License-Identifier: GPL-3.0-or-later
"""Initialises training from an existing model, such as a bake: positions, rotations and motions of its Gaussians are taken over.

The pictures decide which Gaussians are taken, and their colours: those that cover pixels, and more of them where they cover more pixels.
Some of the others are taken too, so that there is no hole where nobody filmed; nothing in training changes them.
"""
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ... import formats
from ...cameras.camera import Camera
from ...captures.capture import Capture, Points
from ...captures.pixels.store import FrameStore
from ...formats.turning import with_axes
from ...model.fitting import Fit
from ...model.gaussians import GaussianModel
from ...model.motion import Polynomial
from ...model.slicing import Slice, slice_model
from ...model.temporal import Radial
from ...rendering.api import render
from ...training.core.settings import Settings
from ...util.errors import FastGSError
from ...util.rotations import one_sign, to_matrices
from ..core.model import empty_model, motion_basis
from ..core.schedule import POINTS, generator
from .dense import picture, spread
from .geometry import project, sample, visible

SHARE = 0.75
"""Of the largest number of Gaussians: what training begins with; it adds the rest where they are needed."""
UNSEEN = 0.1
"""Of these, at most so many that no camera sees."""
MOST_SHOTS, SIDE = 48, 320
"""Pictures in which Gaussians are looked for, and their longer side."""
MOMENTS = 8
"""Of the clip: at each of them the Gaussians' places count as points of the scene."""
NEAR = 0.01
"""A Gaussian this far behind the depth that is seen, as a share of that depth, is seen too; and so is one that reaches it."""
GROWN, GROWN_UNSEEN = 3.0, 8.0
"""A Gaussian grows at most by this factor, to fill the places of those that are not taken; and one that no camera sees."""
OPAQUE = 0.95
"""Largest opacity: nearer to 1 it would hardly learn any more."""
LOOKED_AT, MOST_TERMS, MOST_TURN = 1000, 24, 3
"""Gaussians that tell how many coefficients motion gets; at most so many coefficients of places, and the highest degree of rotations."""
FOLLOWED, AIMED = 0.5, 3.0
"""Pixels, and degrees, by which 95 % of all moments of the Gaussians that move may be off."""


def starting_model(capture: Capture, settings: Settings, say: Callable[[str], None]) -> GaussianModel | None:
    """The model to begin with, in the capture's axes: the settings' one, else the one that the capture brings; None without either.

    Raises FastGSError where the settings' one cannot be read; without the capture's one training begins with points.
    """
    if settings.init not in ("auto", "model"):
        return None
    if settings.init_model:
        return with_axes(formats.load(settings.init_model), capture.axes)
    if capture.model is not None:
        try:
            return with_axes(formats.load(capture.model), capture.axes)
        except FastGSError as error:
            say(f"no starting Gaussians from this source: {error}")
    if settings.init == "model":
        raise FastGSError("no model to start from is named; give one with --init-model FILE.")
    return None


def begins_with_model(capture: Capture, settings: Settings) -> bool:
    """Whether training begins with a model: the settings' one, or one that the capture brings and that can be read."""
    return starting_model(capture, settings, lambda text: None) is not None


def following(capture: Capture, settings: Settings) -> Settings:
    """The settings with as many coefficients of motion, and of rotation, as follow the model that training begins with.

    Where motion has to be found in pictures of some frames, few coefficients keep it from swinging between these.  A bake tells places at
    every moment, and what its Gaussians cannot follow are blurred outlines.  Settings that name an order stay as they are, and so do those
    of polynomials, which swing, and of the printed form.  Raises FastGSError where the settings' model cannot be read.
    """
    if settings.order or settings.motion in ("static", "paper", "polynomial") or capture.clip.frame_count < 3:
        return settings
    model = starting_model(capture, settings, lambda text: None)
    if model is None or not len(model):
        return settings
    model = model.take(np.unique(np.linspace(0, len(model) - 1, LOOKED_AT).astype(int)))
    t = _moments(capture)
    slices = [slice_model(model, _time(capture, moment), cull=False) for moment in t]
    places, turns = np.stack([now.position for now in slices]), _turns(slices)
    away = float(np.median(np.linalg.norm(capture.centres() - capture.focus, axis=1)))
    pixel = max(away, 1e-3 * capture.extent) / float(np.median([shot.camera.fx for shot in capture.training if shot.camera is not None]))
    moves = np.ptp(places, axis=0).max(-1) > pixel
    if not moves.any():
        return settings
    usual = motion_basis(settings.motion, 0, capture.clip).terms
    orders = {order: motion_basis(settings.motion, order, capture.clip) for order in range(1, MOST_TERMS + 1)}
    most = max(min(capture.clip.frame_count - 1, MOST_TERMS), usual)
    missed = {order: _off(np.linalg.norm(Fit.of(basis, t)(places[:, moves])[1] - places[:, moves], axis=-1) / pixel)
              for order, basis in orders.items() if usual <= basis.terms <= most}
    askew = {degree: _off(_angles(Fit.of(Polynomial(degree), t)(turns[:, moves])[1], turns[:, moves]))
             for degree in range(settings.rotation_degree, MOST_TURN + 1) if settings.rotation_degree}
    return replace(settings, order=_least(missed, FOLLOWED) or 0, rotation_degree=_least(askew, AIMED) or settings.rotation_degree)


def _off(errors: np.ndarray) -> float:
    return float(np.quantile(errors, 0.95))


def _least(errors: dict[int, float], tolerance: float) -> int | None:
    """The least key whose error is within the tolerance, or hardly more than the smallest one."""
    enough = max(tolerance, 1.2 * min(errors.values(), default=0.0))
    return next((key for key, error in errors.items() if error <= enough), None)


def points_of(model: GaussianModel, capture: Capture) -> Points:
    """Where its Gaussians are at some moments, as points of all times."""
    slices = [slice_model(model, _time(capture, t)) for t in np.arange(MOMENTS) / MOMENTS]
    xyz = np.concatenate([now.position for now in slices])
    return Points(xyz.astype(np.float32), np.full((len(xyz), 3), 0.5, np.float32))


def begun_with(model: GaussianModel, capture: Capture, store: FrameStore, settings: Settings) -> GaussianModel:
    """The model that training begins with: of the settings' kinds, with at most SHARE of their Gaussians."""
    seen, most = _seen(model, capture, store, settings), int(SHARE * settings.max_gaussians)
    if not seen.area.any():
        raise FastGSError("no camera of the capture sees the model to start from; check that they share a world.")
    unseen = seen.area == 0
    share = _shares(np.sqrt(seen.area), int((1 - UNSEEN) * most))
    share[unseen] = min(UNSEEN * most / max(unseen.sum(), 1), 1)
    rows = np.flatnonzero(generator(settings.seed, POINTS, 2).uniform(size=len(model)) < share)
    first = _fitted(model.take(rows), seen.rgb[rows], capture, settings)
    grown = np.log(np.minimum(share[rows] ** -0.5, np.where(unseen[rows], GROWN_UNSEEN, GROWN)))
    return replace(first, scale=first.scale + grown[:, None].astype(np.float32))


@dataclass(frozen=True, eq=False)
class _Seen:
    """What pictures show of N Gaussians: area [N] in pixels, summed over them; the mean colour there rgb [N, 3], and of those that none
    shows the model's own, as much lighter or darker as the others are."""

    area: np.ndarray
    rgb: np.ndarray


def _seen(model: GaussianModel, capture: Capture, store: FrameStore, settings: Settings) -> _Seen:
    area, sums = np.zeros(len(model)), np.zeros((len(model), 3))
    for shot in spread(capture.training, MOST_SHOTS):
        image, camera, inside = picture(capture, store, settings, shot, SIDE)
        t = _time(capture, shot.t)
        now = slice_model(model, t)
        drawn = render(model, camera, t, ("depth",))["depth"]
        rows = np.flatnonzero(visible(camera, now.position))
        places, depth = project(camera, now.position[rows])
        widest = np.sort(now.scale[rows], 1)[:, 1:]
        uncovered = depth <= sample(drawn[..., None], places)[:, 0] * (1 + NEAR) + widest[:, 1]
        if inside is not None:
            uncovered &= sample(inside[..., None], places)[:, 0] > 0.5
        rows, places, depth, widest = rows[uncovered], places[uncovered], depth[uncovered], widest[uncovered]
        pixels = widest.prod(1) * camera.fx * camera.fy / depth**2 * _facing(now, rows, camera)
        np.add.at(area, now.index[rows], pixels)
        np.add.at(sums, now.index[rows], sample(image, places) * pixels[:, None])
    plain = np.array(model.appearance.plain_colours(model.features), np.float64)
    light = sums.sum(0) / np.maximum((plain * area[:, None]).sum(0), 1e-6 * max(area.sum(), 1))
    return _Seen(area, np.divide(sums, area[:, None], out=np.clip(plain * light, 0, 1), where=area[:, None] > 0))


def _facing(now: Slice, rows: np.ndarray, camera: Camera) -> np.ndarray:
    """How much the Gaussians' flat side faces the camera: the cosine."""
    axes = to_matrices(now.rotation[rows])
    normal = axes[np.arange(len(rows)), :, now.scale[rows].argmin(1)]
    ray = now.position[rows] - camera.centre
    return np.abs((normal * ray).sum(1)) / np.maximum(np.linalg.norm(ray, axis=1), 1e-12)


def _shares(weight: np.ndarray, count: int) -> np.ndarray:
    """The probability of each to be taken, in proportion to its weight and at most 1, so that about `count` are."""
    low, high = 0.0, 1.0
    if (weight > 0).sum() <= count:
        return (weight > 0).astype(np.float64)
    share = weight / weight[weight > 0].min()
    while np.minimum(high * share, 1).sum() < count:
        low, high = high, 2 * high
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if np.minimum(middle * share, 1).sum() < count else (low, middle)
    return np.minimum(high * share, 1)


def _fitted(model: GaussianModel, rgb: np.ndarray, capture: Capture, settings: Settings) -> GaussianModel:
    """The model in the settings' bases of time, by least squares over the clip, and of their other kinds.

    Where a Gaussian turns in a way that the basis of rotations cannot follow, its thin side grows by what the turn moves its wide one.
    """
    t = _moments(capture)
    slices = [slice_model(model, _time(capture, moment), cull=False) for moment in t]
    empty = empty_model(settings, capture.clip, capture.axes)
    n = len(model)
    arrays: dict[str, Any] = {name: np.zeros(shape, np.float32) for name, shape in empty.shapes(n).items()}
    places, _ = Fit.of(empty.basis, t)(np.stack([now.position for now in slices]))
    turns = _turns(slices)
    quaternions, followed = Fit.of(empty.rotation_basis, t)(turns)
    sine = np.sqrt(np.mean(np.sin(np.radians(np.minimum(_angles(followed, turns), 90))) ** 2, axis=0))
    scale = slices[0].scale
    scale = np.maximum(scale, sine[:, None] * np.median(scale, axis=1, keepdims=True))
    arrays["scale"][:] = np.log(np.maximum(scale, 1e-6 * capture.extent))
    arrays["features"][:] = empty.appearance.features_of(rgb)
    sigma = np.stack([now.opacity for now in slices])
    peak = sigma.max(0)
    opacity = np.clip(peak, settings.init_opacity, OPAQUE)
    arrays["opacity"][:] = np.log(opacity / (1 - opacity))
    shown = sigma / np.maximum(peak, 1e-12)
    middle = (shown * t[:, None]).sum(0) / shown.sum(0)
    always = shown.min(0) > 0.5
    arrays["mu_tau"][:] = np.where(always, 0.5, middle)
    for constant, motion, basis, fit in (("position", "motion", empty.basis, places), ("rotation", "rotation_motion", empty.rotation_basis,
                                                                                      quaternions)):
        about_zero = fit[0], fit[1:].swapaxes(0, 1)
        arrays[constant][:], arrays[motion][:] = basis.recentred(*about_zero, arrays["mu_tau"].astype(np.float64))
    if isinstance(empty.temporal_kind, Radial):
        spread_of = np.sqrt(2 * (shown * (t[:, None] - middle) ** 2).sum(0) / shown.sum(0))
        life = np.where(always, settings.init_duration_static, np.maximum(spread_of, settings.init_duration / 2))
        arrays["temporal"][:, 0] = -2 * np.log(life)
    return replace(empty, **arrays)


def _moments(capture: Capture) -> np.ndarray:
    """Times [S] of the clip at which motion is looked at: its frames and the middles between them."""
    frames = capture.clip.frame_count
    return np.linspace(0, (frames - 1) / frames, min(2 * frames - 1, 96)) if frames > 1 else np.zeros(1)


def _turns(slices: Sequence[Slice]) -> np.ndarray:
    """Unit quaternions [S, N, 4] of slices, each of the sign that is nearer to the one before."""
    return one_sign(np.stack([now.rotation for now in slices]))


def _angles(quaternions: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Degrees between rotations, quaternions [..., 4] of any length and unit ones."""
    cosine = np.abs((quaternions * turns).sum(-1)) / np.maximum(np.linalg.norm(quaternions, axis=-1), 1e-12)
    return 2 * np.degrees(np.arccos(np.clip(cosine, 0, 1)))


def _time(capture: Capture, t: float) -> float:
    """The model's time at the capture's time t."""
    begin, length = capture.within
    return begin + length * t

# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the initial Gaussians of training, from an existing model or from starting points, with a backdrop behind them."""
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...cameras.camera import Camera
from ...captures.capture import Capture, Shot
from ...captures.clocks.find import by_epipolar_planes
from ..core.camera_response import FARTHEST, CameraResponse, CorrectedStore
from ..core.settings import Settings
from ..core.start import Start
from . import backdrop, starting_points, warm_start
from .fades import fades_of
from .first_model import depth_of, model_from_points


def start(capture: Capture, store: Any, settings: Settings, say: Callable[[str], None] = print,
          progress: Callable[[int, int], None] = lambda done, of: None) -> Start:
    """What training on a capture begins with; progress(done, of) is called while points are looked for.

    Raises FastGSError where what the settings ask for gives nothing.
    """
    store, fades = _steady(capture, store, settings, say)
    model = warm_start.starting_model(capture, settings, say)
    found, store = starting_points.initial_points(capture, store, settings, say, progress) if model is None else \
        (warm_start.points_of(model, capture), store)
    behind = backdrop.with_backdrop(capture, store, settings, found)
    if model is None:
        gains = store.response.gain_priors if isinstance(store, CorrectedStore) else None
        _tell_unsure(capture, settings, gains, say)
        behind = starting_points.thinned(behind, settings.max_gaussians, settings.seed)
        first = model_from_points(behind, settings, capture.clip, capture.axes, capture.extent)
        return Start(first, behind.size, depth_of(behind, capture), gains, fades)
    first, sizes = warm_start.begun_with(model, capture, store, settings), None
    say(f"starting with {len(first)} of the {len(model)} Gaussians of a model that is known")
    behind = behind.take(slice(len(found), None))
    if len(behind):
        sizes = np.concatenate([np.full(len(first), np.nan, np.float32), behind.size])
        second = model_from_points(behind, settings, capture.clip, capture.axes, capture.extent)
        first = replace(first, **{name: np.concatenate([array, second.arrays[name]]) for name, array in first.arrays.items()})
    return Start(first, sizes, depth_of(found, capture), None, fades, warm=True)


def expected_clocks(capture: Capture, store: Any, settings: Settings, say: Callable[[str], None] = print,
                    progress: Callable[[int, int], None] | None = None) -> np.ndarray | None:
    """The clock offsets of the views trained on against the times of their shots, and their standard deviations [V, 2] in frames, as pairs
    of cameras show them (captures.clocks); a deviation of 0: unsure.  None where nothing can be compared, or nobody asks."""
    views = capture.training_views
    if settings.clocks == "off" or len(views) < 2:
        return None

    def pictures(shots: Sequence[Shot], small: Camera) -> Iterator[tuple[Shot, np.ndarray]]:
        return ((shot, store.pixels(shot).rgb) for shot in shots)

    found = by_epipolar_planes(replace(capture, shots=capture.films), progress, pictures)
    if found is None:
        return None
    known = set(found.measured) - set(found.lost)
    expected = np.array([(found.measured[view], found.clocks.uncertainty[view]) if view in known else (0.0, 0.0) for view in views])
    apart = {view: late for view, late in found.clocks.offsets.items() if abs(late) > FARTHEST}
    if apart:
        say("clocks differ by more frames than training corrects: " + ", ".join(f"{view} {value:+.1f}" for view, value in apart.items())
            + "; run fastgs sync on this capture")
    return expected


def _tell_unsure(capture: Capture, settings: Settings, gains: np.ndarray | None, say: Callable[[str], None]) -> None:
    views = capture.training_views
    unsure = views if gains is None else [view for view, known in zip(views, gains[:, 1].all(1)) if not known]
    if settings.exposures == "auto" and unsure and len(views) > 1:
        some = "all cameras" if len(unsure) == len(views) else ", ".join(unsure[:6]) + (" ..." if len(unsure) > 6 else "")
        say(f"exposures: unsure for {some}, which see too little that other cameras see; they stay as they are")


def _steady(capture: Capture, store: Any, settings: Settings, say: Callable[[str], None]) -> tuple[Any, Any]:
    """The store with colours whose exposures do not change over time, and the fades that were taken out; or the store itself, and None."""
    if settings.exposures == "off":
        return store, None
    fades, views = fades_of(capture, store, settings), capture.training_views
    if not fades.any():
        return store, None
    say("exposures change over the clip, and are evened: " + ", ".join(
        f"{view} by {np.exp(2 * fade.mean()):.2f}" for view, fade in zip(views, fades) if fade.any()))
    return CorrectedStore(store, CameraResponse.initial(views, capture.clip.frame_count, settings, fades=fades)), fades

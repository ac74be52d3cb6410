# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the initial Gaussians of training, from an existing model or from starting points, with a backdrop behind them."""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...model.gaussians import GaussianModel
from ..core.evening import Evened, Evening
from . import backdrop, known, points
from .fading import fades_of
from .model import model_from_points, reach_of


@dataclass(frozen=True, eq=False)
class Start:
    """The model that training begins with; sizes [N], how far apart its backdrop's Gaussians stand, NaN for others, or None without
    a backdrop; reach, how far away is what the cameras film; gains [V, 3] of the views trained on, 0 where they are not known, or
    None where they are not known to differ; fades [V, 3] of these views, how their exposures change, or None where none does; known: it
    was made from a model that shows the scene."""

    model: GaussianModel
    sizes: np.ndarray | None
    reach: float
    gains: np.ndarray | None = None
    fades: np.ndarray | None = None
    known: bool = False

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All of it but the model's kinds, for other processes."""
        perhaps = {"sizes": self.sizes, "gains": self.gains, "fades": self.fades}
        numbers = {"reach": np.array([self.reach]), "known": np.array([self.known])}
        return self.model.arrays | numbers | {name: a for name, a in perhaps.items() if a is not None}

    @classmethod
    def of(cls, arrays: dict[str, np.ndarray], empty: GaussianModel) -> Start:
        """The inverse of arrays(), for a model of the same kinds as `empty`."""
        return cls(replace(empty, **{name: arrays[name] for name in empty.arrays}), arrays.get("sizes"), float(arrays["reach"][0]),
                   arrays.get("gains"), arrays.get("fades"), bool(arrays["known"][0]))


def start(capture, store, settings, say=print, progress=lambda done, of: None) -> Start:
    """What training on a capture begins with; progress(done, of) is called while points are looked for.

    Raises FastGSError where what the settings ask for gives nothing.
    """
    store, fades = _steady(capture, store, settings, say)
    model = known.known_model(capture, settings, say)
    found, store = points.initial_points(capture, store, settings, say, progress) if model is None else \
        (known.points_of(model, capture), store)
    gains = store.evening.told if isinstance(store, Evened) and store.evening.colours_differ else None
    behind = backdrop.with_backdrop(capture, store, settings, found)
    if model is None:
        behind = points.thinned(behind, settings.max_gaussians, settings.seed)
        first = model_from_points(behind, settings, capture.clip, capture.axes, capture.extent)
        return Start(first, behind.size, reach_of(behind, capture), gains, fades)
    first = known.begun_with(model, capture, store, settings)
    say(f"starting with {len(first)} of the {len(model)} Gaussians of a model that is known")
    behind = behind.take(slice(len(found), None))
    if not len(behind):
        return Start(first, None, reach_of(found, capture), fades=fades, known=True)
    second = model_from_points(behind, settings, capture.clip, capture.axes, capture.extent)
    both = replace(first, **{name: np.concatenate([array, second.arrays[name]]) for name, array in first.arrays.items()})
    sizes = np.concatenate([np.full(len(first), np.nan, np.float32), behind.size])
    return Start(both, sizes, reach_of(found, capture), fades=fades, known=True)


def _steady(capture, store, settings, say):
    """The store with colours whose exposures do not change over time, and the fades that were taken out; or the store itself, and None."""
    if settings.exposures == "off":
        return store, None
    fades, views = fades_of(capture, store, settings), tuple(dict.fromkeys(shot.view for shot in capture.training))
    if not fades.any():
        return store, None
    say("exposures change over the clip, and are evened: " + ", ".join(
        f"{view} by {np.exp(2 * fade.mean()):.2f}" for view, fade in zip(views, fades) if fade.any()))
    return Evened(store, Evening.begun(views, capture.clip.frame_count, settings, fades=fades)), fades

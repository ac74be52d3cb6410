# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians that travel straight and fade like a bell, as the model's arrays: the maths that many 4D formats share.

    position(T) = position + velocity (T - centre)        opacity(T) = opacity exp(-(T - centre)^2 / (2 sigma^2))

with T in the file's own unit of time, and no opacity at all outside a window [begin, end], where there is one.
"""
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..model.motion import Polynomial
from ..model.temporal import Radial, WindowedRadial
from .base import STEEP

SLACK = 2.5e-7
"""Of t, by which windows are moved: float32 holds no third of a clip, and a frame at a window's edge must fall on the right side."""


@dataclass(frozen=True)
class Timeline:
    """The file's time in the model's: t = (T - zero) / length."""

    zero: float = 0.0
    length: float = 1.0

    def t(self, time: np.ndarray) -> np.ndarray:
        """The model's times of the file's, float64."""
        return (np.asarray(time, np.float64) - self.zero) / self.length


def straight(position: ArrayLike, velocity: ArrayLike | None, centre: ArrayLike, ln_sigma: ArrayLike, timeline: Timeline = Timeline(),
             window: tuple[Any, Any] | None = None, closed: bool = False) -> dict[str, Any]:
    """Keyword arguments for GaussianModel: position, motion, mu_tau, temporal and their kinds.

    position [N, 3]; velocity [N, 3] or None; centre [N]; ln_sigma [N], inf: no fading; window (begin, end), each [N] or a number,
    with Gaussians seen at begin <= T < end, or, if closed, at begin <= T <= end.  All in the file's unit of time.
    """
    position, centre = np.asarray(position, np.float64), np.asarray(centre, np.float64)
    with np.errstate(all="ignore"):  # what is no number is found by usable()
        ln_s = -np.log(2.0) - 2 * (np.asarray(ln_sigma, np.float64) - np.log(timeline.length))
        arrays = {"position": position, "mu_tau": timeline.t(centre), "temporal": np.clip(ln_s, -STEEP, STEEP)[:, None]}
        if velocity is not None:
            arrays |= {"motion": timeline.length * np.asarray(velocity, np.float64)[:, None], "basis": Polynomial(1)}
        if window is None:
            return _narrow(arrays) | {"temporal_kind": Radial()}
        slack = (-SLACK, SLACK if closed else -SLACK)
        ends = [np.clip(np.broadcast_to(timeline.t(end), len(position)) + s, -1e6, 1e6) for end, s in zip(window, slack)]
        flank = np.full(len(position), -STEEP)
        arrays["temporal"] = np.stack([arrays["temporal"][:, 0], *ends, flank], -1)
        return _narrow(arrays) | {"temporal_kind": WindowedRadial()}


def _narrow(arrays: dict) -> dict:
    """The same with float32 arrays; numbers beyond it become infinite."""
    return {k: v.astype(np.float32) if isinstance(v, np.ndarray) else v for k, v in arrays.items()}


def logit(opacity: np.ndarray) -> np.ndarray:
    """The logit of opacities 0..1; of exactly 0 and 1, an infinity, which usable() makes a number."""
    with np.errstate(all="ignore"):
        opacity = np.clip(np.asarray(opacity, np.float64), 0, 1)
        return np.log(opacity) - np.log1p(-opacity)

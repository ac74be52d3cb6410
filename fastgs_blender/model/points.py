# SPDX-License-Identifier: GPL-3.0-or-later
"""Coloured points of a scene, perhaps each with a time: what training and baking begin with."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class Points:
    """Points of the scene: xyz [P, 3], rgb [P, 3] in 0..1 (display), t [P] in [0, 1] or None where they hold for all times;
    size [P], how far apart they stand, NaN or None where that is to be seen from their neighbours; velocity [P, 3] at the time t, per
    unit of time, or None where nothing is known of it."""

    xyz: np.ndarray
    rgb: np.ndarray
    t: np.ndarray | None = None
    size: np.ndarray | None = None
    velocity: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.xyz)

    def take(self, rows: Any) -> Points:
        """Some of the points, by indices or a mask."""
        parts: dict[str, Any] = {name: None if array is None else array[rows] for name, array in vars(self).items()}
        return Points(**parts)


def usable(xyz: np.ndarray, rgb: np.ndarray, t: np.ndarray | None = None) -> Points:
    """Points as float32, without those that are not finite; colours and times kept within 0..1, NaN in t stays: always there."""
    good = np.isfinite(xyz).all(1) & (np.abs(xyz) < 1e9).all(1)
    if t is not None:
        good &= ~np.isinf(t)
    xyz, rgb = np.ascontiguousarray(xyz[good], np.float32), np.nan_to_num(np.clip(np.asarray(rgb)[good], 0, 1).astype(np.float32))
    return Points(xyz, rgb, None if t is None else np.clip(np.asarray(t)[good], 0, 1).astype(np.float32))

# SPDX-License-Identifier: GPL-3.0-or-later
"""The 4D PLY of Mediastorm and 4DV.ai (UGRS, their Blender viewer): Gaussians that travel straight and fade like a bell.

Columns: those of INRIA's PLY, then motion_0..2 (velocity, per second), t_scale (ln of the temporal standard deviation, in seconds)
and t or ttt (the centre, in seconds; Blender's own PLY importer keeps a column `t` for textures, hence the other name).
The law is that of their viewer's nodes: position + motion (T - t), opacity exp(-(T - t)^2 / (2 exp(t_scale)^2)), T = frame / 60.
The file does not say how long it is: the clip here ends with the frame of the last centre.
"""
import math
from pathlib import Path

import numpy as np

from ..model.appearance import SH
from ..model.gaussians import Clip, GaussianModel
from ..util.errors import FastGSError
from . import ply
from .base import Format
from .ftgs import static_columns
from .straight import Timeline, straight

MOTION = ("motion_0", "motion_1", "motion_2")
CENTRES = ("t", "ttt")
FPS = 60.0
"""Frames per second, where nobody says another: the viewer's default."""
LONGEST = 100_000.0
"""Seconds."""


class MediastormPly(Format):
    name = "Mediastorm 4D PLY"
    reads = (".ply",)

    def sniff(self, head: bytes, path: Path) -> bool:
        return head.startswith(b"ply") and ply.read_header(path).names.issuperset((*MOTION, "t_scale"))

    def load(self, path: Path) -> GaussianModel:
        header = ply.read_header(path)
        centre = next((name for name in CENTRES if name in header.names), None)
        if centre is None:
            raise FastGSError("its column t, the time at which each Gaussian is seen best, is missing; export it again.")
        degree, groups = static_columns(header, path)
        columns = ply.read_vertices(path, header, groups | {"velocity": MOTION, "time": (centre, "t_scale")})
        time, velocity = columns.pop("time"), columns.pop("velocity")
        frames = last_frame(time[:, 0], FPS) + 1
        lives = straight(columns.pop("position"), velocity, time[:, 0], time[:, 1], Timeline(length=frames / FPS))
        return GaussianModel(**columns, **lives, appearance=SH(degree), clip=Clip(frames, FPS))


def last_frame(seconds: np.ndarray, fps: float) -> int:
    """The last whole frame that does not lie behind all the times; those that are no times are ignored."""
    times = seconds[np.isfinite(seconds) & (np.abs(seconds) <= LONGEST)]
    return max(0, math.floor(float(times.max(initial=0.0)) * fps + 1e-3))

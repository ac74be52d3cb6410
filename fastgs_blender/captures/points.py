# SPDX-License-Identifier: GPL-3.0-or-later
"""Points that come with a capture: PLY files with x y z, perhaps red green blue, perhaps t."""
from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import FastGSError
from ..formats import ply
from .base import Points

GREY = 0.5


def load_points(path: Path) -> Points:
    """The points of a PLY file; colours as bytes or as 0..1, grey where there are none.  Raises FastGSError."""
    try:
        header = ply.read_header(path)
        names = header.names
        if not {"x", "y", "z"} <= names:
            raise FastGSError("it has no vertices with x, y and z.")
        groups = {"xyz": ("x", "y", "z")}
        rgb = next((three for three in (("red", "green", "blue"), ("r", "g", "b")) if set(three) <= names), None)
        if rgb:
            groups["rgb"] = rgb
        time = next((name for name in ("t", "time") if name in names), None)
        if time:
            groups["t"] = (time,)
        columns = ply.read_vertices(path, header, groups)
    except (FastGSError, OSError, MemoryError) as error:
        raise FastGSError(f"{path}: the points cannot be read: {error}") from error
    colours = columns.get("rgb")
    if colours is None:
        colours = np.full_like(columns["xyz"], GREY)
    elif all(p.code[0] in "iu" for p in header.vertex.properties if p.name in rgb):
        colours = colours / 255
    return usable(columns["xyz"], colours, columns["t"][:, 0] if time else None)


def usable(xyz, rgb, t=None) -> Points:
    """Points as float32, without those that are not finite; colours and times kept within 0..1, NaN in t stays: always there."""
    good = np.isfinite(xyz).all(1) & (np.abs(xyz) < 1e9).all(1)
    if t is not None:
        good &= ~np.isinf(t)
    xyz, rgb = np.ascontiguousarray(xyz[good], np.float32), np.nan_to_num(np.asarray(rgb, np.float32)[good])
    return Points(xyz, np.clip(rgb, 0, 1), None if t is None else np.clip(np.asarray(t, np.float32)[good], 0, 1))

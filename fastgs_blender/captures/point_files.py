# SPDX-License-Identifier: GPL-3.0-or-later
"""Points that come with a capture: PLY files with x y z, perhaps red green blue, perhaps t."""
from pathlib import Path

import numpy as np

from ..formats import ply
from ..model.points import Points, usable
from ..util.errors import FastGSError
from ..util.reading import reading

GREY = 0.5


def load_points(path: Path) -> Points:
    """The points of a PLY file; colours as bytes or as 0..1, grey where there are none.  Raises FastGSError."""
    advice = "the points are damaged or of another kind, so copy or export them again"
    with reading(path, advice):
        try:
            return _points(path)
        except FastGSError as error:  # about the file's contents, so far without its name
            raise FastGSError(f"{path}: the points cannot be read: {error}") from error


def _points(path: Path) -> Points:
    header = ply.read_header(path)
    names = header.names
    if not {"x", "y", "z"} <= names:
        raise FastGSError("it has no vertices with x, y and z.")
    groups: dict[str, tuple[str, ...]] = {"xyz": ("x", "y", "z")}
    rgb = next((three for three in (("red", "green", "blue"), ("r", "g", "b")) if set(three) <= names), None)
    if rgb:
        groups["rgb"] = rgb
    time = next((name for name in ("t", "time") if name in names), None)
    if time:
        groups["t"] = (time,)
    columns = ply.read_vertices(path, header, groups)
    colours = columns.get("rgb")
    if colours is None:
        colours = np.full_like(columns["xyz"], GREY)
    elif all(p.code[0] in "iu" for p in header.vertex.properties if p.name in (rgb or ())):
        colours = colours / 255
    return usable(columns["xyz"], colours, columns["t"][:, 0] if time else None)

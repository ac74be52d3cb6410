# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene of a `.4dgs` file while it is read, its Gaussians still in integers, and what its chunks have in common."""
from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..util.errors import FastGSError
from . import fourdgs_streams as wire
from .fourdgs_tracks import Track


@dataclass
class Scene:
    """The contents of a `.4dgs` file while it is read.

    tables  one of the attributes [N, channels] int64 for each chunk, or for all Gaussians of keyframe-delta
    bands   for each table, {band: coefficients [N, 3 (2 band + 1)] 0..255}
    spans   of keyframe-delta: begin and end [N] in seconds of what holds
    """

    duration: float
    cutoff: float
    temporal_model: str
    degree: int
    steps: dict[str, float] = field(default_factory=dict)
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    windows: np.ndarray = field(default_factory=lambda: np.zeros((1, 2)))
    axes: str = "RDF"
    tracks: list[Track] = field(default_factory=list)
    tables: list[dict[int, np.ndarray]] = field(default_factory=list)
    bands: list[dict[int, np.ndarray]] = field(default_factory=list)
    spans: tuple[np.ndarray, np.ndarray] = (np.zeros(0), np.zeros(0))


def chunk(content: wire.Cursor, room: int) -> tuple[float, float, int, wire.Cursor]:
    """Begin and end in seconds, number of Gaussians, and streams of a chunk; room: how many Gaussians there can be."""
    begin, end, _, count = content.unpack("ddII")
    codec, size = content.text(), content.number("Q")
    if count > room:
        raise FastGSError(f"a chunk in it claims {count} Gaussians, which the file is too small to hold; copy or export it again.")
    return begin, end, count, wire.unpacked(content.block(), codec, size)


def complete(table: dict[int, np.ndarray], count: int, what: str) -> dict[int, np.ndarray]:
    """The table; raises FastGSError where an attribute that every Gaussian has is missing."""
    missing = [wire.NAMES[a] for a in wire.REQUIRED if a not in table]
    if missing and count:
        raise FastGSError(f"{what} in it has no {', '.join(missing)}; the file is damaged, so copy or export it again.")
    return table if count else {a: np.zeros((0, wire.CHANNELS[a]), np.int64) for a in wire.CHANNELS}


def band_of(degree: int, number: int, content: wire.Cursor, count: int) -> np.ndarray:
    """The coefficients [count, 3 (2 number + 1)] of a band; raises FastGSError."""
    if not 1 <= number <= max(degree, 1):
        raise FastGSError(f"it has band {number} of spherical harmonics, and its degree is {degree}; the file is damaged.")
    values = wire.stream(content, count, band=True)[1]
    if values is None or values.shape[1] != 3 * (2 * number + 1) or (values.size and (values.min() < 0 or values.max() > 255)):
        raise FastGSError(f"band {number} of its spherical harmonics is damaged; copy or export the file again.")
    return values

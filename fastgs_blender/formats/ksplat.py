# SPDX-License-Identifier: GPL-3.0-or-later
"""`.ksplat` of mkkellogg's GaussianSplats3D, compression levels 0 to 2: static Gaussians in sections.  Read only.

A header of 4096 bytes, a header of 1024 for each section, then the sections: lengths of their partly filled buckets (u32), centres of
their buckets (3 x f32), and a record a Gaussian: position, standard deviations, quaternion w x y z, red green blue opacity (u8), and
harmonics of degree 1 and 2, within each channel by channel.  Level 0 has f32; levels 1 and 2 half floats, positions as u16 around
the centre of their bucket, and level 2 harmonics as bytes between two bounds.
"""
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..model.appearance import SH, SH_C0
from ..model.gaussians import GaussianModel
from ..util.errors import FastGSError
from ..util.reading import damaged_if
from .static import StaticFormat, logits, read_whole

HEADER, SECTION = 4096, 1024
MAIN = struct.Struct("<BBxxIIIIH2x3fff")
"""Version (two parts), most sections, sections, most Gaussians, Gaussians, level, centre, bounds of harmonics."""
PART = struct.Struct("<IIIIfH2xIIIIH")
"""Gaussians, most Gaussians, of a bucket, buckets, their edge, bytes of one, range, bytes, full buckets, partly filled, degree."""
HARMONICS = {0: 0, 1: 9, 2: 24}
RANGE = 32767
BOUND = 1.5
"""Of 8-bit harmonics, where the header has none."""


class Ksplat(StaticFormat):
    name = ".ksplat"
    reads = (".ksplat",)

    def sniff(self, head: bytes, path: Path) -> bool:
        """The marks are few: version 0.1, a level, zeros where nothing is, and sections of the right size."""
        size = path.stat().st_size
        if size < HEADER + SECTION or head[:4] != b"\0\1\0\0":
            return False
        return bool(_sections(read_whole(path, min(size, HEADER + 64 * SECTION)), size))

    def load(self, path: Path) -> GaussianModel:
        data = read_whole(path)
        main, sections = _sections(data, len(data))
        degree = max((section.degree for section in sections), default=0)
        parts = [_decoded(data, section, main, degree) for section in sections if section.count]
        if not parts:
            raise FastGSError("there are no Gaussians in it; export it again.")
        return GaussianModel(**{name: np.concatenate([part[name] for part in parts]) for name in parts[0]}, appearance=SH(degree))


@dataclass(frozen=True)
class _Section:
    """Where a section's parts begin, and what they hold."""

    count: int
    bucket: int
    full: int
    partial: int
    buckets: int
    step: float
    range: int
    degree: int
    begin: int
    centres: int
    records: int


def _record(level: int, degree: int) -> np.dtype:
    number, position, harmonic = (("<f4", "<f4", "<f4"), ("<f2", "<u2", "<f2"), ("<f2", "<u2", "u1"))[level]
    return np.dtype([("position", position, 3), ("scale", number, 3), ("rotation", number, 4), ("colour", "u1", 4),
                     ("harmonics", harmonic, HARMONICS[degree])])


def _sections(data: bytes, size: int) -> tuple[tuple, list[_Section]]:
    """The main header, and the sections; data: the headers at least; size: of the file.  Raises FastGSError."""
    main = MAIN.unpack_from(data)
    major, minor, most, level = main[0], main[1], main[2], main[6]
    if major or not minor:
        raise FastGSError(f"it is of .ksplat version {major}.{minor}; version 0.1 is read.")
    damaged_if(level > 2, f"its compression level {level} is unknown (0, 1 and 2 are read)")
    damaged_if(HEADER + most * SECTION > size, f"the file is cut short: its header promises {most} sections")
    at, sections = HEADER + most * SECTION, []
    for place in range(HEADER, min(at, len(data) - SECTION + 1), SECTION):
        _, count, bucket, buckets, edge, width, reach, _, full, partial, degree = PART.unpack_from(data, place)
        if degree not in HARMONICS or (level and count and (width != 12 or full + partial > buckets)):
            raise FastGSError("a section's header makes no sense; the file is damaged, so copy or export it again.")
        reach = reach or (RANGE if level else 1)
        records = at + 4 * partial + width * buckets
        sections.append(_Section(count, bucket, full, partial, buckets, edge / 2 / reach, reach, degree, at, at + 4 * partial, records))
        at = records + count * _record(level, degree).itemsize
        damaged_if(at > size, f"the file is cut short: a section promises {count} Gaussians")
    return main, sections


def _decoded(data: bytes, section: _Section, main: tuple, degree: int) -> dict[str, np.ndarray]:
    """The arrays of a section's model, its harmonics widened with zeros to `degree`."""
    level = main[6]
    records = np.frombuffer(data, _record(level, section.degree), section.count, section.records)
    position = records["position"]
    if level:
        centres = np.frombuffer(data, "<f4", 3 * section.buckets, section.centres).reshape(-1, 3)
        position = (position - np.float64(section.range)) * section.step + centres[_bucket(data, section)]
    colour = records["colour"]
    features = np.zeros((section.count, (degree + 1) ** 2, 3))
    features[:, 0] = (colour[:, :3] / 255 - 0.5) / SH_C0
    harmonics = records["harmonics"].astype(np.float64)
    if level == 2:
        low, high = main[10] or -BOUND, main[11] or BOUND
        harmonics = low + harmonics / 255 * (high - low)
    for first, last in ((1, 4), (4, 9))[:section.degree]:
        part = harmonics[:, 3 * (first - 1):3 * (last - 1)].reshape(-1, 3, last - first)
        features[:, first:last] = part.transpose(0, 2, 1)
    return {"position": position, "scale": np.log(records["scale"].astype(np.float64)), "rotation": records["rotation"],
            "opacity": logits()[colour[:, 3]], "features": features.reshape(section.count, -1)}


def _bucket(data: bytes, section: _Section) -> np.ndarray:
    """The bucket [N] of each record: the full ones first, of one length, then the others, whose lengths are listed."""
    row = np.arange(section.count)
    filled = section.full * section.bucket
    lengths = np.frombuffer(data, "<u4", section.partial, section.begin).astype(np.int64)
    ends = filled + np.cumsum(lengths)
    damaged_if(section.count > (ends[-1] if len(ends) else filled), "its buckets hold fewer Gaussians than it has")
    late = section.full + np.searchsorted(ends, row, side="right")
    return np.where(row < filled, row // max(section.bucket, 1), late)

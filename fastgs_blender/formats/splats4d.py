# SPDX-License-Identifier: GPL-3.0-or-later
"""`.splat4d` of splats4D (adamraudonis, version 1): frames of .splat files, quantised, as a static part and groups of frames.

"SP4D", version and flags (u16), the length of a JSON header (u32), the header.  A stream has bytes a number (u8), numbers and packed bytes
(u32 each), and whole numbers packed with zstd, first all lowest bytes, then all second ones, and so on.

* The static part: for each attribute a bit a Gaussian, 1 where it never changes; then every Gaussian's attributes, positions and ln of
  scales in fine steps as zigzag differences from the Gaussian before, colours, opacities and rotations as bytes.
* A group of frames: for each attribute that changes the numbers of its first frame, and the differences from frame to frame.

The other `.splat4d`, of gsplat-unity, is in splat4d.py.
"""
import struct
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..model.appearance import RGB
from ..model.gaussians import Clip, GaussianModel
from ..model.sequence import Source
from ..util.errors import FastGSError
from ..util.reading import damaged_if, exactly, open_file
from . import packing, pixel_tables
from .base import Loader
from .description import frame_rate, read_table, whole_number
from .frame_names import MOST_FRAMES
from .sequences import SequenceFormat, within
from .static import logits, plausible_count

MAGIC = b"SP4D"
HEADER, STREAM = struct.Struct("<4sHHI"), struct.Struct("<BBBII")
POSITION, ROTATION, COLOUR, OPACITY, SCALE = range(5)
CHANNELS = (3, 4, 3, 1, 3)
KEY, CHANGE = 0, 1
STEPS = {POSITION: "pos", ROTATION: "rot", COLOUR: "rgb", OPACITY: "alpha", SCALE: "scale_log"}


@dataclass(frozen=True)
class _Span:
    """Where a group of frames lies in the file, and its first and last frame."""

    begin: int
    length: int
    first: int
    last: int


class Splats4D(SequenceFormat):
    name = "splats4D"
    magic = MAGIC
    reads = (".splat4d",)

    def open(self, path: Path, load: Loader) -> Source:
        film = _Film(path)
        return within(path, film.clip, np.arange(film.frames), film.frame, alike=True)


class _Film:
    """The frames of a file: the static part is read once; the group that was read last stays, and so does the frame in it."""

    def __init__(self, path: Path) -> None:
        self.path, self._lock = path, threading.Lock()
        with open_file(path) as stream:
            length = stream.seek(0, 2)
            stream.seek(0)
            _, version, _, size = HEADER.unpack(stream.read(HEADER.size))
            if version != 1:
                raise FastGSError(f"it is of version {version}, and version 1 is read.")
            about = read_table(exactly(stream, size))
            self.count, self.frames = (whole_number(about.get(key), f"its {key!r}") for key in "nt")
            plausible_count(self.count, length)
            part = pixel_tables.part(about, "static_section")
            begin, size = (whole_number(part.get(key), f"the {key} of its static part") for key in ("offset", "len"))
            steps = pixel_tables.part(about, "steps")
            names = (*STEPS.values(), "base_pos", "base_scale_log")
            self.steps = {name: float(pixel_tables.numbers([steps.get(name)], 1)[0]) for name in names}
            self.spans = _spans(about["gops"], self.frames)
            stream.seek(begin)
            self._changing, self._base = _static(exactly(stream, size), self.count)
        self.clip = Clip(self.frames, frame_rate(about.get("fps"), 30.0))
        self._group, self._streams = -1, dict[tuple[int, int], np.ndarray]()
        self._at, self._now = -1, dict[int, np.ndarray]()

    def frame(self, i: int) -> GaussianModel:
        """The model of frame i."""
        with self._lock:
            number = next(g for g, span in enumerate(self.spans) if span.first <= i <= span.last)
            span = self.spans[number]
            if number != self._group:
                self._group = -1
                self._streams = self._read(span)
                self._group, self._at = number, -1
            if not 0 <= self._at <= i - span.first:
                self._at, self._now = 0, {a: packing.signed(key) for (a, kind), key in self._streams.items() if kind == KEY}
            while self._at < i - span.first:
                for a, values in self._now.items():
                    changes = self._streams[a, CHANGE].reshape(-1, *values.shape)[self._at]
                    self._now[a] = values + packing.signed(changes)
                self._at += 1
            return self._model()

    def _read(self, span: _Span) -> dict[tuple[int, int], np.ndarray]:
        """The streams of a group, by attribute and kind, unsigned: [M, C] and [(frames - 1) M, C] of the M Gaussians that change."""
        with open_file(self.path) as stream:
            stream.seek(span.begin)
            data = exactly(stream, span.length)
        listed, found = int.from_bytes(data[:2], "little"), {}
        at = 2 + listed * STREAM.size
        for attribute, kind, width, count, size in STREAM.iter_unpack(data[2:at]):
            if attribute >= len(CHANNELS) or kind not in (KEY, CHANGE) or (attribute, kind) in found:
                raise FastGSError("a group of frames has something unknown in it; the file is damaged.")
            rows = len(self._changing[attribute]) * (span.last - span.first if kind == CHANGE else 1)
            found[attribute, kind] = _numbers(data[at:at + size], width, count, rows * CHANNELS[attribute]).reshape(-1, CHANNELS[attribute])
            at += size
        for attribute, changing in enumerate(self._changing):
            kinds = (KEY, CHANGE) if span.last > span.first else (KEY,)
            if len(changing) and not all((attribute, kind) in found for kind in kinds):
                raise FastGSError("a group of frames lacks an attribute that changes; copy or export the file again.")
        return {key: values for key, values in found.items() if len(self._changing[key[0]])}

    def _model(self) -> GaussianModel:
        values = []
        for attribute, (base, changing) in enumerate(zip(self._base, self._changing)):
            fine = self.steps[f"base_{STEPS[attribute]}"] if attribute in (POSITION, SCALE) else 1
            out = base * np.float64(fine)
            if len(changing):
                out[changing] = self._now[attribute] * np.float64(self.steps[STEPS[attribute]])
            values.append(np.clip(out, 0, 255) if attribute in (COLOUR, OPACITY) else out)
        rotation = values[ROTATION] / 128
        rotation[~rotation.any(1)] = (1, 0, 0, 0)
        opacity = logits()[np.rint(values[OPACITY][:, 0]).astype(np.intp)]
        return GaussianModel(position=values[POSITION], rotation=rotation, scale=values[SCALE], opacity=opacity,
                             features=values[COLOUR] / 255, appearance=RGB())


def _spans(listed: list[dict], frames: int) -> list[_Span]:
    """The groups of frames; raises FastGSError unless they follow each other."""
    spans, following = [], 0
    for entry in listed:
        span = _Span(*(whole_number(entry.get(key), f"the {key} of a group of frames") for key in ("offset", "len", "f0", "f1")))
        damaged_if(span.first != following or span.last < following, "its groups of frames do not follow each other")
        following = span.last + 1
        spans.append(span)
    damaged_if(following != frames or not 1 <= frames <= MOST_FRAMES, f"its groups hold {following} frames, and its header says {frames}")
    return spans


def _static(data: bytes, n: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """For each attribute the places [M] of the Gaussians whose value changes, and whole numbers [N, C] of all."""
    at = 0

    def following(count: int) -> np.ndarray:
        nonlocal at
        _, _, width, numbers, size = STREAM.unpack_from(data, at)
        at += STREAM.size + size
        return _numbers(data[at - size:at], width, numbers, count)

    masks = [np.unpackbits(following(-(-n // 8)).astype(np.uint8), count=n) for _ in CHANNELS]
    place, size = (np.cumsum(packing.signed(following(3 * n).reshape(n, 3)), 0) for _ in range(2))
    colour, opacity, rotation = (following(c * n).reshape(n, c).astype(np.int64) for c in (3, 1, 4))
    return [np.flatnonzero(mask == 0) for mask in masks], [place, rotation - 128, colour, opacity, size]


def _numbers(packed: bytes, width: int, count: int, wanted: int) -> np.ndarray:
    """The `wanted` unsigned numbers of a stream."""
    damaged_if(width not in (1, 2, 4) or count != wanted, f"a stream in it has {count} numbers of {width} bytes instead of {wanted}")
    return packing.joined(packing.unzstd(packed, count * width, "a stream in it"), width)

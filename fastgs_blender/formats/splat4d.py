# SPDX-License-Identifier: GPL-3.0-or-later
"""`.splat4d` of gsplat-unity and FreeTimeGsVanilla: two layouts of the same records of 64 bytes.

A record: position, scale (3 float32 each), RGB and opacity, quaternion w x y z ((b - 128) / 128) as bytes, velocity (3 float32, per unit of
time), time, duration, 12 bytes unused.  Time is normalised, 0..1.  A record is seen either within the window time..time + duration, or with
exp(-((t - time) / duration)^2 / 2) as long as that is not under a cutoff.

* Layout 1 has records and nothing else.  It is of windows, unless more than 1 % of its times or durations lie outside 0..1, as
  gsplat-unity decides it; then the cutoff is 0.01.
* Layout 2 (magic SPL4DV02) has a header of 64 bytes, which says which of both it is, and a table of sections at its end: RECS the
  records, META the cutoff and the palettes of spherical harmonics, SHCT a palette, SHLB the Gaussians' entries in it, SHDL how these
  change from frame to frame (only the first frame's are read).
"""
import struct
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..model.appearance import RGB, SH, SH_C0
from ..model.gaussians import GaussianModel
from ..util.errors import FastGSError, LossWarning
from ..util.reading import damaged_if, read_bytes
from .base import Format
from .ftgs import FRAMES, clip_of
from .static import read_whole
from .straight import logit, straight

MAGIC = b"SPL4DV02"
HEADER, META = struct.Struct("<8s8I3Q"), struct.Struct("<IfII12I")
SECTION = np.dtype([("kind", "S4"), ("band", "<u4"), ("start", "<u4"), ("frames", "<u4"), ("offset", "<u8"), ("length", "<u8")])
RECORD = np.dtype([("position", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4), ("velocity", "<f4", 3),
                   ("time", "<f4"), ("duration", "<f4"), ("unused", "V12")])
WINDOW, BELL = 1, 2
CUTOFF = 0.01
SAMPLE = 64
"""Records that are looked at to tell layout 1 from any other file."""
DELTA_HEADER = 28
"""Bytes before the updates of a section SHDL."""
LARGEST = 64 << 30


class Splat4d(Format):
    name = "splat4d"
    reads = (".splat4d",)

    def sniff(self, head: bytes, path: Path) -> bool:
        return head.startswith(MAGIC) or _records_only(head, path)

    def load(self, path: Path) -> GaussianModel:
        data = read_bytes(path, LARGEST)
        if data.startswith(MAGIC):
            return _with_sections(data, path)
        damaged_if(len(data) % RECORD.itemsize, "the file is cut short within a record")
        records = np.frombuffer(data, RECORD)
        odd = [np.mean((records[key] < 0) | (records[key] > 1)) > 0.01 for key in ("time", "duration")]
        return _model(records, BELL if any(odd) else WINDOW, CUTOFF, None, FRAMES)


def _records_only(head: bytes, path: Path) -> bool:
    """Whether a file without a magic holds records of layout 1: the first ones are sound in every way that can be seen."""
    if len(head) < RECORD.itemsize:
        return False
    if path.stat().st_size % RECORD.itemsize:
        return False
    records = np.frombuffer(read_whole(path, SAMPLE * RECORD.itemsize), RECORD)
    with np.errstate(all="ignore"):
        norm = np.linalg.norm((records["rotation"].astype(np.float64) - 128) / 128, axis=1)
        numbers = np.concatenate([records["position"], records["velocity"], records["time"][:, None]], 1)
        sound = (np.abs(norm - 1) < 0.05) & (np.abs(numbers) < 1e6).all(1) & (records["unused"] == np.void(bytes(12)))
        sound &= (records["scale"] > 0).all(1) & (records["scale"] < 1e6).all(1) & (records["duration"] >= 0) & (records["duration"] < 1e6)
    return bool(sound.all())


def _with_sections(data: bytes, path: Path) -> GaussianModel:
    """The model of a file of layout 2."""
    _, version, size, count, record_size, n, bands, time_model, frames, table, _, _ = HEADER.unpack_from(data)
    if version != 2 or size != HEADER.size or record_size != RECORD.itemsize:
        raise FastGSError(f"its version {version} or its sizes are not those of layout 2; export it again.")
    if bands > 3 or time_model not in (WINDOW, BELL):
        raise FastGSError(f"its header says {bands} bands of spherical harmonics and time model {time_model}; the file is damaged.")
    sections = _sections(data, table, count)
    records = np.frombuffer(_one(data, sections, b"RECS"), RECORD) if n else np.zeros(0, RECORD)
    damaged_if(len(records) != n, f"its header says {n} Gaussians, and there are {len(records)}")
    _, cutoff, _, _, *palettes = META.unpack_from(_one(data, sections, b"META"))
    if not 0 < cutoff < 1:
        cutoff = CUTOFF
    higher = [_band(data, sections, band, palettes[4 * band - 4:4 * band], n) for band in range(1, bands + 1)]
    if _changing(data, sections):
        warnings.warn(LossWarning(f"{path}: its view-dependent colour changes in time, and the first frame's is kept."), stacklevel=4)
    return _model(records, time_model, cutoff, higher, frames or FRAMES)


def _model(records: np.ndarray, time_model: int, cutoff: float, higher: list[np.ndarray] | None, frames: int) -> GaussianModel:
    """The model of records [N]; higher: the coefficients [N, 2 b + 1, 3] of the bands of spherical harmonics, or None."""
    time, duration = records["time"].astype(np.float64), records["duration"].astype(np.float64)
    with np.errstate(all="ignore"):
        if time_model == WINDOW:
            time, duration = np.clip(time, 0, 1), np.clip(duration, 0, 1)
            ln_sigma, window = np.full(len(records), np.inf), (time, time + duration)
        else:
            sigma = np.maximum(duration, 1e-6)
            reach = sigma * np.sqrt(-2 * np.log(cutoff))
            ln_sigma, window = np.log(sigma), (time - reach, time + reach)
        lives = straight(records["position"], records["velocity"], time, ln_sigma, window=window, closed=True)
        scale = np.log(records["scale"])
    rgba, rotation = records["rgba"] / np.float32(255), (records["rotation"].astype(np.float32) - 128) / 128
    rotation[~rotation.any(1)] = (1, 0, 0, 0)
    if higher:
        features = np.concatenate([(rgba[:, None, :3] - 0.5) / SH_C0, *higher], 1).reshape(len(records), -1)
        appearance: RGB | SH = SH(len(higher))
    else:
        features, appearance = rgba[:, :3], RGB()
    return GaussianModel(**lives, rotation=rotation, scale=scale, opacity=logit(rgba[:, 3]), features=features, appearance=appearance,
                         clip=clip_of(min(frames, 10_000_000)))


def _sections(data: bytes, table: int, count: int) -> np.ndarray:
    """The table of sections, every one of them within the file."""
    magic, version, own_count, _ = struct.unpack_from("<4s3I", data, table)
    damaged_if(magic != b"SECT" or version != 1 or own_count != count, "its table of sections is damaged")
    sections = np.frombuffer(data, SECTION, count, table + 16)
    size = np.uint64(len(data))
    if np.any((sections["offset"] > size) | (sections["length"] > size - np.minimum(sections["offset"], size))):
        raise FastGSError("the file is cut short, or its header is damaged; copy or export it again.")
    return sections


def _one(data: bytes, sections: np.ndarray, kind: bytes, band: int = 0) -> memoryview:
    """The bytes of the first section of a kind and band."""
    found = sections[(sections["kind"] == kind) & (sections["band"] == band)]
    damaged_if(not len(found), f"its section {kind.decode()} is missing")
    first = found[np.argmin(found["start"])]
    return memoryview(data)[int(first["offset"]):int(first["offset"]) + int(first["length"])]


def _band(data: bytes, sections: np.ndarray, band: int, palette: Sequence[int], n: int) -> np.ndarray:
    """The coefficients [N, 2 band + 1, 3] of a band of spherical harmonics."""
    entries, kind, _, _ = palette
    terms, code = 2 * band + 1, {1: "<f2", 2: "<f4"}.get(kind)
    colours, labels = _one(data, sections, b"SHCT", band), _one(data, sections, b"SHLB", band)
    if code is None or not entries or len(colours) != entries * terms * 3 * np.dtype(code).itemsize or len(labels) != 2 * n:
        raise FastGSError(f"the spherical harmonics of band {band} have not the size that the header says; export the file again.")
    label = np.frombuffer(labels, "<u2")
    damaged_if(label.max(initial=0) >= entries, f"a Gaussian has an entry beyond the {entries} spherical harmonics of band {band}")
    return np.frombuffer(colours, code).astype(np.float32).reshape(entries, terms, 3)[label]


def _changing(data: bytes, sections: np.ndarray) -> bool:
    """Whether labels change in time: later segments with other labels, or updates within one."""
    for band in (1, 2, 3):
        labels, updates = (sections[(sections["kind"] == kind) & (sections["band"] == band)] for kind in (b"SHLB", b"SHDL"))
        begin = _spans(data, labels)
        if any(data[a:b] != data[begin[0][0]:begin[0][1]] for a, b in begin):
            return True
        if any(data[a + DELTA_HEADER:b].strip(b"\0") for a, b in _spans(data, updates)):
            return True
    return False


def _spans(data: bytes, sections: np.ndarray) -> list[tuple[int, int]]:
    """Where sections begin and end, each span once."""
    spans = sorted({(int(s["offset"]), int(s["offset"]) + int(s["length"])) for s in sections})
    damaged_if(sum(b - a for a, b in spans) > len(data), "sections in it lie in one another")
    return spans

# SPDX-License-Identifier: GPL-3.0-or-later
"""`.sog4d` of gsplat-unity and FreeTimeGsVanilla, versions 1 and 2: the same Gaussians on each frame of a clip, in pictures in a zip.

Streams, each a picture a frame, whose name has the frame's number of five digits where the template says {frame}:
position 16 bits between the frame's own bounds; scale a number of 16 bits in a table; rotation w x y z, (b - 128) / 128; sh0 a number in a
table of 256 for each channel, and the opacity.  Higher harmonics: a number of 16 bits in a palette, one palette for all (version 1) or
one for each band (version 2); a picture a frame, or the first frame of a run with a list of changes ("delta-v1").
Frames lie at equal steps of normalised time, or at times of their own; what lies between two is as gsplat-unity interpolates it, which is
how sequences do it.
"""
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..model.appearance import SH
from ..model.gaussians import GaussianModel
from ..model.sequence import FreeClip, Source
from ..util.errors import FastGSError
from ..util.reading import damaged_if
from . import pixel_tables as tables
from .base import Loader
from .description import whole_number
from .frame_names import MOST_FRAMES
from .sequences import SequenceFormat, within
from .static import logits, plausible_count

BANDS = {"sh1": 3, "sh2": 5, "sh3": 7}
"""Coefficients of each band."""
CENTROIDS = {"f16": "<f2", "f32": "<f4"}
DELTA = struct.Struct("<8s5I")
DELTA_MAGIC = b"SOG4DLB1"
JUMP = 1e-4
"""Frames between two that are at one time."""
UPDATE = np.dtype([("gaussian", "<u4"), ("label", "<u2"), ("unused", "<u2")])


@dataclass(frozen=True)
class _Layout:
    """What meta.json says of all frames: count and frames, at [F] in frames, low and high [F, 3], scales [K, 3] ln, and its streams."""

    count: int
    frames: int
    at: np.ndarray
    bounds: tuple[np.ndarray, np.ndarray]
    scales: np.ndarray
    streams: dict
    palettes: list[dict]


class Sog4dFrames(SequenceFormat):
    name = "SOG4D (gsplat-unity)"
    reads = (".sog4d",)

    def sniff(self, head: bytes, path: Path) -> bool:
        meta = tables.meta_of(head, path)
        return meta.get("format") == "sog4d" or {"streams", "splatCount", "frameCount"} <= meta.keys()

    def open(self, path: Path, load: Loader) -> Source:
        with tables.opened(path) as files:
            layout = _layout(files.meta(), files)

        def read(i: int) -> GaussianModel:
            with tables.opened(path) as files:
                return _frame(layout, i, files)

        return within(path, FreeClip(max(1, layout.frames - 1)), layout.at, read, alike=True)


def _layout(meta: dict, files: tables.Folder) -> _Layout:
    version = meta.get("version", 1)
    if version not in (1, 2):
        raise FastGSError(f"it is of version {str(version)[:20]}; versions 1 and 2 are read.")
    if not isinstance(files, tables.Archive):
        raise FastGSError("its pictures lie beside it, and they are read from one .sog4d file; pack its folder as a zip file.")
    count, frames = (whole_number(meta.get(key), f"its {key}") for key in ("splatCount", "frameCount"))
    streams, shape = tables.part(meta, "streams"), tables.part(meta, "layout")
    if not 1 <= frames <= min(MOST_FRAMES, len(files.members)):
        raise FastGSError(f"it says that it has {frames} frames, and holds {len(files.members)} files; copy or export it again.")
    plausible_count(count, files.length)
    if shape.get("type") != "row-major" or whole_number(shape.get("width"), "width") * whole_number(shape.get("height"), "height") < count:
        raise FastGSError("its layout holds fewer Gaussians than it says, or is of an unknown type; export it again.")
    place, sizes, colours = (tables.part(streams, key) for key in ("position", "scale", "sh"))
    low, high = (_triples(place.get(key), frames, f"position {key}") for key in ("rangeMin", "rangeMax"))
    listed = sizes.get("codebook")
    scales = _triples(listed, len(listed) if isinstance(listed, list) else 0, "scale codebook")
    with np.errstate(all="ignore"):
        scales = np.log(np.maximum(scales, 1e-8))
    return _Layout(count, frames, _times(meta, frames), (low, high), scales, streams, _palettes(colours, version, files))


def _times(meta: dict, frames: int) -> np.ndarray:
    """Where the frames lie [F], in frames."""
    about = tables.part(meta, "timeMapping") if "timeMapping" in meta else {}
    if about.get("type", "uniform") == "uniform":
        return np.arange(frames, dtype=np.float64)
    times = tables.numbers(about.get("frameTimesNormalized"), frames)
    if len(times) != frames or np.any(np.diff(times) < 0) or times[0] < 0 or times[-1] > 1:
        raise FastGSError("the times of its frames do not increase from 0 to 1; export it again.")
    later = np.searchsorted(times, times, side="right") - 1 - np.arange(frames)  # of frames at one time the last counts from there on
    return times * max(1, frames - 1) - JUMP * later


def _triples(values: Any, count: int, what: str) -> np.ndarray:
    """Triples [count, 3], written as {x, y, z} or as lists; the list may be longer."""
    rows = [[value.get(axis) for axis in "xyz"] if isinstance(value, dict) else value for value in values[:count]]
    return np.stack([tables.numbers(row, 3)[:3] for row in rows])


def _palettes(about: dict, version: int, files: tables.Folder) -> list[dict]:
    """For each palette of higher harmonics its centroids [K, C, 3], and where its labels are."""
    bands, parts = whole_number(about.get("bands", 0), "its bands"), list[tuple[dict[str, Any], int]]()
    if bands > len(BANDS):
        raise FastGSError(f"it has {bands} bands of spherical harmonics; at most {len(BANDS)} are read.")
    if version == 1 and bands:
        keys = ("count", "centroidsType", "centroidsPath", "labelsPath", "deltaSegments")
        parts = [({key: about.get(f"shN{key[0].upper()}{key[1:]}") for key in keys}, (bands + 1) ** 2 - 1)]
    else:
        parts = [(tables.part(about, name), width) for name, width in list(BANDS.items())[:bands]]
    found = []
    for part, width in parts:
        code, entries = CENTROIDS.get(str(part.get("centroidsType"))), whole_number(part.get("count"), "the length of its palette")
        data = files.read(part["centroidsPath"])
        if code is None or entries * width * 3 * np.dtype(code).itemsize != len(data):
            raise FastGSError("a palette of its spherical harmonics has not the size that it says; export it again.")
        found.append({"centroids": np.frombuffer(data, code).astype(np.float32).reshape(entries, width, 3), **{
            key: part.get(key) for key in ("labelsPath", "deltaSegments")}})
    return found


def _picture(files: tables.Folder, template: Any, frame: int, count: int) -> np.ndarray:
    """The pixels [N, 4] of a stream at a frame."""
    return tables.pixels(files, template.replace("{frame}", f"{frame:05}"), count)


def _frame(layout: _Layout, i: int, files: tables.Folder) -> GaussianModel:
    n, streams = layout.count, layout.streams
    place, colour = streams["position"], streams["sh"]
    share = (_picture(files, place.get("loPath"), i, n) + 256.0 * _picture(files, place.get("hiPath"), i, n))[:, :3] / 65535
    low, high = (bound[i] for bound in layout.bounds)
    size = _labels(_picture(files, streams["scale"].get("indicesPath"), i, n), len(layout.scales), "scale")
    rotation = (_picture(files, tables.part(streams, "rotation").get("path"), i, n) - 128) / 128
    rotation[~rotation.any(1)] = (1, 0, 0, 0)
    pixels = _picture(files, colour.get("sh0Path"), i, n)
    features = [tables.table(colour, "sh0Codebook")[pixels[:, :3]][:, None]]
    features += [palette["centroids"][_palette_labels(palette, i, n, files)] for palette in layout.palettes]
    joined = np.concatenate(features, 1)
    return GaussianModel(position=low + share * (high - low), rotation=rotation, scale=layout.scales[size], opacity=logits()[pixels[:, 3]],
                         features=joined.reshape(n, -1), appearance=SH(round(np.sqrt(joined.shape[1])) - 1))


def _labels(pixels: np.ndarray, entries: int, what: str) -> np.ndarray:
    label = pixels[:, 0] + 256 * pixels[:, 1]
    damaged_if(label.max(initial=0) >= entries, f"a Gaussian has a number beyond the {entries} entries of its {what} table")
    return label


def _palette_labels(palette: dict, i: int, n: int, files: tables.Folder) -> np.ndarray:
    """The numbers [N] of a palette's entries at frame i."""
    entries = len(palette["centroids"])
    if not palette["deltaSegments"]:
        return _labels(_picture(files, palette["labelsPath"], i, n), entries, "harmonics")
    segments = palette["deltaSegments"]
    spans = [tuple(whole_number(s.get(key), "a run of labels") for key in ("startFrame", "frameCount")) for s in segments]
    found = next(((s, *span) for s, span in zip(segments, spans) if span[0] <= i < sum(span)), None)
    if found is None:
        raise FastGSError(f"no run of labels has its frame {i}; export it again.")
    segment, begin, length = found
    labels = _labels(tables.pixels(files, segment["baseLabelsPath"], n), entries, "harmonics").copy()
    data = memoryview(files.read(segment["deltaPath"]))
    if DELTA.unpack_from(data) != (DELTA_MAGIC, 1, begin, length, n, entries):
        raise FastGSError("the header of a run of labels is not what its meta.json says; export it again.")
    at = DELTA.size
    for _ in range(i - begin):
        count, = struct.unpack_from("<I", data, at)
        updates = np.frombuffer(data, UPDATE, count, at + 4)
        if count and (updates["gaussian"].max() >= n or updates["label"].max() >= entries):
            raise FastGSError("a change of labels is of a Gaussian or an entry that does not exist; the file is damaged.")
        labels[updates["gaussian"]] = updates["label"]
        at += 4 + count * UPDATE.itemsize
    return labels

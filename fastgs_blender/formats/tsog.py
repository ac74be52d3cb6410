# SPDX-License-Identifier: GPL-3.0-or-later
"""`.tsog` of Xiaomi Research and of OpsiClear's playback profile: SOG of version 4 with a timeline, in a zip.

The pictures of SOG version 2, and for each Gaussian either a frame, in which alone it is seen (timeline type 0), or a centre and a standard
deviation in normalised time, of 16 bits each (type 1), and then also a velocity of 8 or 16 bits (temporal.means).
exp(-((t - centre) / deviation)^2 / 2), t from 0 to 1.  Sound is ignored.
"""
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..model.gaussians import Clip, GaussianModel
from ..util.arguments import shown
from ..util.errors import FastGSError
from ..util.reading import damaged_if
from . import pixel_tables as tables
from . import sog
from .base import Format
from .straight import Timeline, straight

VERSION = 4
PROFILE = "org.opsiclear.tsog-playback"
FPS, FRAMES = 30.0, 300
"""Where the file does not say others."""


class Tsog(Format):
    name = "TSOG"
    reads = (".tsog",)

    def sniff(self, head: bytes, path: Path) -> bool:
        meta = tables.meta_of(head, path)
        return meta.get("version") == VERSION and "means" in meta

    def load(self, path: Path) -> GaussianModel:
        with tables.opened(path) as files:
            meta = files.meta()
            profile = meta.get("profile", {})
            if not isinstance(profile, dict) or (profile and (profile.get("id"), profile.get("version")) != (PROFILE, 1)):
                raise FastGSError("it is of a profile that is not known; export it without one.")
            model = sog.decoded(meta | {"version": 2}, files)
            model.axes = "RUB"
            return _timed(model, meta, files)


def _timed(model: GaussianModel, meta: dict, files: tables.Folder) -> GaussianModel:
    """The static model with the file's timeline."""
    temporal, timeline = meta.get("temporal") or {}, meta.get("timeline")
    if not isinstance(temporal, dict) or set(temporal) - {"means"}:
        raise FastGSError("something besides its positions changes in time, which is not supported; export it without.")
    fps, seconds = _playback(meta)
    if timeline is None:
        return model
    kind, n = tables.part(meta, "timeline").get("type"), len(model)
    low, high = (tables.pixels(files, name, n) for name in tables.names(meta, "timeline", 2))
    code = low + 256 * high
    if kind == 0:
        frames = timeline.get("N")
        if type(frames) is not int or not 1 <= frames <= 65536 or timeline.get("delta") != 65536 // frames:
            raise FastGSError(f"its timeline of {shown(frames)} frames is damaged; export it again.")
        frame = np.minimum(frames - 1, code[:, 0] // (65536 // frames))
        lives = straight(model.position, None, np.zeros(n), np.full(n, np.inf), Timeline(length=frames), (frame, frame + 1))
        return replace(model, **lives, clip=Clip(frames, frames / seconds if seconds else fps))
    if kind != 1:
        raise FastGSError(f"its timeline is of type {shown(kind)}, and 0 and 1 are known.")
    begin, end = tables.bounds(timeline, 2)
    damaged_if(begin[1] <= 0, "its temporal deviations are not positive")
    centre, sigma = (begin + (end - begin) * code[:, :2] / 65535).T
    lives = straight(model.position, _velocity(temporal, files, n) if temporal else None, centre, np.log(sigma))
    frames = max(1, round(seconds * fps)) if seconds else FRAMES - 1
    return replace(model, **lives, clip=Clip(frames, frames / seconds if seconds else fps))


def _velocity(temporal: dict, files: tables.Folder, n: int) -> np.ndarray:
    """Velocities [N, 3] per unit of normalised time."""
    part = tables.part(temporal, "means")
    count = len(part["files"])
    damaged_if(count not in (1, 2), "its velocities have neither 8 nor 16 bits")
    planes = [tables.pixels(files, name, n)[:, :3] for name in tables.names(temporal, "means", count)]
    share = planes[0] / 255 if count == 1 else (planes[0] + 256 * planes[1]) / 65535
    rows: list[Any] = [part.get(key) for key in ("mins", "maxs")]
    if not all(isinstance(row, list) and len(row) == 1 for row in rows):
        raise FastGSError("its velocities change in time, which is not supported; export it with a constant velocity.")
    low, high = (tables.numbers(row[0], 3) for row in rows)
    return low + (high - low) * share


def _playback(meta: dict) -> tuple[float, float]:
    """Frames per second, and the length in seconds (0: not said)."""
    playback = meta.get("playback") or {}
    fps, seconds = playback.get("fps", meta.get("fps", FPS)), playback.get("duration", 0)
    if any(type(v) not in (int, float) or not 0 <= v <= 1e6 for v in (fps, seconds)) or not fps:
        raise FastGSError(f"its playback of {shown(fps)} frames per second and {shown(seconds)} seconds is damaged.")
    return float(fps), float(seconds)

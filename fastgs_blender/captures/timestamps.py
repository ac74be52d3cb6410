# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads caliscope's timestamps.csv: the time of each frame of each camera, for cameras that are not genlocked.

    sync_index,cam_id,frame_time      one row a frame, in any order; sync_index numbers the moments and may be missing; cam_id or port
    35,2,25.0009787                   is the camera, frame_time counts in seconds

The frames of a camera, ordered by their times, are the frames of its film.
"""
import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..cameras import poses
from ..util.errors import FastGSError
from ..util.reading import read_text, reading

FILE = "timestamps.csv"
LARGEST_FILE = 64 << 20
CAMERA, MOMENT, TIME = ("cam_id", "port", "camera"), "sync_index", "frame_time"
LONGEST = 1e7
"""Seconds between the first and the last frame of a clip."""


@dataclass(frozen=True)
class Times:
    """Frames and times of a capture's cameras.

    path    the file; count: of frames on the capture's time line; fps: of that time line
    frames  by camera: (frame, t) of each frame of its film, frame in 0 .. count - 1 and t in 0 .. 1
    """

    path: Path
    count: int
    fps: float
    frames: dict[str, list[tuple[int, float]]]

    def of(self, camera: str) -> list[tuple[int, float]]:
        """(frame, t) of each frame of a camera's film; none for a camera that the file does not have."""
        return self.frames.get(camera, [])


def read_times(path: Path) -> Times:
    """The times in a file; raises FastGSError."""
    with reading(path, "it is damaged or cut short; export it again"):
        rows = list(csv.DictReader(io.StringIO(read_text(path, LARGEST_FILE))))
    head = set(rows[0]) if rows else set()
    called = next((name for name in CAMERA if name in head), None)
    if called is None or TIME not in head:
        raise FastGSError(f"{path}: its first line must name the columns {CAMERA[0]} and {TIME}, and frames must follow.")
    cameras: dict[str, list[tuple[float, float]]] = {}
    for number, row in enumerate(rows, 2):
        where = f"{path}: line {number}"
        time = poses.read(row[TIME], f"{where}: its {TIME}", -1e12, 1e12)
        moment = poses.read(row[MOMENT], f"{where}: its {MOMENT}", -1e12, 1e12) if MOMENT in head else np.nan
        cameras.setdefault(str(row[called]), []).append((time, moment))
    known = {name: np.array(sorted(pairs)) for name, pairs in cameras.items()}
    return _timed(path, known, MOMENT in head)


def _timed(path: Path, known: dict[str, np.ndarray], numbered: bool) -> Times:
    """Times of the cameras' rows [F, 2] of seconds and moments."""
    times = np.concatenate([rows[:, 0] for rows in known.values()])
    begin, length = float(times.min()), float(np.ptp(times))
    most = max(map(len, known.values()))
    if most < 2 or not 0 < length < LONGEST:
        raise FastGSError(f"{path}: its {len(times)} times must be seconds of at least two moments.")
    if numbered:
        moments = {name: rows[:, 1] for name, rows in known.items()}
    else:  # the camera with most frames gives the beat, and each frame belongs to the nearest one
        beat = next(rows[:, 0] for rows in known.values() if len(rows) == most)
        between = (beat[:-1] + beat[1:]) / 2
        moments = {name: np.searchsorted(between, rows[:, 0]).astype(float) for name, rows in known.items()}
    whole = np.concatenate(list(moments.values()))
    first, last = whole.min(), whole.max()
    if last - first > 2 * len(whole) + 1000:
        raise FastGSError(f"{path}: its {MOMENT} goes from {first:g} to {last:g} in {len(whole)} rows; number the moments one by one.")
    count = int(last - first) + 1
    middle = {end: times[whole == end].mean() for end in (first, last)}
    period = float(middle[last] - middle[first]) / max(count - 1, 1)
    if not period > 0:
        raise FastGSError(f"{path}: its times do not rise with {MOMENT}; export it again.")
    frames = {}
    for name, rows in known.items():
        t = np.clip((rows[:, 0] - begin) / (period * count), 0, 1)
        frames[name] = [(int(moment - first), float(at)) for moment, at in zip(moments[name], t)]
    return Times(path, count, 1 / period, frames)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads the cameras' first clocks from their films: GPS time, or else timecode, which QuickTime keeps in a track (tmcd)."""
import re

import numpy as np

from ..capture import Capture
from ..pixels.video import index
from ..rigs import LEAST_COMMON
from .files import Clocks
from .gpmf import first_frame_utc

DAY = 86_400
GPS, TIMECODE = "GPS time", "timecode"
RIGHT_TO = {GPS: "a tenth of a second", TIMECODE: "a frame"}


def frame_of(timecode: str, fps: float) -> int | None:
    """The number of the frame since midnight that HH:MM:SS:FF names; None where it is no timecode.

    Before FF, ";" or "." says that numbers are dropped (SMPTE 12M): at 29.97 the first two of each minute but every tenth, at 59.94 four.
    """
    parts = re.fullmatch(r"(\d\d):(\d\d):(\d\d)([:;.])(\d\d)", timecode.strip())
    if parts is None:
        return None
    hours, minutes, seconds, frames = (int(parts[n]) for n in (1, 2, 3, 5))
    beat, minute = round(fps), 60 * hours + minutes
    dropped = round(beat / 15) * (minute - minute // 10) if parts[4] != ":" else 0
    return (60 * minute + seconds) * beat + frames - dropped


def first_clocks(capture: Capture) -> Clocks | None:
    """The clocks that the films themselves tell, of a capture that was opened without offsets: in whole frames, their median 0.

    They are the satellites' where all films have them (gpmf.py), else the timecode's.  None where a film has neither, rates differ, all
    begin alike, or the films would have less than half of the longest in common: clocks that nobody set say nothing.  Raises FastGSError
    where a film cannot be read.
    """
    first = {shot.view: shot for shot in reversed(capture.shots)}
    if any(shot.image.frame is None for shot in first.values()):
        return None
    known = [index(shot.image.path) for shot in first.values()]
    fps = known[0].fps
    if max(abs(each.fps - fps) for each in known) > 0.01:
        return None
    begun = [utc for shot in first.values() if (utc := first_frame_utc(shot.image.path)) is not None]
    by_gps = len(begun) == len(first)
    starts = np.array([utc * fps for utc in begun] if by_gps else [frame_of(each.timecode, fps) for each in known], float)
    if not np.isfinite(starts).all():
        return None
    late = starts - starts[0]
    if not by_gps:
        day = round(fps) * DAY
        late = (late + day / 2) % day - day / 2  # past midnight
    late = np.round(late - np.round(np.median(late)))
    counts = np.array([sum(shot.view == view for shot in capture.shots) for view in first])
    common = (late + counts).min() - late.max()
    if not late.any() or common < LEAST_COMMON * counts.max():
        return None
    return Clocks(dict(zip(first, late.tolist())), found_by=GPS if by_gps else TIMECODE)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads the cameras' first clock from the timecode of their films: QuickTime's track of it (tmcd), which GoPros and most others write."""
import re
from collections.abc import Mapping

import numpy as np

from ..capture import Capture
from ..pixels.video import index
from ..rigs import LEAST_COMMON

DAY = 86_400


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


def timecode_offsets(capture: Capture) -> Mapping[str, float]:
    """The offsets of the films of a capture that was opened without any, in whole frames, their median 0.

    None, an empty table, where a film has no timecode, rates differ, all begin alike, or the films would have less than half of the longest
    in common: clocks that nobody set say nothing.  Raises FastGSError where a film cannot be read.
    """
    first = {shot.view: shot for shot in reversed(capture.shots)}
    if any(shot.image.frame is None for shot in first.values()):
        return {}
    known = {view: index(shot.image.path) for view, shot in first.items()}
    fps = next(iter(known.values())).fps
    starts = [frame_of(each.timecode, fps) for each in known.values()]
    if None in starts or len(set(starts)) < 2 or max(abs(each.fps - fps) for each in known.values()) > 0.01:
        return {}
    day = round(fps) * DAY
    late = np.array(starts, float) - starts[0]
    late = (late + day / 2) % day - day / 2  # past midnight
    late -= np.round(np.median(late))
    counts = np.array([sum(shot.view == view for shot in capture.shots) for view in first])
    common = (late + counts).min() - late.max()
    return dict(zip(first, late.tolist())) if common >= LEAST_COMMON * counts.max() else {}

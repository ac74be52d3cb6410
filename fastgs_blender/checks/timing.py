# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks synchronisation: whether frames of the same number show the same moment in all cameras."""
from ..captures.clocks.curves import activity, moving
from ..captures.clocks.find import LEAST, Found, find_offsets
from ..captures.evidence import differs
from ..util.errors import FastGSError
from . import drawing
from .report import Section, listed
from .samples import Inspection

FRAMES = 96
"""Frames that are looked at, from the middle of the clip: enough for shifts of half of them."""
LEAST_FRAMES = 16


def run(inspection: Inspection) -> Section:
    """The offset of each camera's clock, by sound, a flash or motion (captures.clocks)."""
    capture = inspection.capture
    count = capture.clip.frame_count
    section = Section("Synchronisation", "How many frames each camera's clock is ahead of or behind the others', from sound, a flash, or "
                      f"how much moves in each frame{f'; the middle {FRAMES} frames were looked at' if count > FRAMES else ''}.")
    if count < LEAST_FRAMES or len(capture.views) < 2:
        section.summary = f"{count} frames of {len(capture.views)} cameras are too few to compare their clocks."
        return section
    try:
        found = find_offsets(capture.middle(FRAMES), progress=lambda done, of: inspection.progress("comparing clocks", done / max(of, 1)),
                             misplaced=inspection.misplaced)
    except FastGSError as error:
        reason = str(error).partition(": ")[2] or str(error)
        section.add("note", f"The cameras' clocks could not be compared: {reason}", "If something fast moves in the clip, try fastgs sync "
                    "on that part of it; else look at two cameras side by side.")
        return section
    _judge(section, found)
    if found.curves is not None:
        lines = {found.curves.views[k]: activity(found.curves.change[k]) for k in moving(found.curves)}
        if lines:
            section.pictures.append(drawing.curves("How much moves from frame to frame, as it is compared: the curves of cameras that run "
                                                   "together rise and fall together.", lines, "frames", "motion", found.curves.first))
    spread = found.clocks.uncertainty
    offsets = {view: found.measured[view] for view in capture.views if view in spread and view not in found.lost}
    section.columns = {"Clock": {view: f"{offsets[view]:+.2f} ± {spread[view]:.2f} frames" if view in offsets else "unsure"
                                 for view in capture.views}}
    section.measures = {"offsets_frames": {view: round(value, 4) for view, value in offsets.items()}, "found_by": found.clocks.found_by,
                        "uncertainty_frames": {view: round(value, 4) for view, value in spread.items()},
                        "unknown": list(found.lost)}
    return section


def _judge(section: Section, found: Found) -> None:
    for view, deviation in found.clocks.uncertainty.items():
        value = found.measured[view]
        if view in found.lost or not differs(value, deviation, LEAST):
            continue
        way = "ahead of" if value > 0 else "behind"
        section.add("wrong" if abs(value) >= 0.5 else "poor", f"{view} is {abs(value):.2f} frames {way} the others (found by "
                    f"{found.clocks.found_by}, give or take {deviation:.2f}): what moves is seen at two places at once.", "fastgs sync "
                    "writes the offsets beside the capture, and training uses them; next time, start all cameras by a genlock or a "
                    "trigger.", [view], ("offset", round(value, 3), "frames"))
    if found.lost:
        section.add("note", f"Unsure: the clock of {listed(found.lost)} could not be compared well enough with the others'. Too little "
                            "moves there, it looks too different, or the camera's pose is wrong. Training leaves it as it is.",
                    "Look at those cameras beside another one at a fast movement.", found.lost)

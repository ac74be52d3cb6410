# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks the files of a capture: missing or unreadable files, wrong sizes, different frame rates."""
from ..captures.pixels.checks import problems
from .report import Section
from .samples import Inspection

MOST = 12


def run(inspection: Inspection) -> Section:
    """What `fastgs train` would refuse the capture for, and remarks on how it was read."""
    capture = inspection.capture
    found = list(dict.fromkeys([*problems(capture), *inspection.unreadable]))
    section = Section("Files", f"{len(capture)} pictures of {len(capture.views)} cameras over {capture.clip.frame_count} frames; the "
                      "headers of all files were read.")
    for problem in found[:MOST]:
        section.add("wrong", f"{problem[:1].upper()}{problem[1:].rstrip('.')}.", "Copy or export these files again, or leave the camera "
                                                                                 "or the frames out.")
    if len(found) > MOST:
        section.add("wrong", f"There are {len(found) - MOST} more problems with files.", "fastgs info lists them all.")
    for note in capture.notes:
        section.add("note", f"Of the layout: {note}.", "Nothing need be done if that is what you meant.")
    section.measures = {"problems": found, "notes": list(capture.notes)}
    return section

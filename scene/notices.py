# SPDX-License-Identifier: GPL-3.0-or-later
"""Messages to the user: a report in Blender and a line in the log."""
from __future__ import annotations

import logging

log = logging.getLogger(__package__)

_said: set[str] = set()


def warn(engine, text: str):
    """Say something once in a render job, however many frames it has.  A warning leaves the render going."""
    if text not in _said:
        _said.add(text)
        log.warning(text)
        engine.report({'WARNING'}, text)


def fail(engine, text: str):
    """Say why there is no picture.  Only an error report keeps Blender from writing a black file and calling it finished."""
    log.error(text)
    engine.report({'ERROR'}, text)


def begin_job():
    """Forget what was said."""
    _said.clear()

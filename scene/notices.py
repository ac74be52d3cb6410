# SPDX-License-Identifier: GPL-3.0-or-later
"""Reports messages to the user in Blender and writes them to the log."""
from __future__ import annotations

import logging

from ..fastgs_blender.util.errors import printable

log = logging.getLogger(__package__)

_said: set[str] = set()


def warn(engine, text: str):
    """Report a warning, once in a render job however many frames it has, and log it.  The render continues."""
    text = printable(text)  # Blender refuses to report what is no UTF-8
    if text not in _said:
        _said.add(text)
        log.warning(text)
        engine.report({'WARNING'}, text)


def fail(engine, text: str):
    """Report and log why there is no picture.  Only an error report keeps Blender from writing a black file and calling it finished."""
    text = printable(text)
    log.error(text)
    engine.report({'ERROR'}, text)


def begin_job():
    """Forget which warnings were reported: a new render job begins."""
    _said.clear()

# SPDX-License-Identifier: GPL-3.0-or-later
"""Reports messages to the user in Blender and writes them to the log."""
import logging
import textwrap
from functools import partial

import bpy

from ..fastgs_blender.util.errors import printable

log = logging.getLogger(__package__)

_reported: set[str] = set()

WIDTH = 80
"""Characters in a line of a pop-up."""


def tell(text: str):
    """Log a sentence that no operator can report, and show it where there is a window."""
    text = printable(text)
    log.warning(text)
    if not bpy.app.background:
        bpy.app.timers.register(partial(_pop_up, text), first_interval=0.0)


def _pop_up(text):
    def draw(self, context):
        for line in textwrap.wrap(text, WIDTH):
            self.layout.label(text=line)

    manager = bpy.context.window_manager
    if manager.windows:
        with bpy.context.temp_override(window=manager.windows[0]):  # a timer has none, and Blender crashes without one
            manager.popup_menu(draw, title="FAST-GS", icon='INFO')


def draw_trouble(layout, context, text: str, icon: str = 'ERROR'):
    """Draw a sentence with an icon, on several lines where the region is narrow: Blender's labels do not wrap."""
    width = context.region.width / (context.preferences.system.ui_scale or 1.0)
    column = layout.column(align=True)
    for k, line in enumerate(textwrap.wrap(text[:1].upper() + text[1:], max(int((width - 60) / 6.5), 20))):
        column.label(text=line, icon='BLANK1' if k and icon != 'NONE' else icon, translate=False)


def warn(engine, text: str):
    """Report a warning, once in a render job however many frames it has, and log it.  The render continues."""
    _report_once(engine, 'WARNING', text)


def inform(engine, text: str):
    """Report what a user may want to know, once in a render job, and log it."""
    _report_once(engine, 'INFO', text)


def _report_once(engine, kind: str, text: str):
    text = printable(text)  # Blender refuses to report what is no UTF-8
    if text not in _reported:
        _reported.add(text)
        log.log(getattr(logging, kind), text)
        engine.report({kind}, text)


def fail(engine, text: str):
    """Report and log why there is no picture.  Only an error report keeps Blender from writing a black file and calling it finished."""
    text = printable(text)
    log.error(text)
    engine.report({'ERROR'}, text)


def redraw(*kinds: str) -> None:
    """Draw the areas of these types again, in all windows."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in kinds:
                area.tag_redraw()


def begin_job():
    """Forget which warnings were reported: a new render job begins."""
    _reported.clear()

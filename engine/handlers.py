# SPDX-License-Identifier: GPL-3.0-or-later
"""What happens when a render job begins and when another file is opened."""
import bpy
from bpy.app.handlers import persistent

from . import notices, objects


@persistent
def _begin_job(*_):
    notices.begin_job()


@persistent
def _forget_models(*_):
    objects.clear()


HANDLERS = (
    (bpy.app.handlers.render_init, _begin_job),
    (bpy.app.handlers.load_pre, _forget_models),
)


def register():
    for handlers, function in HANDLERS:
        handlers.append(function)


def unregister():
    for handlers, function in HANDLERS:
        handlers.remove(function)
    objects.clear()

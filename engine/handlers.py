# SPDX-License-Identifier: GPL-3.0-or-later
"""What happens when Blender opens another file: the models of the last one are freed."""
import bpy
from bpy.app.handlers import persistent

from . import objects


@persistent
def _on_load(*_):
    objects.clear()


def register():
    bpy.app.handlers.load_pre.append(_on_load)


def unregister():
    bpy.app.handlers.load_pre.remove(_on_load)
    objects.clear()

# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws splats in Blender's 3D viewports on the GPU."""
import bpy

from ...scene import sky, updates
from . import spaces

HANDLERS = (
    (bpy.app.handlers.depsgraph_update_post, sky.edited),
    (bpy.app.handlers.depsgraph_update_post, spaces.changed),
    (bpy.app.handlers.frame_change_post, spaces.changed),
    (bpy.app.handlers.undo_post, spaces.changed),
    (bpy.app.handlers.redo_post, spaces.changed),
    (bpy.app.handlers.load_pre, spaces.clear),
    (bpy.app.handlers.load_post, spaces.changed),
)
_drawing = None


def register():
    global _drawing
    for handlers, function in HANDLERS:
        handlers.append(bpy.app.handlers.persistent(function))
    updates.listeners.append(spaces.viewports.redraw)
    _drawing = bpy.types.SpaceView3D.draw_handler_add(spaces.viewports.post_view, (), 'WINDOW', 'POST_VIEW')


def unregister():
    global _drawing
    bpy.types.SpaceView3D.draw_handler_remove(_drawing, 'WINDOW')
    _drawing = None
    updates.listeners.remove(spaces.viewports.redraw)
    for handlers, function in HANDLERS:
        handlers.remove(function)
    spaces.viewports.stop()

# SPDX-License-Identifier: GPL-3.0-or-later
"""FAST-GS for Blender: the extension's entry.

Nothing is imported before register(), so that pytest and other tools may import this folder without Blender.
"""
import atexit
import sys


def _packages():
    from . import engine, operators, scene, ui

    return scene, engine, operators, ui


def _leave():
    # The bpy wheel closes Blender down when nothing refers to bpy any more.  Registered classes and handlers do: without this, 4.5 hangs
    # when a script ends.  4.2 never lets go of functions that properties call, nor of what their modules hold, and crashes.
    import addon_utils

    if globals().get("__addon_enabled__"):
        addon_utils.disable(__name__)
    for name, module in tuple(sys.modules.items()):
        if name.startswith(__name__):
            vars(module).pop("bpy", None)


def register():
    """Called by Blender when the extension is enabled."""
    for package in _packages():
        package.register()
    atexit.register(_leave)


def unregister():
    """Called by Blender when the extension is disabled."""
    for package in reversed(_packages()):
        package.unregister()

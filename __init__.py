# SPDX-License-Identifier: GPL-3.0-or-later
"""FAST-GS for Blender: the extension's entry.

Nothing is imported before register(), so that pytest and other tools may import this folder without Blender.
"""
import atexit


def _packages():
    from . import engine, operators, scene, ui

    return scene, engine, operators, ui


def _leave():
    # The bpy wheel closes Blender down when nothing refers to bpy any more.  Registered classes and handlers do: without this,
    # 4.2 crashes and 4.5 hangs when a script ends.
    import addon_utils

    addon_utils.disable(__name__)


def register():
    """Called by Blender when the extension is enabled."""
    for package in _packages():
        package.register()
    atexit.register(_leave)


def unregister():
    """Called by Blender when the extension is disabled."""
    atexit.unregister(_leave)
    for package in reversed(_packages()):
        package.unregister()

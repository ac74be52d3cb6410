# SPDX-License-Identifier: GPL-3.0-or-later
"""FAST-GS for Blender: the extension's entry.

Nothing is imported before register(), so that pytest and other tools may import this folder without Blender.
"""


def _packages():
    from . import engine, operators, ui

    return engine, operators, ui


def register():
    """Called by Blender when the extension is enabled."""
    for package in _packages():
        package.register()


def unregister():
    """Called by Blender when the extension is disabled."""
    for package in reversed(_packages()):
        package.unregister()

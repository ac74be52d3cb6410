# SPDX-License-Identifier: GPL-3.0-or-later
"""Redrawing the viewports when a property changes what they show.

In a module that does not hold bpy, for the reason that passes.switched gives.
"""
from __future__ import annotations

from collections.abc import Callable

listeners: list[Callable[[], None]] = []
"""Called after such a change; the viewports add themselves."""


def viewports(group, context):
    """Update callback of a property: all 3D viewports are drawn again."""
    for listener in listeners:
        listener()

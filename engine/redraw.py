# SPDX-License-Identifier: GPL-3.0-or-later
"""What properties do when they change what viewports show.

In a module that does not hold bpy, for the reason that passes.switched gives.
"""
from __future__ import annotations


def viewports(group, context):
    """Update of a property: all 3D viewports are drawn again."""
    from .viewport import spaces

    spaces.redraw()

# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's side of rendering: the render engine, the objects that it shows and their properties."""
from . import compiling, handlers, panels, properties, render_engine, settings, viewport
from .training import watch

_MODULES = (settings, properties, render_engine, panels, handlers, compiling, viewport, watch)


def register():
    for module in _MODULES:
        module.register()


def unregister():
    for module in reversed(_MODULES):
        module.unregister()

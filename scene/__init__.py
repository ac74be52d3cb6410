# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's scene as the library sees it: properties, objects, cameras, time; and what is made from it: splat objects, captures, runs."""
from . import properties, settings
from .training import watch

_MODULES = (settings, properties, watch)


def register():
    for module in _MODULES:
        module.register()


def unregister():
    for module in reversed(_MODULES):
        module.unregister()

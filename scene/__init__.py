# SPDX-License-Identifier: GPL-3.0-or-later
"""Translates Blender's scene for the library (properties, objects, cameras, time), and makes splat objects, captures and runs in it."""
from . import devices, properties, settings
from .splats import effect_assets
from .training import watch

_MODULES = (settings, properties, watch, effect_assets)


def register():
    for module in _MODULES:
        module.register()


def unregister():
    for module in reversed(_MODULES):
        module.unregister()
    devices.unregister()

# SPDX-License-Identifier: GPL-3.0-or-later
"""Shows those of Blender's own panels that make sense with our engine."""
import bpy

ENGINE = 'FASTGS'
LEFT_OUT = ("freestyle", "simplify", "FREESTYLE")
ADDED = {'EEVEE_WORLD_PT_surface', 'EEVEE_WORLD_PT_mist'}
"""Panels that Blender shows for other engines only, and that hold a setting which ours reads."""


def _fitting():
    for panel in bpy.types.Panel.__subclasses__():
        engines = getattr(panel, "COMPAT_ENGINES", None)
        if engines is None:
            continue
        name = panel.__name__
        if name in ADDED or ('BLENDER_RENDER' in engines and not any(word in name for word in LEFT_OUT)):
            yield engines


def register():
    for engines in _fitting():
        engines.add(ENGINE)


def unregister():
    for engines in _fitting():
        engines.discard(ENGINE)

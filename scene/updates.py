# SPDX-License-Identifier: GPL-3.0-or-later
"""Update callbacks of properties: viewports and the compositor follow when one of them changes.

This module does not hold bpy, because Blender 4.2 never lets go of such a function: one whose module holds bpy keeps the bpy
wheel from closing down, which then crashes at exit.
"""
from collections.abc import Callable

listeners: list[Callable[[], None]] = []
"""Called when viewports must be drawn again; the viewports add themselves."""
mesh_listeners: list[Callable[[object], None]] = []
"""Called with the scene when its *Render With Meshes* was chosen."""


def viewports(group, context):
    """Draw all 3D viewports again."""
    for listener in listeners:
        listener()


def shown(group, context):
    """Update callback of properties on Object.fastgs: evaluate again what shows the object, also where a script has set the property."""
    group.id_data.update_tag()
    viewports(group, context)


def picked(obj):
    """What is selected of an object has changed: viewports alone show it.

    The properties have no update callback: for one that has, Blender evaluates the object's mesh, and all points of it.
    """
    obj.update_tag(refresh={'OBJECT'})
    viewports(obj.fastgs, None)


def meshes(group, context):
    """Update callback of *Render With Meshes*: set up what joins splats and meshes, or take it away."""
    for listener in mesh_listeners:
        listener(group.id_data)
    viewports(group, context)


def lamps(group, context):
    """Update callback of *Splat Shadow*: each lamp has a pass."""
    for scene in context.blend_data.scenes:
        if group.id_data.name in scene.objects:
            for layer in scene.view_layers:
                layer.update_render_passes()
    shown(group, context)


def passes(group, context):
    """Update callback of properties on ViewLayer.fastgs: update the compositor's sockets to the passes that are switched on."""
    # the group cannot tell which of its scene's layers it belongs to, and context.view_layer may be another one
    for layer in group.id_data.view_layers:
        layer.update_render_passes()

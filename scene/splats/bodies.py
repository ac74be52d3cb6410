# SPDX-License-Identifier: GPL-3.0-or-later
"""Lets the points of rigid bodies rest, because Blender's simulation reads meshes while they are evaluated anew.

On its second frame a simulation is rebuilt.  Blender orders this after the evaluation of the objects' places, but not after that of
their geometry (rb_init_key in deg_builder_relations.cc).  Where the geometry depends on the time, its mesh of the last frame may be
freed while the simulation measures it, which ended Blender 5.0 within ten simulations of a proxy.  So the proxies of rigid bodies get a
group of nodes that does not depend on the time, and their edited points are written after the evaluation (feeding.py).
"""
import bpy
from bpy.app.handlers import persistent

from .. import objects, proxies
from .proxy_nodes import group, modifier_of


@persistent
def rest(scene, depsgraph=None) -> None:
    """Handler, before a frame is evaluated and after each other evaluation: give rigid bodies, and those that are none any more, their
    group of nodes.  Blender evaluates once more, without the simulation, where that changed something."""
    if depsgraph is not None and depsgraph.mode != 'VIEWPORT':  # a render's own evaluation, perhaps in a thread
        return
    for obj in bpy.data.objects:
        modifier = modifier_of(obj) if objects.is_splat(obj) and obj.is_editable else None
        wanted = proxies.STILL if obj.rigid_body else proxies.GROUP
        if modifier is not None and modifier.node_group.name.startswith(proxies.STILL) != (wanted == proxies.STILL):
            modifier.node_group = group(wanted)

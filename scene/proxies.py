# SPDX-License-Identifier: GPL-3.0-or-later
"""Hides the points of proxies in viewports where the splats themselves are drawn there.

It is one node of the Geometry Nodes groups that all proxies of a .blend share (splats/proxy_nodes.py): the points stay for final
renders of other engines, and the box around their subject stays to be selected and framed.  The setting *Splats in Viewports* decides, and
not what has been drawn so far: points never stand in for splats that are still on their way.
"""
import bpy
from bpy.app.handlers import persistent

GROUP = "FAST-GS Proxy"
STILL = f"{GROUP} (Still)"
"""The same group for rigid bodies, whose geometry must not depend on the time (splats/bodies.py)."""
SWITCH = "Hide Points in Viewports"
OFFSET = "Offset"
"""Attribute of what the group makes: where a vertex of an octahedron lies, in radii from its middle; 0 at the points themselves."""


def wanted_hidden() -> bool:
    """Whether all windows show splats themselves; without a window nobody does."""
    scenes = {window.scene for window in bpy.context.window_manager.windows}
    return not bpy.app.background and bool(scenes) and all(scene.fastgs.show_splats for scene in scenes)


@persistent
def update(*_) -> None:
    """Hide or show the points as the windows' scenes have it.  To be called where Blender's data may be written."""
    hide(wanted_hidden())


def hide(hidden: bool) -> None:
    """Hide or show the points in all viewports."""
    for node in _switches():
        if node.boolean != hidden:
            node.boolean = hidden


def up_to_date() -> bool:
    """Whether update() would change nothing."""
    wanted = wanted_hidden()
    return all(node.boolean == wanted for node in _switches())


def _switches() -> list[bpy.types.Node]:
    """The nodes of all groups that this .blend holds itself; appended ones have numbers behind their names."""
    nodes = [group.nodes.get(SWITCH) for group in bpy.data.node_groups if group.name.startswith(GROUP) and group.library is None]
    return [node for node in nodes if node is not None]

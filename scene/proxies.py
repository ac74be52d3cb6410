# SPDX-License-Identifier: GPL-3.0-or-later
"""Hides the points of proxies in viewports while the splats themselves are drawn there.

It is one node of the Geometry Nodes groups that all proxies of a .blend share (splats/proxy_nodes.py): the points stay for final
renders of other engines, and the box around their subject stays to be selected and framed.
"""
from __future__ import annotations

import bpy

GROUP = "FAST-GS Proxy"
STILL = f"{GROUP} (Still)"
"""The same group for rigid bodies, whose geometry must not depend on the time (splats/bodies.py)."""
SWITCH = "Hide Points in Viewports"
OFFSET = "Offset"
"""Attribute of what the group makes: where a vertex of an octahedron lies, in radii from its middle; 0 at the points themselves."""


def hide(hidden: bool) -> None:
    """Hide or show the points in all viewports.  To be called where Blender's data may be written."""
    for group in bpy.data.node_groups:
        node = group.nodes.get(SWITCH) if group.name in (GROUP, STILL) and group.library is None else None
        if node is not None and node.boolean != hidden:
            node.boolean = hidden


def hidden() -> bool:
    """Whether the points of all proxies are hidden."""
    switches = [group.nodes.get(SWITCH) for group in bpy.data.node_groups if group.name in (GROUP, STILL) and group.library is None]
    return all(node is None or node.boolean for node in switches)

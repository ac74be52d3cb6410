# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the node group that joins the pictures of splats and of meshes.

Where meshes hide splats, splats + meshes x the light that the holdout stops; elsewhere the nearer of
(splats over meshes, meshes over splats), by the depth of each; all of it over the world.  The splats' shadows take from the meshes what
these have of the lamp's light.
"""
from __future__ import annotations

import bpy

from .node_trees import Builder

COLOUR, NUMBER = 'NodeSocketColor', 'NodeSocketFloat'
INPUTS = (
    ("Splats", COLOUR, None), ("Splat Alpha", NUMBER, 0.0), ("Splat Depth", NUMBER, 1e10), ("Splat Holdout", NUMBER, 0.0),
    ("Splat Shadow", NUMBER, 1.0), ("Shadow Strength", NUMBER, 1.0),
    ("Meshes", COLOUR, None), ("Mesh Alpha", NUMBER, 0.0), ("Mesh Depth", NUMBER, 1e10), ("Lamp", COLOUR, None),
    ("World", COLOUR, None), ("Transparent", NUMBER, 0.0),
)
"""Sockets of the group: name, type, value where nothing is linked; nothing is transparent."""
FAINT = 1e-4
"""Light of a pixel below which it does not matter what stops it."""


def build(tree: bpy.types.NodeTree) -> None:
    """Fill an empty group of the compositor."""
    for name, kind, value in INPUTS:
        socket = tree.interface.new_socket(name=name, in_out='INPUT', socket_type=kind)
        socket.default_value = (0.0, 0.0, 0.0, 0.0) if value is None else value
        if name == "Shadow Strength":
            socket.min_value, socket.max_value, socket.subtype = 0.0, 1.0, 'FACTOR'
    tree.interface.new_socket(name="Image", in_out='OUTPUT', socket_type=COLOUR)
    b = Builder(tree)
    given, math = b.given, b.math
    shade = math('MULTIPLY', math('SUBTRACT', 1.0, given["Splat Shadow"]), given["Shadow Strength"])
    lit = _less(b, given["Meshes"], _alpha(b, 'Apply Mask', given["Lamp"], shade))
    meshes = _alpha(b, 'Replace Alpha', lit, given["Mesh Alpha"])
    # splats over (meshes x factor) = splats + straight meshes x holdout
    clear = math('MULTIPLY', math('SUBTRACT', 1.0, given["Splat Alpha"]), given["Mesh Alpha"])
    free = math('LESS_THAN', given["Splat Holdout"], FAINT)
    factor = math('ADD', math('DIVIDE', given["Splat Holdout"], clear), free)
    front = _over(b, _alpha(b, 'Apply Mask', meshes, factor), given["Splats"])
    back = _over(b, given["Splats"], meshes)
    nearer = b.node('CompositorNodeZcombine', (front, math('MULTIPLY', given["Splat Depth"], free), back, given["Mesh Depth"]))
    if hasattr(nearer, "use_alpha"):
        nearer.use_alpha = nearer.use_antialias_z = False
    else:
        nearer.inputs["Use Alpha"].default_value = nearer.inputs["Anti-Alias"].default_value = False
    world = _alpha(b, 'Apply Mask', given["World"], math('SUBTRACT', 1.0, given["Transparent"]))
    b.node('NodeGroupOutput', (_over(b, world, nearer.outputs[0]),))


def _alpha(b: Builder, kind: str, image, alpha):
    node = b.node('CompositorNodeSetAlpha', {"Image": image, "Alpha": alpha})
    if hasattr(node, "mode"):  # before Blender 5
        node.mode = {'Apply Mask': 'APPLY', 'Replace Alpha': 'REPLACE_ALPHA'}[kind]
    else:
        node.inputs["Type"].default_value = kind
    return node.outputs[0]


def _less(b: Builder, image, taken):
    """The difference of two colours."""
    if bpy.app.version >= (5, 0, 0):
        return b.first('ShaderNodeMix', (1.0, image, taken), data_type='RGBA', blend_type='SUBTRACT')
    return b.first('CompositorNodeMixRGB', (1.0, image, taken), blend_type='SUBTRACT')


def _over(b: Builder, background, foreground):
    """Alpha Over; the place of its colours differs between Blender's versions."""
    node = b.node('CompositorNodeAlphaOver')
    for socket, value in zip((socket for socket in node.inputs if socket.type == 'RGBA'), (background, foreground)):
        b.tree.links.new(value, socket)
    return node.outputs[0]

# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the node group that joins the pictures of splats and of meshes.

Where meshes hide splats, splats + meshes x the light that the holdout stops; elsewhere the nearer of
(splats over meshes, meshes over splats), by the depth of each; all of it over the world.  Meshes are darkened by the splats' shadows.
"""
from __future__ import annotations

import bpy

COLOUR, NUMBER = 'NodeSocketColor', 'NodeSocketFloat'
INPUTS = (
    ("Splats", COLOUR, None), ("Splat Alpha", NUMBER, 0.0), ("Splat Depth", NUMBER, 1e10), ("Splat Holdout", NUMBER, 0.0),
    ("Splat Shadow", NUMBER, 1.0), ("Shadow Strength", NUMBER, 1.0),
    ("Meshes", COLOUR, None), ("Mesh Alpha", NUMBER, 0.0), ("Mesh Depth", NUMBER, 1e10), ("World", COLOUR, None),
)
"""Sockets of the group: name, type, value where nothing is linked; nothing is transparent."""
FAINT = 1e-4
"""Light of a pixel below which it does not matter what stops it."""


def build(tree: bpy.types.NodeTree) -> None:
    """Make the nodes of a compositor's group anew; its sockets, and what is linked to them and set there, stay."""
    sockets = {item.name: item for item in tree.interface.items_tree if item.in_out == 'INPUT'}
    for name, kind, value in INPUTS:
        if name not in sockets:
            socket = tree.interface.new_socket(name=name, in_out='INPUT', socket_type=kind)
            socket.default_value = (0.0, 0.0, 0.0, 0.0) if value is None else value
            if name == "Shadow Strength":
                socket.min_value, socket.max_value, socket.subtype = 0.0, 1.0, 'FACTOR'
    if not any(item.in_out == 'OUTPUT' for item in tree.interface.items_tree):
        tree.interface.new_socket(name="Image", in_out='OUTPUT', socket_type=COLOUR)
    tree.nodes.clear()
    _Builder(tree).join()


class _Builder:
    """Adds nodes to an empty group."""

    def __init__(self, tree):
        self.tree, self.place = tree, 0
        self.given = self._node('NodeGroupInput').outputs

    def join(self):
        given, math = self.given, self._math
        shade = math('MULTIPLY_ADD', math('SUBTRACT', given["Splat Shadow"], 1.0), given["Shadow Strength"], 1.0)
        meshes = self._alpha('Replace Alpha', self._alpha('Apply Mask', given["Meshes"], shade), given["Mesh Alpha"])
        # splats over (meshes x factor) = splats + straight meshes x holdout
        clear = math('MULTIPLY', math('SUBTRACT', 1.0, given["Splat Alpha"]), given["Mesh Alpha"])
        free = math('LESS_THAN', given["Splat Holdout"], FAINT)
        factor = math('ADD', math('DIVIDE', given["Splat Holdout"], clear), free)
        front = self._over(self._alpha('Apply Mask', meshes, factor), given["Splats"])
        back = self._over(given["Splats"], meshes)
        nearer = self._node('CompositorNodeZcombine')
        if hasattr(nearer, "use_alpha"):
            nearer.use_alpha = nearer.use_antialias_z = False
        else:
            nearer.inputs["Use Alpha"].default_value = nearer.inputs["Anti-Alias"].default_value = False
        for number, socket in enumerate((front, math('MULTIPLY', given["Splat Depth"], free), back, given["Mesh Depth"])):
            self.tree.links.new(socket, nearer.inputs[number])
        self.tree.links.new(self._over(given["World"], nearer.outputs[0]), self._node('NodeGroupOutput').inputs[0])

    def _node(self, kind):
        node = self.tree.nodes.new(kind)
        node.location = self.place, -140 * (len(self.tree.nodes) % 4)
        self.place += 110
        return node

    def _math(self, operation, *values):
        node = self._node('ShaderNodeMath' if bpy.app.version >= (5, 0, 0) else 'CompositorNodeMath')
        node.operation = operation
        for socket, value in zip(node.inputs, values):
            if isinstance(value, float):
                socket.default_value = value
            else:
                self.tree.links.new(value, socket)
        return node.outputs[0]

    def _alpha(self, kind, image, alpha):
        node = self._node('CompositorNodeSetAlpha')
        if hasattr(node, "mode"):  # before Blender 5
            node.mode = {'Apply Mask': 'APPLY', 'Replace Alpha': 'REPLACE_ALPHA'}[kind]
        else:
            node.inputs["Type"].default_value = kind
        self.tree.links.new(image, node.inputs["Image"])
        self.tree.links.new(alpha, node.inputs["Alpha"])
        return node.outputs[0]

    def _over(self, background, foreground):
        """Alpha Over; the place of its colours differs between Blender's versions."""
        node = self._node('CompositorNodeAlphaOver')
        first, second = (socket for socket in node.inputs if socket.type == 'RGBA')
        self.tree.links.new(background, first)
        self.tree.links.new(foreground, second)
        return node.outputs[0]

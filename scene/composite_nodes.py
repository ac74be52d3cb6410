# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the node group that joins the pictures of splats and of meshes.

Where meshes hide splats, splats + meshes x the light that the holdout stops; elsewhere the nearer of
(splats over meshes, meshes over splats), by the depth of each; all of it over the world.  The splats' shadows take from the meshes what
these have of the lamp's light.
"""
from __future__ import annotations

import bpy

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
    _Builder(tree).join()


class _Builder:
    """Adds nodes to an empty group."""

    def __init__(self, tree):
        self.tree, self.place = tree, 0
        self.given = self._node('NodeGroupInput').outputs

    def join(self):
        given, math = self.given, self._math
        shade = math('MULTIPLY', math('SUBTRACT', 1.0, given["Splat Shadow"]), given["Shadow Strength"])
        lit = self._less(given["Meshes"], self._alpha('Apply Mask', given["Lamp"], shade))
        meshes = self._alpha('Replace Alpha', lit, given["Mesh Alpha"])
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
        world = self._alpha('Apply Mask', given["World"], math('SUBTRACT', 1.0, given["Transparent"]))
        self.tree.links.new(self._over(world, nearer.outputs[0]), self._node('NodeGroupOutput').inputs[0])

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

    def _less(self, image, taken):
        """The difference of two colours."""
        if bpy.app.version >= (5, 0, 0):
            node = self._node('ShaderNodeMix')
            node.data_type, node.blend_type = 'RGBA', 'SUBTRACT'
            first, second = (socket for socket in node.inputs if socket.type == 'RGBA')
            output = next(socket for socket in node.outputs if socket.type == 'RGBA')
        else:
            node = self._node('CompositorNodeMixRGB')
            node.blend_type = 'SUBTRACT'
            first, second, output = node.inputs[1], node.inputs[2], node.outputs[0]
        node.inputs[0].default_value = 1.0
        self.tree.links.new(image, first)
        self.tree.links.new(taken, second)
        return output

    def _over(self, background, foreground):
        """Alpha Over; the place of its colours differs between Blender's versions."""
        node = self._node('CompositorNodeAlphaOver')
        first, second = (socket for socket in node.inputs if socket.type == 'RGBA')
        self.tree.links.new(background, first)
        self.tree.links.new(foreground, second)
        return node.outputs[0]

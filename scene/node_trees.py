# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes node trees as expressions, with the nodes that all supported releases of Blender have."""
from functools import cached_property

import bpy
import numpy as np

SPACING = 180, 260
"""Distance of the nodes in the editor, in x and in y; so many columns make a row."""
COLUMNS = 8
MATH = 'ShaderNodeMath', 'CompositorNodeMath'
"""The node of numbers, and that of compositors before Blender 5."""


def find_socket(sockets, key):
    """The socket of this number, or of this name or identifier, among those that are in use: a node may have one for each type of data."""
    sockets = [socket for socket in sockets if socket.enabled]
    return sockets[key] if isinstance(key, int) else next(socket for socket in sockets if key in (socket.name, socket.identifier))


class Builder:
    """Adds nodes to a tree.  A value is an output socket, or a constant for an input's default."""

    def __init__(self, tree: bpy.types.NodeTree):
        self.tree, self._made = tree, []
        self._math = MATH[tree.bl_idname == 'CompositorNodeTree' and bpy.app.version < (5, 0, 0)]

    @cached_property
    def given(self):
        """The inputs of the group, by name."""
        return self.node('NodeGroupInput').outputs

    def node(self, kind: str, inputs: dict | tuple = (), **settings) -> bpy.types.Node:
        """A node with these settings and inputs, by name or in their order."""
        node = self.tree.nodes.new(kind)
        self._made.append(node)
        for name, value in settings.items():
            setattr(node, name, value)
        for key, value in inputs.items() if isinstance(inputs, dict) else enumerate(inputs):
            target = find_socket(node.inputs, key)
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, target)
            else:
                target.default_value = value
        if not node.outputs:
            self.arrange()
        return node

    def arrange(self) -> None:
        """Put the nodes side by side, as a node without outputs does.  All at once: where one is moved, Blender updates the whole tree."""
        places = np.zeros((len(self.tree.nodes), 2), np.float32)
        self.tree.nodes.foreach_get("location", places.reshape(-1))
        ours = [number for number, node in enumerate(self.tree.nodes) if node in self._made]
        steps = np.arange(len(ours))
        places[ours] = np.stack([steps % COLUMNS, -(steps // COLUMNS)], 1) * SPACING
        self.tree.nodes.foreach_set("location", places.reshape(-1))

    def first(self, kind: str, inputs: dict | tuple = (), **settings) -> bpy.types.NodeSocket:
        """The first output in use of a new node."""
        return find_socket(self.node(kind, inputs, **settings).outputs, 0)

    def math(self, operation: str, *values, clamp: bool = False) -> bpy.types.NodeSocket:
        """A number."""
        return self.first(self._math, values, operation=operation, use_clamp=clamp)

    def attribute(self, name: str, kind: str) -> bpy.types.Node:
        """The node of an attribute, of a type."""
        return self.node('GeometryNodeInputNamedAttribute', {"Name": name}, data_type=kind)

    def position(self) -> bpy.types.NodeSocket:
        """Where points are."""
        return self.first('GeometryNodeInputPosition')

    def store(self, geometry, name: str, kind: str, value) -> bpy.types.NodeSocket:
        """The geometry with an attribute of points, of a type."""
        return self.first('GeometryNodeStoreNamedAttribute', {"Geometry": geometry, "Name": name, "Value": value}, data_type=kind,
                          domain='POINT')

    def joined(self, *geometries) -> bpy.types.NodeSocket:
        """Geometries as one; the last comes first."""
        node = self.node('GeometryNodeJoinGeometry')
        for geometry in geometries:
            self.tree.links.new(geometry, node.inputs[0])
        return node.outputs[0]

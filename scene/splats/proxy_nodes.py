# SPDX-License-Identifier: GPL-3.0-or-later
"""The Geometry Nodes groups that make proxies' points visible to every engine, and the materials that colour them.

Engines with shaders read the colour from an attribute.  Workbench draws each material in one colour, so the points are spread over the
materials of a palette.
"""
from __future__ import annotations

import bpy
import numpy as np
from mathutils import Color

from .. import proxies
from ..point_edits import OPACITY
from ..proxies import OFFSET, STILL

NAME = proxies.GROUP
"""Of the node group, the modifier and the materials."""
COLOUR = "Color"
RADIUS = "radius"
GAUSSIAN = "Gaussian"
"""Attribute: which Gaussian of the model a point stands for; -1: the corners of the box."""
SHADE = "Shade"
"""Attribute: the palette's material."""
NONE = 1e-30
"""Radius of points that no octahedron is drawn for."""
LARGER = "fastgs_larger"
"""Custom property of the mesh: how much larger than their Gaussians points are, because few stand for many."""
LEVELS = 3
"""Of each channel in the palette."""


def give_modifier(obj: bpy.types.Object) -> None:
    """Give the object the modifier with the group."""
    modifier = obj.modifiers.new(NAME, 'NODES')
    modifier.node_group = group(STILL if obj.rigid_body else NAME)
    modifier.show_expanded = False
    keep_last(modifier)


def keep_last(modifier) -> None:
    """Pin the modifier behind all others of its object, those that come later too, because they change points and it makes points
    visible."""
    modifier.use_pin_to_last = True


def modifier_of(obj):
    """The object's modifier with the group, or None."""
    return next((m for m in obj.modifiers if m.type == 'NODES' and m.node_group is not None and m.node_group.name.startswith(NAME)), None)


def _own(collection, name: str, kind: str | None = None):
    """The datablock of our name that this .blend itself holds, or None.  One that is linked from a library may disappear."""
    return next((x for x in collection if x.name == name and x.library is None and (kind is None or x.bl_idname == kind)), None)


def group(name: str = NAME) -> bpy.types.NodeTree:
    """The group NAME or STILL of this .blend; made where it is missing."""
    found = _own(bpy.data.node_groups, name, 'GeometryNodeTree')
    if found is None:
        found = bpy.data.node_groups.new(name, 'GeometryNodeTree')
        found.interface.new_socket("Geometry", in_out='INPUT', socket_type='NodeSocketGeometry')
        found.interface.new_socket("Geometry", in_out='OUTPUT', socket_type='NodeSocketGeometry')
        _build(found)
        if name == NAME:  # what depends on the time is evaluated on each frame, so that moving.py finds it as it was made
            found.nodes.new('GeometryNodeInputSceneTime').location = 0, -200
    return found


def _build(tree):
    node = {}
    for x, (key, kind) in enumerate((
            ("in", 'NodeGroupInput'), ("parts", 'GeometryNodeSeparateComponents'), ("vertices", 'GeometryNodePointsToVertices'),
            ("points", 'GeometryNodeJoinGeometry'), ("radius", 'GeometryNodeInputNamedAttribute'), ("drawn", 'FunctionNodeCompare'),
            ("ball", 'GeometryNodeMeshUVSphere'), ("position", 'GeometryNodeInputPosition'), ("store", 'GeometryNodeStoreNamedAttribute'),
            ("smooth", 'GeometryNodeSetShadeSmooth'), ("balls", 'GeometryNodeJoinGeometry'), ("shade", 'GeometryNodeInputNamedAttribute'),
            ("instance", 'GeometryNodeInstanceOnPoints'), ("realize", 'GeometryNodeRealizeInstances'), ("join", 'GeometryNodeJoinGeometry'),
            ("which", 'GeometryNodeInputNamedAttribute'), ("corner", 'FunctionNodeCompare'),
            ("corners", 'GeometryNodeSeparateGeometry'), ("box", 'GeometryNodeBoundBox'), ("edges", 'GeometryNodeDeleteGeometry'),
            ("all", 'GeometryNodeInputNamedAttribute'), ("carried", 'GeometryNodeSeparateGeometry'), ("kept", 'GeometryNodeJoinGeometry'),
            ("hide", 'FunctionNodeInputBool'), ("viewport", 'GeometryNodeIsViewport'), ("both", 'FunctionNodeBooleanMath'),
            ("switch", 'GeometryNodeSwitch'), ("out", 'NodeGroupOutput'))):
        node[key] = tree.nodes.new(kind)
        node[key].location = 200 * x, 0
    node["hide"].name, node["hide"].label, node["hide"].boolean = proxies.SWITCH, proxies.SWITCH, proxies.wanted_hidden()
    node["edges"].mode, node["edges"].domain = 'ONLY_FACE', 'FACE'
    node["both"].operation = 'AND'
    node["switch"].input_type = 'GEOMETRY'
    node["radius"].data_type, node["shade"].data_type = 'FLOAT', 'INT'
    node["radius"].inputs["Name"].default_value = RADIUS
    node["shade"].inputs["Name"].default_value = SHADE
    node["all"].data_type, node["carried"].domain = 'FLOAT', 'POINT'
    node["all"].inputs["Name"].default_value = OPACITY
    node["which"].data_type, node["corners"].domain = 'INT', 'POINT'
    node["which"].inputs["Name"].default_value = GAUSSIAN
    node["corner"].data_type, node["corner"].operation = 'INT', 'LESS_THAN'
    node["drawn"].data_type, node["drawn"].operation = 'FLOAT', 'GREATER_THAN'
    find_socket(node["drawn"].inputs, "B", 'VALUE').default_value = 1e10 * NONE
    node["store"].data_type, node["store"].domain = 'FLOAT_VECTOR', 'POINT'
    node["store"].inputs["Name"].default_value = OFFSET
    for name, value in (("Segments", 4), ("Rings", 2), ("Radius", 1.0)):
        node["ball"].inputs[name].default_value = value

    def link(source, output, target, socket, kind=None):
        tree.links.new(find_socket(node[source].outputs, output), find_socket(node[target].inputs, socket, kind))

    for wire in (
            ("ball", "Mesh", "store", "Geometry"), ("position", 0, "store", "Value", 'VECTOR'),
            # of what modifiers before this one make, mesh and point cloud are points
            ("in", 0, "parts", 0), ("parts", "Mesh", "points", 0), ("parts", "Point Cloud", "vertices", 0), ("vertices", 0, "points", 0),
            ("radius", "Attribute", "drawn", "A", 'VALUE'), ("points", 0, "instance", "Points"),
            ("drawn", "Result", "instance", "Selection"),
            ("store", "Geometry", "smooth", "Geometry"),
            ("balls", 0, "instance", "Instance"), ("shade", "Attribute", "instance", "Instance Index"),
            ("radius", "Attribute", "instance", "Scale"), ("instance", 0, "realize", 0), ("realize", 0, "join", 0),
            ("which", "Attribute", "corner", "A", 'INT'), ("points", 0, "corners", 0), ("corner", "Result", "corners", "Selection"),
            ("corners", 0, "box", "Geometry"), ("box", "Bounding Box", "edges", "Geometry"), ("kept", 0, "switch", "True"),
            # hidden points that carry something stay as vertices without a face, which no viewport draws
            ("points", 0, "carried", 0), ("all", "Exists", "carried", "Selection"), ("carried", 0, "kept", 0), ("edges", 0, "kept", 0),
            ("hide", 0, "both", 0), ("viewport", 0, "both", 1), ("both", 0, "switch", "Switch"), ("switch", 0, "out", 0),
            # the points themselves come along: only they know which colour attribute is the active one
            ("points", 0, "join", 0), ("join", 0, "switch", "False")):
        link(*wire)
    node["instance"].inputs["Pick Instance"].default_value = True
    for number, material in reversed(list(enumerate(_palette()))):  # the last link comes first
        paint, single = tree.nodes.new('GeometryNodeSetMaterial'), tree.nodes.new('GeometryNodeGeometryToInstance')
        paint.location, single.location = (1200, -80 * number - 200), (1400, -80 * number - 200)
        paint.inputs["Material"].default_value = material
        tree.links.new(node["smooth"].outputs[0], paint.inputs["Geometry"])
        tree.links.new(paint.outputs[0], single.inputs[0])
        tree.links.new(single.outputs[0], node["balls"].inputs[0])


def find_socket(sockets, key, kind=None):
    """The socket of this number, or of this name or identifier and type: nodes with a data type may have one of a name for every type."""
    if isinstance(key, int):
        return sockets[key]
    named = [s for s in sockets if key in (s.name, s.identifier)]
    return next((s for s in named if s.type == kind), named[0])


def _palette() -> list[bpy.types.Material]:
    levels = np.linspace(0, 1, LEVELS)
    return [_material(number, [levels[number // LEVELS**power % LEVELS] for power in (2, 1, 0)]) for number in range(LEVELS**3)]


def _material(number: int, srgb) -> bpy.types.Material:
    name = f".{NAME} {number:02}"  # Blender's menus do not list what begins with a dot
    material = _own(bpy.data.materials, name)
    if material is not None:
        return material
    material = shining_material(name)
    material.diffuse_color = (*Color(srgb).from_srgb_to_scene_linear(), 1)
    return material


def shining_material(name: str) -> bpy.types.Material:
    """A new material that emits the colours of the attribute COLOUR."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:  # Blender 5.0 and later make one by themselves
        material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    colour, out = nodes.new('ShaderNodeAttribute'), nodes.new('ShaderNodeOutputMaterial')
    colour.attribute_name = COLOUR
    out.location = 200, 0
    links.new(colour.outputs["Color"], out.inputs["Surface"])  # a colour as a surface is one that shines
    return material

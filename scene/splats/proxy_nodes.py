# SPDX-License-Identifier: GPL-3.0-or-later
"""The Geometry Nodes groups that make proxies' points visible to every engine, and the materials that colour them.

Engines with shaders read the colour from an attribute.  Workbench draws each material in one colour, so the points are spread over the
materials of a palette.
"""
import bpy
import numpy as np
from mathutils import Color

from .. import proxies
from ..node_trees import Builder
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
    b = Builder(tree)
    parts = b.node('GeometryNodeSeparateComponents', (b.given["Geometry"],)).outputs
    # of what modifiers before this one make, mesh and point cloud are points
    points = b.joined(parts["Mesh"], b.first('GeometryNodePointsToVertices', (parts["Point Cloud"],)))
    ball = b.node('GeometryNodeMeshUVSphere', {"Segments": 4, "Rings": 2, "Radius": 1.0}).outputs["Mesh"]
    ball = b.first('GeometryNodeSetShadeSmooth', {"Geometry": b.store(ball, OFFSET, 'FLOAT_VECTOR', b.position())})
    painted = [b.first('GeometryNodeGeometryToInstance', (b.first('GeometryNodeSetMaterial', {"Geometry": ball, "Material": material}),))
               for material in _palette()]
    radius = b.attribute(RADIUS, 'FLOAT').outputs[0]
    drawn = b.first('FunctionNodeCompare', {"A": radius, "B": 1e10 * NONE}, data_type='FLOAT', operation='GREATER_THAN')
    balls = b.first('GeometryNodeInstanceOnPoints', {
        "Points": points, "Selection": drawn, "Instance": b.joined(*reversed(painted)), "Pick Instance": True,
        "Instance Index": b.attribute(SHADE, 'INT').outputs[0], "Scale": radius})
    # the points themselves come along: only they know which colour attribute is the active one
    shown = b.joined(b.first('GeometryNodeRealizeInstances', (balls,)), points)
    corner = b.first('FunctionNodeCompare', {"A": b.attribute(GAUSSIAN, 'INT').outputs[0], "B": 0}, data_type='INT', operation='LESS_THAN')
    corners = b.first('GeometryNodeSeparateGeometry', {"Geometry": points, "Selection": corner}, domain='POINT')
    box = b.node('GeometryNodeBoundBox', {"Geometry": corners}).outputs["Bounding Box"]
    edges = b.first('GeometryNodeDeleteGeometry', {"Geometry": box}, mode='ONLY_FACE', domain='FACE')
    # hidden points that carry something stay as vertices without a face, which no viewport draws
    carried = b.first('GeometryNodeSeparateGeometry', {"Geometry": points, "Selection": b.attribute(OPACITY, 'FLOAT').outputs["Exists"]},
                      domain='POINT')
    wanted = b.first('FunctionNodeInputBool', name=proxies.SWITCH, label=proxies.SWITCH, boolean=proxies.wanted_hidden())
    hidden = b.first('FunctionNodeBooleanMath', (wanted, b.first('GeometryNodeIsViewport')), operation='AND')
    switched = b.first('GeometryNodeSwitch', {"Switch": hidden, "False": shown, "True": b.joined(carried, edges)}, input_type='GEOMETRY')
    b.node('NodeGroupOutput', (switched,))


def _palette() -> list[bpy.types.Material]:
    """The materials of the palette, by number: those that this .blend has, and copies of one new material, which are made quickly."""
    levels = np.linspace(0, 1, LEVELS)
    first, palette = None, []
    for number in range(LEVELS**3):
        name = f".{NAME} {number:02}"  # Blender's menus do not list what begins with a dot
        material = _own(bpy.data.materials, name)
        if material is None:
            first = material = first.copy() if first else shining_material(name)
            srgb = Color([levels[number // LEVELS**power % LEVELS] for power in (2, 1, 0)])
            material.name, material.diffuse_color = name, (*srgb.from_srgb_to_scene_linear(), 1)
        palette.append(material)
    return palette


def shining_material(name: str) -> bpy.types.Material:
    """A new material that emits the colours of the attribute COLOUR."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:  # Blender 5.0 and later make one by themselves
        material.use_nodes = True
    material.node_tree.nodes.clear()
    b = Builder(material.node_tree)
    colour = b.node('ShaderNodeAttribute', attribute_name=COLOUR).outputs["Color"]
    b.node('ShaderNodeOutputMaterial', {"Surface": colour})  # a colour as a surface is one that shines
    return material

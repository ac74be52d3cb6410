# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the small mesh that stands for a 4D model in the scene: coloured points, never the Gaussians.

Points alone are drawn by no other engine, so one Geometry Nodes group (shared by all splat objects of a .blend) puts a small
octahedron on each while Blender evaluates the scene.  What is stored stays the points.  Where viewports draw the splats
themselves (scene/proxies.py), all that is left of the points there is the edges of their bounding box.
"""
from __future__ import annotations

import bpy
import numpy as np

from ...fastgs_blender.model.sequence import Source
from .. import proxies
from ..colour import rec709_to_working
from .proxy_points import LIMIT, choose

NAME = proxies.GROUP
"""Of the node group, the modifier and the material."""
COLOUR = "Color"
RADIUS = "radius"


def new_mesh(name: str, model: Source, limit: int = LIMIT) -> bpy.types.Mesh:
    """A mesh of the model's most telling points (at most `limit`), with their colour (scene linear) and radius as attributes."""
    mesh = bpy.data.meshes.new(name)
    fill(mesh, model, limit)
    return mesh


def fill(mesh: bpy.types.Mesh, model: Source, limit: int = LIMIT) -> None:
    """Replace the mesh's points by those of the model; materials and everything else that hangs on the mesh stay."""
    points = choose(model, min(limit, LIMIT))
    count = len(points.position)
    mesh.clear_geometry()
    for attribute in (mesh.attributes.get(COLOUR), mesh.attributes.get(RADIUS)):
        if attribute is not None:
            mesh.attributes.remove(attribute)
    mesh.vertices.add(count)
    mesh.vertices.foreach_set("co", points.position.ravel())
    colour = mesh.color_attributes.new(COLOUR, 'FLOAT_COLOR', 'POINT')
    colour.data.foreach_set("color", np.c_[points.colour @ rec709_to_working().T, np.ones(count, np.float32)].ravel())
    mesh.color_attributes.active_color = colour
    mesh.color_attributes.render_color_index = mesh.color_attributes.find(COLOUR)
    mesh.attributes.new(RADIUS, 'FLOAT', 'POINT').data.foreach_set("value", points.radius)
    mesh.update()


def show_in_all_engines(obj: bpy.types.Object) -> None:
    """Give the object the modifier that makes its points visible in Solid view and in every render engine."""
    modifier = obj.modifiers.new(NAME, 'NODES')
    modifier.node_group = _group()
    modifier.show_expanded = False


def _own(collection, kind: str | None = None):
    """The datablock of our name in this .blend, or None; never one linked from a library, which may go away."""
    return next((x for x in collection if x.name == NAME and x.library is None and kind in (None, x.bl_idname)), None)


def _group() -> bpy.types.NodeTree:
    group = _own(bpy.data.node_groups, 'GeometryNodeTree')
    if group is not None:
        return group
    group = bpy.data.node_groups.new(NAME, 'GeometryNodeTree')
    group.interface.new_socket("Geometry", in_out='INPUT', socket_type='NodeSocketGeometry')
    group.interface.new_socket("Geometry", in_out='OUTPUT', socket_type='NodeSocketGeometry')
    node = {}
    for x, (key, kind) in enumerate((
            ("in", 'NodeGroupInput'), ("radius", 'GeometryNodeInputNamedAttribute'), ("ball", 'GeometryNodeMeshUVSphere'),
            ("instance", 'GeometryNodeInstanceOnPoints'), ("realize", 'GeometryNodeRealizeInstances'),
            ("smooth", 'GeometryNodeSetShadeSmooth'), ("join", 'GeometryNodeJoinGeometry'),
            ("material", 'GeometryNodeSetMaterial'), ("box", 'GeometryNodeBoundBox'), ("edges", 'GeometryNodeDeleteGeometry'),
            ("hide", 'FunctionNodeInputBool'), ("viewport", 'GeometryNodeIsViewport'), ("both", 'FunctionNodeBooleanMath'),
            ("switch", 'GeometryNodeSwitch'), ("out", 'NodeGroupOutput'))):
        node[key] = group.nodes.new(kind)
        node[key].location = 200 * x, 0
    node["hide"].name, node["hide"].label = proxies.SWITCH, proxies.SWITCH
    node["edges"].mode, node["edges"].domain = 'ONLY_FACE', 'FACE'
    node["both"].operation = 'AND'
    node["switch"].input_type = 'GEOMETRY'
    node["radius"].data_type = 'FLOAT'
    node["radius"].inputs["Name"].default_value = RADIUS
    for name, value in (("Segments", 4), ("Rings", 2), ("Radius", 1.0)):
        node["ball"].inputs[name].default_value = value
    node["material"].inputs["Material"].default_value = _material()
    for source, output, target, socket in (
            ("in", 0, "instance", "Points"), ("ball", "Mesh", "instance", "Instance"), ("radius", "Attribute", "instance", "Scale"),
            ("instance", 0, "realize", 0), ("realize", 0, "smooth", "Geometry"), ("smooth", 0, "join", 0),
            # the points themselves come along: only they know which colour attribute is the active one
            ("in", 0, "join", 0), ("join", 0, "material", "Geometry"), ("material", 0, "switch", "False"),
            ("in", 0, "box", "Geometry"), ("box", "Bounding Box", "edges", "Geometry"), ("edges", 0, "switch", "True"),
            ("hide", 0, "both", 0), ("viewport", 0, "both", 1), ("both", 0, "switch", "Switch"), ("switch", 0, "out", 0)):
        group.links.new(node[source].outputs[output], node[target].inputs[socket])
    return group


def _material() -> bpy.types.Material:
    material = _own(bpy.data.materials)
    if material is not None:
        return material
    material = bpy.data.materials.new(NAME)
    if material.node_tree is None:  # Blender 5.0 and later make one by themselves
        material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    colour, emission, out = (nodes.new(kind) for kind in (
        'ShaderNodeAttribute', 'ShaderNodeEmission', 'ShaderNodeOutputMaterial'))
    colour.attribute_name = COLOUR
    emission.location, out.location = (200, 0), (400, 0)
    links.new(colour.outputs["Color"], emission.inputs["Color"])
    links.new(emission.outputs["Emission"], out.inputs["Surface"])
    return material

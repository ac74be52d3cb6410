# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds what a view layer has behind it: nothing, a colour, or a world that must be rendered (sky.py)."""
import bpy

from . import light_probe
from .colour import blackbody

BLACK = (0.0, 0.0, 0.0)
CONSTANTS = 'ShaderNodeRGB', 'ShaderNodeValue'
"""Nodes whose value is all there is to them."""


def background(scene, view_layer) -> tuple[tuple[float, float, float] | None, bpy.types.World | None]:
    """(scene-linear colour, or None for transparent film; the world where it is more than that colour, or None)."""
    return (None, None) if scene.render.film_transparent else surface(scene, view_layer)


def shown_in(scene, view_layer) -> bpy.types.World | None:
    """The world of a view layer, evaluated or not."""
    return light_probe.source_of(getattr(view_layer, "world_override", None) or scene.world)


def surface(scene, view_layer) -> tuple[tuple[float, float, float], bpy.types.World | None]:
    """(scene-linear colour of a view layer's world; the world where it is more than that colour, or None)."""
    world = shown_in(scene, view_layer)
    if world is None or not view_layer.use_sky:
        return BLACK, None
    if bpy.app.version < (5, 0, 0) and not world.use_nodes:  # later worlds always have nodes
        return tuple(world.color), None
    output = world.node_tree.get_output_node('ALL')
    link = _source(output.inputs["Surface"]) if output else None
    if link is None:
        return BLACK, None
    node = link.from_node
    if node.bl_idname != 'ShaderNodeBackground':
        return BLACK, world
    colour, plain = _value(node.inputs["Color"])
    strength, also_plain = _value(node.inputs["Strength"])
    return tuple(c * strength for c in colour[:3]), None if plain and also_plain else world


def emission(data) -> tuple[float, float, float]:
    """The factor [3] that the nodes of a light make of its colour: plain colours, temperatures and strengths count."""
    node = _shader(data)
    if node is None or node.bl_idname != 'ShaderNodeEmission':
        return (1.0, 1.0, 1.0)
    (colour, _), (strength, _) = (_value(node.inputs[name]) for name in ("Color", "Strength"))
    return tuple(c * strength for c in colour[:3])


def is_plain(data) -> bool:
    """Whether emission() takes all that the nodes of a light do."""
    node = _shader(data)
    if node is None:
        return True
    links = [_source(node.inputs[name]) for name in ("Color", "Strength")] if node.bl_idname == 'ShaderNodeEmission' else []
    return bool(links) and all(link is None or link.from_node.bl_idname in (*CONSTANTS, 'ShaderNodeBlackbody') for link in links)


def _shader(data):
    """The node that a light's colour comes from; None where it has no nodes."""
    used = data.node_tree and (bpy.app.version >= (5, 2, 0) or data.use_nodes)  # later lights always use their nodes
    output = data.node_tree.get_output_node('ALL') if used else None
    link = _source(output.inputs["Surface"]) if output else None
    return link and link.from_node


def _source(socket):
    """The link that feeds a socket, seen through reroutes; None where nothing does."""
    while socket.is_linked:
        link = socket.links[0]
        if link.from_node.bl_idname != 'NodeReroute':
            return link
        socket = link.from_node.inputs[0]
    return None


def _value(socket):
    """(value of a socket, whether that is all there is to it): constants are followed, textures are not."""
    link = _source(socket)
    if link is None:
        return socket.default_value, True
    if link.from_node.bl_idname in CONSTANTS:
        return link.from_socket.default_value, True
    if link.from_node.bl_idname == 'ShaderNodeBlackbody':
        return blackbody(_value(link.from_node.inputs["Temperature"])[0]), False  # near enough to light with, not to be looked at
    return socket.default_value, False

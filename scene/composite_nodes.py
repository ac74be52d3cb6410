# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the node groups that join the pictures of splats and of meshes.

Where meshes hide splats, splats + meshes x the light that the holdout stops; elsewhere the nearer of
(splats over meshes, meshes over splats), by the depth of each; all of it over the world.  Before that, the splats' shadows take from
the meshes what these have of a lamp's light, and the meshes' shadows, caught by shadow catchers, from the splats.

At the edge of a mesh before splats before another mesh, the pixel's colour of the meshes is a mixture, and half of it belongs behind the
splats.  There the first mesh has its colour from the pixels beside the edge that are wholly its own.
"""
from __future__ import annotations

import bpy

from .node_trees import Builder

COLOUR, NUMBER = 'NodeSocketColor', 'NodeSocketFloat'
INPUTS = (
    ("Splats", COLOUR, None), ("Splat Alpha", NUMBER, 0.0), ("Splat Depth", NUMBER, 1e10), ("Splat Holdout", NUMBER, 0.0),
    ("Meshes", COLOUR, None), ("Mesh Alpha", NUMBER, 0.0), ("Mesh Depth", NUMBER, 1e10),
    ("Shadow Catcher", COLOUR, (1.0, 1.0, 1.0, 1.0)), ("Catcher Bias", NUMBER, 0.2), ("World", COLOUR, None), ("Transparent", NUMBER, 0.0),
)
"""Sockets of the group that joins: name, type, value where nothing is linked; nothing is transparent."""
SHADED = ("Image", COLOUR, None), ("Lamp", COLOUR, None), ("Splat Shadow", NUMBER, 1.0), ("Shadow Strength", NUMBER, 1.0)
"""Sockets of the group that takes a lamp's light away."""
FAINT = 1e-4
"""Light of a pixel below which it does not matter what stops it."""
WHOLE = 0.99
"""Light of a pixel from which on meshes have stopped all of it."""
THIN = 0.01
"""Weight of colours that have pixels of another mesh beside them; they count where there are no others."""
REACH = 3
"""Pixels around an edge in which colours are looked for."""


def shade(tree: bpy.types.NodeTree) -> None:
    """Fill an empty group of the compositor: what of an image remains if splats let through a share of one lamp's light."""
    b = _begin(tree, SHADED)
    taken = b.math('MULTIPLY', b.math('SUBTRACT', 1.0, b.given["Splat Shadow"]), b.given["Shadow Strength"])
    b.node('NodeGroupOutput', (_mix(b, 'SUBTRACT', 1.0, b.given["Image"], _alpha(b, 'Apply Mask', b.given["Lamp"], taken)),))


def join(tree: bpy.types.NodeTree) -> None:
    """Fill an empty group of the compositor: splats and meshes over the world."""
    b = _begin(tree, INPUTS)
    given, math = b.given, b.math
    meshes = _alpha(b, 'Replace Alpha', given["Meshes"], given["Mesh Alpha"])
    # what lies on a shadow catcher or behind it, but not what stands before it
    caught = math('GREATER_THAN', math('ADD', given["Splat Depth"], given["Catcher Bias"]), given["Mesh Depth"])
    splats = _alpha(b, 'Replace Alpha', _mix(b, 'MULTIPLY', caught, given["Splats"], given["Shadow Catcher"]), given["Splat Alpha"])
    # splats over (meshes x factor) = splats + straight meshes x holdout
    clear = math('MULTIPLY', math('SUBTRACT', 1.0, given["Splat Alpha"]), given["Mesh Alpha"])
    free = math('LESS_THAN', given["Splat Holdout"], FAINT)
    factor = math('ADD', math('DIVIDE', given["Splat Holdout"], clear), free)
    held = _clean(b, _alpha(b, 'Apply Mask', meshes, factor), meshes, math('MULTIPLY', given["Mesh Alpha"], factor))
    front = _over(b, held, splats)
    back = _over(b, splats, meshes)
    nearer = b.node('CompositorNodeZcombine', (front, math('MULTIPLY', given["Splat Depth"], free), back, given["Mesh Depth"]))
    if hasattr(nearer, "use_alpha"):
        nearer.use_alpha = nearer.use_antialias_z = False
    else:
        nearer.inputs["Use Alpha"].default_value = nearer.inputs["Anti-Alias"].default_value = False
    hole = math('MULTIPLY', math('LESS_THAN', given["Mesh Alpha"], FAINT),  # Blender's own holdouts, which show nothing
                math('DIVIDE', given["Splat Holdout"], math('SUBTRACT', 1.0, given["Splat Alpha"])))
    seen = math('MULTIPLY', math('SUBTRACT', 1.0, given["Transparent"]), math('SUBTRACT', 1.0, hole))
    world = _alpha(b, 'Apply Mask', given["World"], seen)
    b.node('NodeGroupOutput', (_over(b, world, nearer.outputs[0]),))


def _begin(tree, sockets) -> Builder:
    """The builder of a group with these inputs, and an image as its output."""
    for name, kind, value in sockets:
        socket = tree.interface.new_socket(name=name, in_out='INPUT', socket_type=kind)
        socket.default_value = (0.0, 0.0, 0.0, 0.0) if value is None else value
        if name == "Shadow Strength":
            socket.min_value, socket.max_value, socket.subtype = 0.0, 1.0, 'FACTOR'
    tree.interface.new_socket(name="Image", in_out='OUTPUT', socket_type=COLOUR)
    return Builder(tree)


def _clean(b: Builder, held, meshes, cover):
    """The meshes' part of a pixel, its alpha being cover, without what at edges belongs behind splats.

    Splats of the opacity a around an edge show in the pixel with alpha, so (1 - a) of the mixture is right, and a - alpha is the first
    mesh's alone.
    """
    given, math = b.given, b.math
    whole = math('GREATER_THAN', _around(b, given["Splat Holdout"], -1), WHOLE)  # other engines' pixels reach into their neighbours
    thin = math('MULTIPLY', math('GREATER_THAN', given["Splat Holdout"], WHOLE), THIN)
    first = math('LESS_THAN', given["Mesh Depth"], _around(b, given["Splat Depth"], -REACH))
    first = math('MULTIPLY', first, math('MAXIMUM', whole, thin))
    near = _blurred(b, _alpha(b, 'Apply Mask', meshes, first))
    alpha = b.node('CompositorNodeSeparateColor', (near,)).outputs["Alpha"]
    between = math('LESS_THAN', _around(b, given["Mesh Depth"], -REACH), given["Splat Depth"])
    between = math('MULTIPLY', between, math('GREATER_THAN', alpha, FAINT))
    own = math('SUBTRACT', _around(b, given["Splat Alpha"], REACH), given["Splat Alpha"])
    share = math('DIVIDE', own, given["Splat Holdout"], clamp=True)
    share = math('MULTIPLY', share, math('MULTIPLY', between, math('SUBTRACT', 1.0, whole)))
    return _mix(b, 'MIX', share, held, _alpha(b, 'Apply Mask', near, math('DIVIDE', cover, alpha)))


def _around(b: Builder, number, pixels: int):
    """The largest number around each pixel; the smallest one if the pixels are negative."""
    node = b.node('CompositorNodeDilateErode', {"Mask": number})
    if hasattr(node, "distance"):  # before Blender 5
        node.mode, node.distance = 'STEP', pixels
    else:
        node.inputs["Type"].default_value, node.inputs["Size"].default_value = 'Steps', pixels
    return node.outputs[0]


def _blurred(b: Builder, image):
    node = b.node('CompositorNodeBlur', {"Image": image})
    if hasattr(node, "size_x"):  # before Blender 5
        node.filter_type, node.size_x, node.size_y = 'GAUSS', REACH, REACH
    else:
        node.inputs["Type"].default_value, node.inputs["Size"].default_value = 'Gaussian', (REACH, REACH)
    return node.outputs[0]


def _alpha(b: Builder, kind: str, image, alpha):
    node = b.node('CompositorNodeSetAlpha', {"Image": image, "Alpha": alpha})
    if hasattr(node, "mode"):  # before Blender 5
        node.mode = {'Apply Mask': 'APPLY', 'Replace Alpha': 'REPLACE_ALPHA'}[kind]
    else:
        node.inputs["Type"].default_value = kind
    return node.outputs[0]


def _mix(b: Builder, kind: str, share, first, second):
    """Two colours, mixed."""
    if bpy.app.version >= (5, 0, 0):
        return b.first('ShaderNodeMix', (share, first, second), data_type='RGBA', blend_type=kind)
    return b.first('CompositorNodeMixRGB', (share, first, second), blend_type=kind)


def _over(b: Builder, background, foreground):
    """Alpha Over; the place of its colours differs between Blender's versions."""
    node = b.node('CompositorNodeAlphaOver')
    for socket, value in zip((socket for socket in node.inputs if socket.type == 'RGBA'), (background, foreground)):
        b.tree.links.new(value, socket)
    return node.outputs[0]

# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the node groups that join the pictures of splats and of meshes.

Where meshes hide splats, splats + meshes x the light that the holdout stops; elsewhere the nearer of
(splats over meshes, meshes over splats), by the depth of each; all of it over the world.  Before that, the splats' shadows take from
the meshes what these have of a lamp's light, and the meshes' shadows, caught by shadow catchers, from the splats.

At the edge of a mesh before splats before another mesh, the pixel's colour of the meshes is a mixture, and half of it belongs behind the
splats.  There the hidden colour is taken out, as it is beside the edge.
"""
import bpy

from ..fastgs_blender.rendering.passes import LAMP_SHADOWS, LAMPS, LIGHTS, MESH_SHADOWS
from .node_trees import Builder

COLOUR, NUMBER = 'NodeSocketColor', 'NodeSocketFloat'
INPUTS = (
    ("Splats", COLOUR, None), ("Splat Alpha", NUMBER, 0.0), ("Splat Depth", NUMBER, 1e10), ("Splat Holdout", NUMBER, 0.0),
    ("Meshes", COLOUR, None), ("Mesh Alpha", NUMBER, 0.0), ("Mesh Depth", NUMBER, 1e10),
    ("Shadow Catcher", COLOUR, (1.0, 1.0, 1.0, 1.0)), ("Catcher Bias", NUMBER, 0.2), ("World", COLOUR, None), ("Transparent", NUMBER, 0.0),
    ("Held Out", NUMBER, 0.0),
)
"""Sockets of the group that joins: name, type, value where nothing is linked; nothing is transparent, or held out."""
SHADED = (("Image", COLOUR, None), ("Lamp", COLOUR, None), ("Splat Shadow", NUMBER, 1.0), ("Shadow Strength", NUMBER, 1.0),
          ("Denoise", NUMBER, 0.0))
"""Sockets of the group that takes a lamp's light away; engines denoise the image, and not the light of one lamp."""
RELIT = (("Image", COLOUR, None), ("Unlit Colour", COLOUR, None), ("Captured Light", NUMBER, 0.3), ("Lamps", NUMBER, 1.0),
         ("Shadows", NUMBER, 1.0), ("Unlit", NUMBER, 0.0), *(
             (name, kind, value) for level in range(LAMPS) for name, kind, value in (
                 (LIGHTS[level].blender, COLOUR, None), (MESH_SHADOWS[level].blender, NUMBER, 1.0),
                 (LAMP_SHADOWS[level].blender, NUMBER, 1.0))))
"""Sockets of the group that lights splats as *Scene Light* does: three for each lamp."""
SHARES = "Shadow Strength", "Shadows", "Unlit"
"""Sockets that are shares, from 0 to 1."""
FAINT = 1e-4
"""Light of a pixel below which it does not matter what stops it."""
TINY = 1e-6
"""Light without which shadows take nothing."""
WHOLE = 0.99
"""Light of a pixel from which on meshes have stopped all of it."""
LITTLE = 0.25
"""Of a colour, by which noise and the filters of other engines change a pixel of an edge at most."""
REACH, AROUND, NEAR = 3, 16, 8
"""Pixels around one in which a mesh before the splats counts, the splats' opacity is looked for, and what they hide."""
HELD = 0.2
"""Light of a pixel that meshes stop beyond what they cover, from which on some of it is a holdout's; from twice as much on all is."""


def shade(tree: bpy.types.NodeTree) -> None:
    """Fill an empty group of the compositor: what of an image remains if splats let through a share of one lamp's light."""
    b = _begin(tree, SHADED)
    taken = b.math('MULTIPLY', b.math('SUBTRACT', 1.0, b.given["Splat Shadow"]), b.given["Shadow Strength"])
    lamp = _mix(b, 'MIX', b.given["Denoise"], b.given["Lamp"], b.node('CompositorNodeDenoise', {"Image": b.given["Lamp"]}).outputs[0])
    left = _mix(b, 'SUBTRACT', 1.0, b.given["Image"], _alpha(b, 'Apply Mask', lamp, taken))
    b.node('NodeGroupOutput', (_mix(b, 'LIGHTEN', 1.0, left, (0.0, 0.0, 0.0, 0.0)),))


def relight(tree: bpy.types.NodeTree) -> None:
    """Fill an empty group of the compositor: a picture of splats in the light of lamps, as rendering/relight.py computes it.

    Image captured (1 - s (1 - m)) + mixture lamps sum L (1 - s (1 - v)), m = sum L m_k / sum L; mixture: of captured and unlit colour.
    """
    b = _begin(tree, RELIT)
    given, math, shadows = b.given, b.math, b.given["Shadows"]
    total = past = _mix(b, 'MIX', 0.0, (TINY, TINY, TINY, 1.0), (TINY, TINY, TINY, 1.0))
    lamps = _mix(b, 'MIX', 0.0, (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0))
    for level in range(LAMPS):
        light = given[LIGHTS[level].blender]
        total = _mix(b, 'ADD', 1.0, total, light)
        past = _mix(b, 'ADD', 1.0, past, _mix(b, 'MULTIPLY', 1.0, light, given[MESH_SHADOWS[level].blender]))
        factor = math('SUBTRACT', 1.0, math('MULTIPLY', shadows, math('SUBTRACT', 1.0, given[LAMP_SHADOWS[level].blender])))
        lamps = _mix(b, 'ADD', 1.0, lamps, _mix(b, 'MULTIPLY', 1.0, light, factor))
    share, captured = _mix(b, 'DIVIDE', 1.0, past, total), given["Captured Light"]
    kept = _mix(b, 'ADD', 1.0, _mix(b, 'MULTIPLY', 1.0, share, math('MULTIPLY', captured, shadows)),
                math('MULTIPLY', captured, math('SUBTRACT', 1.0, shadows)))
    base = _mix(b, 'MIX', given["Unlit"], given["Image"], given["Unlit Colour"])
    added = _mix(b, 'MULTIPLY', 1.0, base, _mix(b, 'MULTIPLY', 1.0, lamps, given["Lamps"]))
    lit = _mix(b, 'ADD', 1.0, _mix(b, 'MULTIPLY', 1.0, given["Image"], kept), added)
    alpha = b.node('CompositorNodeSeparateColor', (given["Image"],)).outputs["Alpha"]
    b.node('NodeGroupOutput', (_alpha(b, 'Replace Alpha', lit, alpha),))


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
    # where a mesh, or its blur, covers a part of a pixel before one of Blender's own holdouts, the rest of the pixel is a hole
    beyond = math('SUBTRACT', math('DIVIDE', given["Splat Holdout"], math('SUBTRACT', 1.0, given["Splat Alpha"])), given["Mesh Alpha"])
    own = math('MULTIPLY', math('DIVIDE', math('SUBTRACT', beyond, HELD), HELD, clamp=True), given["Held Out"])
    factor = math('MULTIPLY', factor, math('SUBTRACT', 1.0, math('MULTIPLY', own, math('SUBTRACT', 1.0, given["Mesh Alpha"]))))
    front = _clean(b, _over(b, _alpha(b, 'Apply Mask', meshes, factor), splats), splats, meshes)
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
        if name in SHARES:
            socket.min_value, socket.max_value, socket.subtype = 0.0, 1.0, 'FACTOR'
    tree.interface.new_socket(name="Image", in_out='OUTPUT', socket_type=COLOUR)
    return Builder(tree)


def _clean(b: Builder, front, splats, meshes):
    """The picture of splats over meshes without what at a first mesh's edges belongs behind the splats.

    The pixel's colour of the meshes is a mixture, of which splats of opacity a cover the hidden part alone.  They show with alpha, so that
    the first mesh is alone in 1 - alpha / a of the pixel, and the colours must differ by alpha (mixture - hidden colour).  The hidden
    colour is that of pixels around in which the first mesh has little part.
    """
    given, math, alpha = b.given, b.math, b.given["Splat Alpha"]
    rest = math('DIVIDE', alpha, _around(b, alpha, AROUND), clamp=True)
    weight, rest = math('POWER', rest, 8.0), math('POWER', rest, 3.0)
    shown = _alpha(b, 'Apply Mask', meshes, weight)
    seen = _alpha(b, 'Apply Mask', _blurred(b, shown, NEAR), math('DIVIDE', 1.0, _blurred(b, weight, NEAR)))
    hidden = _mix(b, 'MIX', rest, seen, meshes)  # whose alpha depends on the version of Blender
    covered = b.node('CompositorNodeSeparateColor', (seen,)).outputs["Alpha"]
    covered = math('ADD', math('MULTIPLY', covered, math('SUBTRACT', 1.0, rest)), math('MULTIPLY', given["Mesh Alpha"], rest))
    between = math('LESS_THAN', _around(b, given["Mesh Depth"], -REACH), given["Splat Depth"])
    share = math('MULTIPLY', alpha, between)
    straight = math('DIVIDE', covered, given["Mesh Alpha"])
    gained = _alpha(b, 'Apply Mask', meshes, math('MULTIPLY', share, straight))
    clean = _mix(b, 'SUBTRACT', 1.0, _mix(b, 'ADD', 1.0, front, gained), _alpha(b, 'Apply Mask', hidden, share))
    clean = _mix(b, 'LIGHTEN', 1.0, clean, splats)

    # the light that a whole part of the first mesh beside the pixel stops has its colour; a little of the rest is noise and other filters
    held = given["Splat Holdout"]
    whole = math('GREATER_THAN', _around(b, held, -1), WHOLE)
    first = math('LESS_THAN', given["Mesh Depth"], _around(b, given["Splat Depth"], -REACH))
    known = _blurred(b, _alpha(b, 'Apply Mask', meshes, math('MULTIPLY', first, whole)), REACH)
    found = b.node('CompositorNodeSeparateColor', (known,)).outputs["Alpha"]
    sharp = _mix(b, 'ADD', 1.0, splats, _alpha(b, 'Apply Mask', known, math('DIVIDE', held, found)))
    change = b.node('CompositorNodeSeparateColor', (_mix(b, 'DIFFERENCE', 1.0, sharp, clean),)).outputs
    change = math('MAXIMUM', math('MAXIMUM', change[0], change[1]), change[2])
    stopped = math('DIVIDE', math('SUBTRACT', _around(b, alpha, REACH), alpha), held, clamp=True)
    for condition in (between, covered, math('LESS_THAN', change, LITTLE), math('GREATER_THAN', found, FAINT)):
        stopped = math('MULTIPLY', stopped, condition)
    opaque = b.node('CompositorNodeSeparateColor', (front,)).outputs["Alpha"]
    return _alpha(b, 'Replace Alpha', _mix(b, 'MIX', stopped, clean, sharp), opaque)


def _around(b: Builder, number, pixels: int):
    """The largest number around each pixel; the smallest one if the pixels are negative."""
    node = b.node('CompositorNodeDilateErode', {"Mask": number})
    if hasattr(node, "distance"):  # before Blender 5
        node.mode, node.distance = 'STEP', pixels
    else:
        node.inputs["Type"].default_value, node.inputs["Size"].default_value = 'Steps', pixels
    return node.outputs[0]


def _blurred(b: Builder, image, pixels: int):
    node = b.node('CompositorNodeBlur', {"Image": image})
    if hasattr(node, "size_x"):  # before Blender 5
        node.filter_type, node.size_x, node.size_y = 'GAUSS', pixels, pixels
    else:
        node.inputs["Type"].default_value, node.inputs["Size"].default_value = 'Gaussian', (pixels, pixels)
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

# SPDX-License-Identifier: GPL-3.0-or-later
"""*Light Probe*: an empty at whose place the splats become a panorama, which lights the meshes of *Render With Meshes* on every frame.

The scene of the meshes gets worlds of its own: copies of the scene's, in which the panorama lies over what was there, for all rays but
those that go straight from the camera to the background.  The panorama is a file in a temporary folder that is written before each frame
is rendered (engine/light_probe.py).  Each has another name, so that no engine takes one for another, and only the evaluated world of the
render hears of it: nothing in the open file changes from frame to frame.
"""
import hashlib
import itertools
import tempfile
from pathlib import Path

import bpy
import numpy as np

from ..fastgs_blender.util.picture_files import write_exr
from ..fastgs_blender.util.rotations import transformed
from . import sky
from .node_trees import Builder

NAME = "Light Probe"
SOURCE, FACTS = "fastgs_probe_of", "fastgs_probe_facts"
"""Custom properties of a world that was made here: the world that it was copied from, and what that one looked like."""
NODES = "FAST-GS Light Probe", "FAST-GS Light Probe Cover"
"""The nodes of the panorama's colours, and of how much they cover of the world, which are pictures of one sequence."""
PLAIN = 'ShaderNodeOutputWorld', 'ShaderNodeBackground', 'ShaderNodeRGB', 'ShaderNodeValue'
"""Nodes of a world that looks alike in all directions: over it, the panorama alone says where Cycles looks for light."""
MAP = 4096
"""Cycles does not know the panorama's width, and evaluates so many directions around (and half as many from top to bottom) before each
frame, which takes a second of processor.  Four for each pixel make as little noise."""
FIRST = -1_000_000
"""Frame from which the sequence of one picture begins: on any frame, a node's file is the one of its offset."""

_folder: tempfile.TemporaryDirectory | None = None
_numbers = itertools.count(1)


def is_one(obj) -> bool:
    """Whether an object is a light probe."""
    return obj.type == 'EMPTY' and obj.fastgs.probe.use


def all_of(scene) -> list:
    """The light probes of a scene by name; the first one that renders show is the one that counts."""
    return sorted((obj for obj in scene.objects if is_one(obj)), key=lambda obj: obj.name_full)


def shown(scene, depsgraph):
    """The light probe of a scene, as a depsgraph has evaluated it; None where it shows none."""
    found = (obj.evaluated_get(depsgraph) for obj in all_of(scene))
    return next((obj for obj in found if obj.is_evaluated), None)


def add(context, mesh=None) -> bpy.types.Object:
    """A new light probe at the 3D cursor; with a mesh, around it and its child."""
    probe = bpy.data.objects.new(NAME, None)
    probe.empty_display_type, probe.empty_display_size = 'SPHERE', 0.25
    probe.show_name = probe.fastgs.probe.use = True
    context.collection.objects.link(probe)
    if mesh is None:
        probe.location = context.scene.cursor.location
        return probe
    context.view_layer.update()
    corners = transformed(np.array(mesh.bound_box), np.array(mesh.matrix_world))
    probe.location = (corners.min(0) + corners.max(0)) / 2
    probe.empty_display_size = float(np.ptp(corners, axis=0).max()) / 2 or 0.25
    probe.parent, probe.matrix_parent_inverse = mesh, mesh.matrix_world.inverted_safe()
    return probe


def radius(probe) -> float:
    """The radius of a probe's sphere in the world; what lies inside is no part of the panorama."""
    return float(probe.empty_display_size * np.cbrt(abs(np.linalg.det(np.array(probe.matrix_world)[:3, :3]))))


def follow(scene, other) -> bool:
    """Give the scene of a scene's meshes the worlds that it should have: the scene's own ones, or copies with a panorama.

    Returns whether one is another now.
    """
    moved = False
    probes, before = all_of(scene), _made(other)
    slots = [(other, "world", scene.world)]
    slots += [(other.view_layers[layer.name], "world_override", layer.world_override) for layer in scene.view_layers
              if hasattr(layer, "world_override") and layer.name in other.view_layers]
    for owner, name, world in slots:
        now, wanted = getattr(owner, name), world
        if probes and (world is not None or name == "world"):
            width = probes[0].fastgs.probe.width
            wanted = now if _is_copy(now, world, width) else _copied(world, f"{scene.name} {NAME}", width)
        if now != wanted:
            setattr(owner, name, wanted)
            moved = True
    _drop(before - _made(other))
    for world in _made(other):
        for image in _images(world):
            path = _path(image.name, 1)
            if image.filepath != path:
                image.filepath = path
    return moved


def remove(other) -> None:
    """Take away the worlds that were made for a scene of meshes, which is about to go."""
    made = _made(other)
    other.world = None
    for layer in other.view_layers:
        if getattr(layer, "world_override", None) is not None:
            layer.world_override = None
    _drop(made)


def show(world, panorama: np.ndarray) -> None:
    """Write a panorama [h, 2 h, 4], premultiplied and scene-linear, top row first, as what an evaluated world shows from now on."""
    nodes = [world.node_tree.nodes[name] for name in NODES]
    image = nodes[0].image.name
    for old in Path(_path(image, 1)).parent.glob(f"{_stem(image)}_*.exr"):
        old.unlink(missing_ok=True)
    for node, channels in zip(nodes, ((0, 1, 2), (3, 3, 3))):
        node.image_user.frame_offset = number = next(_numbers)
        write_exr(_path(image, 1 + number), {name: panorama[..., channel] for name, channel in zip("RGB", channels)})


def has_panorama(world) -> bool:
    """Whether a world, evaluated or not, was made here."""
    return world is not None and FACTS in world


def source_of(world):
    """The world that one which was made here is a copy of; any other world is its own."""
    return world.get(SOURCE) if has_panorama(world) else world


def unregister():
    global _folder
    if _folder is not None:
        _folder.cleanup()
    _folder = None


def _made(other) -> set:
    worlds = {other.world, *(getattr(layer, "world_override", None) for layer in other.view_layers)}
    return {world for world in worlds if has_panorama(world)}


def _drop(worlds):
    for world in worlds:
        images = _images(world)
        bpy.data.worlds.remove(world)
        for image in images:
            bpy.data.images.remove(image)


def _images(world) -> list:
    return [node.image for node in world.node_tree.nodes if node.name == NODES[0] and node.image is not None]


def _is_copy(made, world, width: int) -> bool:
    return has_panorama(made) and made.get(SOURCE) == world and made[FACTS] == _facts(world, width)


def _facts(world, width: int) -> str:
    """What a world looks like, and how wide the panorama over it is, as a text that can be compared."""
    known = repr([width, *([] if world is None else [world.name_full, *sky.facts(world)])])
    return hashlib.sha256(known.encode()).hexdigest()


def _copied(world, name: str, width: int):
    """A copy of a world, or a black one, with the panorama over it, which is so many pixels wide."""
    made = bpy.data.worlds.new(name) if world is None else world.copy()
    made.name = name
    if world is not None:
        made[SOURCE] = world
    made[FACTS] = _facts(world, width)
    if bpy.app.version < (5, 0, 0) and not made.use_nodes:  # later worlds always have nodes
        made.use_nodes = True
        made.node_tree.nodes["Background"].inputs["Color"].default_value = (*made.color, 1)
    tree = made.node_tree
    if world is None:
        tree.nodes["Background"].inputs["Strength"].default_value = 0.0
    cycles = getattr(made, "cycles", None)  # not where Cycles is disabled
    if cycles and cycles.sampling_method == 'AUTOMATIC' and all(node.bl_idname in PLAIN for node in tree.nodes):
        cycles.sampling_method, cycles.sample_map_resolution = 'MANUAL', min(4 * width, MAP)
    image = bpy.data.images.new(name, 1, 1, float_buffer=True)
    image.source, image.colorspace_settings.name = 'SEQUENCE', 'Non-Color'
    b = Builder(tree)
    light, cover = _panorama_nodes(b, image)
    for output in [node for node in tree.nodes if node.bl_idname == 'ShaderNodeOutputWorld']:
        surface = output.inputs["Surface"]
        own = surface.links[0].from_socket if surface.is_linked else None
        mix = b.first('ShaderNodeMixShader', (cover,) if own is None else (cover, own))
        tree.links.new(b.first('ShaderNodeAddShader', (mix, light)), surface)
    b.arrange()
    return made


def _panorama_nodes(b: Builder, image):
    """(the shader of the panorama's light, how much of the world behind it covers), both nothing for what the camera sees.

    It sees the background through glass too, so that splats which lie behind glass in the picture do not shine through it twice.
    """
    def picture(name):
        node = b.node('ShaderNodeTexEnvironment', name=name, label=name, image=image)
        user = node.image_user
        user.frame_start, user.frame_duration, user.use_auto_refresh = FIRST, 1, True
        return node.outputs["Color"]

    colours, cover = (picture(name) for name in NODES)
    path = b.node('ShaderNodeLightPath').outputs
    bounced = b.math('ADD', path["Diffuse Depth"], path["Glossy Depth"])
    through = b.math('MULTIPLY', path["Is Transmission Ray"], b.math('LESS_THAN', bounced, 0.5))
    lit = b.math('SUBTRACT', 1.0, b.math('MAXIMUM', path["Is Camera Ray"], through))
    return b.first('ShaderNodeBackground', {"Color": colours, "Strength": lit}), b.math('MULTIPLY', cover, lit)


def _stem(name: str) -> str:
    return hashlib.sha256(name.encode()).hexdigest()[:16]


def _path(name: str, number: int) -> str:
    """The file of a panorama of the image of that name."""
    global _folder
    if _folder is None:
        _folder = tempfile.TemporaryDirectory(prefix="fastgs-probe-")
    return str(Path(_folder.name) / f"{_stem(name)}_{number:08d}.exr")

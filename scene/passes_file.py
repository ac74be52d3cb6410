# SPDX-License-Identifier: GPL-3.0-or-later
"""The file of all passes: a File Output node writes those of the splats and those of the meshes into one multi-layer EXR a frame.

Blender's own multi-layer files hold the passes of the scene that is rendered, and the meshes' are another scene's.
"""
import re

import bpy

from . import joins

NAME = "FAST-GS Passes"
MADE = "fastgs_passes"
"""Custom property of the node."""
TYPES = {'VALUE': 'FLOAT', 'VECTOR': 'VECTOR', 'RGBA': 'RGBA'}
"""Type of an input of the node for that of a socket, in Blender 5."""
MESHES, JOINED = ("Meshes", "Joined") if bpy.app.version >= (5, 0, 0) else ("Mesh", "Join")
"""What is added to the names of layers."""
LONGEST = 29, 14
"""Characters that Blender 4 keeps of a name in the file, and those of them that are the pass's."""


def follow(scene) -> None:
    """Make the node, bring it into step or take it away, as *Write Passes* says."""
    tree = joins.tree_of(scene)
    node = next((node for node in tree.nodes if MADE in node), None) if tree else None
    if not scene.fastgs.write_passes or scene.fastgs.render_meshes == 'OFF':
        if node is not None:
            tree.nodes.remove(node)
        return
    node = node or _new(tree)
    _name(node, scene)
    wanted = sockets(scene)
    inputs = [socket for socket in node.inputs if socket.identifier != "__extend__"]
    if list(node[MADE]) != list(wanted) or [_fed(socket) for socket in inputs] != list(wanted.values()):
        _fill(tree, node, wanted)


def sockets(scene) -> dict:
    """What the file holds, by the names of layer and pass: the scene's picture, then all of its layers and of their meshes."""
    tree = joins.tree_of(scene)
    ends = [node for node in tree.nodes if node.bl_idname in ('NodeGroupOutput', 'CompositorNodeComposite') and node.inputs]
    found = {"Composite.Combined": _fed(ends[0].inputs[0])} if ends and ends[0].inputs[0].is_linked else {}
    shown_here = joins.layers(scene)
    for node, shown in shown_here:
        layer = (node.layer or shown.view_layers[0].name) if shown == scene else f"{shown.name} {node.layer}"
        join = joins.join_of(node)
        if join is not None and len(shown_here) > 1:
            found.setdefault(f"{layer} {JOINED}.Combined", join.outputs[0])
        for name, source in ((layer, node), (f"{layer} {MESHES}", join and joins.meshes_of(join))):
            for socket in source.outputs if source else ():
                if socket.enabled and socket.name != "Alpha" and socket.type in TYPES:
                    found.setdefault(f"{name}.{'Combined' if socket.name == 'Image' else socket.name}", socket)
    return found if bpy.app.version >= (5, 0, 0) else dict(zip(fitted(found), found.values()))


def fitted(names) -> list[str]:
    """The names of layers and passes as Blender 4 can hold them: longer layers are cut and numbered, so that none is another's."""
    layers, room = {}, LONGEST[0] - LONGEST[1] - 1
    for layer in dict.fromkeys(name.rpartition(".")[0] for name in names):
        layers[layer] = layer if len(layer) <= room else f"{layer[:room - 3]}~{len(layers)}"
    return [f"{layers[layer]}.{last[:LONGEST[1]]}" for layer, _, last in (name.rpartition(".") for name in names)]


def _fed(socket):
    return socket.links[0].from_socket if socket.is_linked else None


def _new(tree):
    node = tree.nodes.new('CompositorNodeOutputFile')
    node.name = node.label = NAME
    node.location = 1200, -300
    node[MADE] = []
    if hasattr(node.format, "media_type"):  # Blender 5
        node.format.media_type = 'MULTI_LAYER_IMAGE'
    node.format.file_format, node.format.color_depth, node.format.exr_codec = 'OPEN_EXR_MULTILAYER', '32', 'ZIP'
    return node


def _name(node, scene):
    """Let the node write beside the scene's own pictures."""
    folder, stem = re.fullmatch(r"(.*[/\\])?(.*)", scene.render.filepath, re.DOTALL).groups()
    stem = stem.removesuffix(scene.render.file_extension)
    stem += ("" if not stem or stem[-1] in "_-. " else "_") + ("passes" if "#" in stem else "passes_####")
    values = {"directory": folder or "", "file_name": stem} if hasattr(node, "file_name") else {"base_path": (folder or "") + stem}
    for name, value in values.items():
        if getattr(node, name) != value:
            setattr(node, name, value)


def _fill(tree, node, wanted: dict):
    slots = node.file_output_items if hasattr(node, "file_output_items") else node.layer_slots
    slots.clear()
    for name, socket in wanted.items():
        if hasattr(node, "file_output_items"):
            slots.new(TYPES[socket.type], name)
        else:
            slots.new(name)
        tree.links.new(socket, node.inputs[len(slots) - 1])
    node[MADE] = list(wanted)

# SPDX-License-Identifier: GPL-3.0-or-later
"""The nodes that join splats and meshes in a compositor: one behind each Render Layers node of a scene with *Render With Meshes*.

Each lamp with a splat shadow has a node of its own before it, in which the shadow's strength can be set.  A node *FAST-GS Relight*, which
lights the splats in the compositor, stands between the Render Layers node and what uses its picture.
"""
import bpy

from ..fastgs_blender.rendering.passes import PASSES
from . import composite_nodes, holdout, mesh_scene, shadows

MESHES, JOIN, SHADE, RELIGHT = "FAST-GS Meshes", "FAST-GS Join", "FAST-GS Shade", "FAST-GS Relight"
MADE = "fastgs_made"
"""Custom property of a compositor that was made here."""
LAMP = "fastgs_lamp"
"""Custom property of a node of a shadow: the lamp's name."""


def tree_of(scene):
    """The scene's compositor, None where it has none."""
    if bpy.app.version >= (5, 0, 0):
        return scene.compositing_node_group
    return scene.node_tree if scene.use_nodes else None


def layers(scene) -> list[tuple]:
    """The Render Layers nodes of a scene's compositor, each with the scene that it shows; not those of meshes."""
    tree = tree_of(scene)
    found = [(node, node.scene or scene) for node in tree.nodes if node.bl_idname == 'CompositorNodeRLayers'] if tree else []
    return [(node, shown) for node, shown in found if not mesh_scene.is_one(shown)]


def own_tree(scene):
    """The scene's compositor, which shows the scene; a new one where there is none.  A copied scene, whose compositor shows the one that
    it was copied from, gets its own."""
    tree = tree_of(scene) or _new_tree(scene)
    joins = _joins(tree)
    if joins and scene not in [shown for _, shown in layers(scene)]:
        source = splats_of(joins[0]).scene
        if bpy.app.version >= (5, 0, 0) and tree.users > 1:
            tree = scene.compositing_node_group = tree.copy()
        for node, shown in layers(scene):
            if shown == source:
                node.scene = scene
    return tree


def add_relights(scene) -> list:
    """Put a node that lights splats behind each Render Layers node of the scene, switch on the passes that it needs, and return the nodes;
    those that are there stay."""
    tree, found = own_tree(scene), []
    for splats, shown in layers(scene):
        if shown != scene:
            continue
        node = relight_of(splats)
        if node is None:
            used = [link.to_socket for link in splats.outputs["Image"].links]
            node = _new_group(tree, RELIGHT, composite_nodes.relight, splats.location.x + 320, splats.location.y + 60)
            for socket in used:
                tree.links.new(node.outputs[0], socket)
            tree.links.new(splats.outputs["Image"], node.inputs["Image"])
        layer = scene.view_layers.get(splats.layer) or scene.view_layers[0]
        for entry in PASSES.values():
            if entry.blender in node.inputs and not entry.builtin:
                setattr(layer.fastgs, entry.switch.removeprefix("fastgs."), True)
        layer.update_render_passes()
        found.append(node)
    feed_relights(scene)
    return found


def feed_relights(scene) -> None:
    """Bring the inputs of the nodes that light splats into step with the lamps' passes."""
    for splats, _ in layers(scene):
        node = relight_of(splats)
        if node is not None:
            wanted = [entry.blender for entry in PASSES.values() if entry.blender in node.inputs]
            _feed(splats.id_data, node, {name: splats.outputs.get(name) for name in wanted})


def relight_of(splats):
    """The node that lights the splats of a Render Layers node, None where there is none."""
    return next((node for node in splats.id_data.nodes if _is(node, RELIGHT) and _source(node, "Image") == splats), None)


def splats_of(join):
    """The Render Layers node of a join's splats."""
    node = _source(join, "Splats")
    return _source(node, "Image") if node is not None and _is(node, RELIGHT) else node


def _image_of(splats):
    """The socket of the splats' picture: of the node that lights them, if there is one."""
    node = relight_of(splats)
    return splats.outputs["Image"] if node is None else node.outputs[0]


def join_all(scene) -> None:
    """Join all that the scene's compositor shows of scenes with *Render With Meshes*."""
    for node, shown in layers(scene):
        other, layer = mesh_scene.of(shown), node.layer or shown.view_layers[0].name
        if shown.fastgs.render_meshes != 'OFF' and other is not None and layer in other.view_layers:
            _join(tree_of(scene), node, shown, other, layer)


def part(scene) -> None:
    """Take the joins of a scene out of all compositors, and its own if it was made here and holds nothing else."""
    for owner in [owner for owner in bpy.data.scenes if owner.is_editable and tree_of(owner)]:
        nodes = [node for node, shown in layers(owner) if shown == scene]
        for join in _joins(tree_of(owner)):
            if splats_of(join) in nodes:
                _remove(tree_of(owner), join)
    tree = tree_of(scene)
    if tree is None or MADE not in tree or len(tree.nodes) > 2:
        return
    if bpy.app.version >= (5, 0, 0):
        bpy.data.node_groups.remove(tree)
    else:
        tree.nodes.clear()
        scene.use_nodes = False


def _new_tree(scene):
    if bpy.app.version >= (5, 0, 0):
        tree = scene.compositing_node_group = bpy.data.node_groups.new("Compositing", 'CompositorNodeTree')
        tree.interface.new_socket(name="Image", in_out='OUTPUT', socket_type='NodeSocketColor')
        output = tree.nodes.new('NodeGroupOutput')
    else:
        new = scene.node_tree is None
        scene.use_nodes = True
        tree = scene.node_tree
        if new:
            tree.nodes.clear()  # 4.5 begins with four nodes, 4.2 with two
        output = next((node for node in tree.nodes if node.bl_idname == 'CompositorNodeComposite'), None)
        output = output or tree.nodes.new('CompositorNodeComposite')
    tree[MADE] = True
    output.location = 1200, 0
    shown = next((node for node in tree.nodes if node.bl_idname == 'CompositorNodeRLayers'), None)
    shown = shown or tree.nodes.new('CompositorNodeRLayers')
    shown.scene = scene  # a new node shows the scene of the window
    if not output.inputs[0].is_linked:
        tree.links.new(shown.outputs["Image"], output.inputs[0])
    return tree


def _joins(tree) -> list:
    return [node for node in tree.nodes if _is(node, JOIN)]


def _is(node, kind: str) -> bool:
    """Whether a node shows one of the groups that are made here."""
    return node.bl_idname == 'CompositorNodeGroup' and node.node_tree is not None and kind in node.node_tree


def _source(node, name: str):
    """The node that a socket is fed from."""
    links = node.inputs[name].links
    return links[0].from_node if links else None


def _shades(join) -> list:
    """The nodes of shadows before a join, the last one first."""
    found, node = [], _source(join, "Meshes")
    while node is not None and _is(node, SHADE):
        found.append(node)
        node = _source(node, "Image")
    return found


def join_of(splats):
    """The join behind a Render Layers node, None where there is none."""
    return next((join for join in _joins(splats.id_data) if splats_of(join) == splats), None)


def meshes_of(join):
    """The Render Layers node of a join's meshes."""
    found = _shades(join)
    return _source(found[-1], "Image") if found else _source(join, "Meshes")


def _join(tree, splats, scene, other, layer: str):
    """Let all that uses the image of a Render Layers node use what it and the meshes make together."""
    join = join_of(splats)
    if join is None:
        used = [link.to_socket for link in _image_of(splats).links]
        join = _new_group(tree, JOIN, composite_nodes.join, splats.location.x + 400, splats.location.y)
        for socket in used:
            tree.links.new(join.outputs[0], socket)
    meshes = meshes_of(join) or tree.nodes.new('CompositorNodeRLayers')
    if (meshes.scene, meshes.layer) != (other, layer):
        meshes.scene, meshes.layer = other, layer
        meshes.name = meshes.label = MESHES
        meshes.location = splats.location.x, splats.location.y - 420
    catcher = meshes.outputs.get("Shadow Catcher") if holdout.with_catchers(scene) else None
    environment = next((s for s in meshes.outputs if s.enabled and "Env" in (s.identifier[:3], s.name[:3])), None)
    _feed(tree, join, {
        "Splats": _image_of(splats), "Splat Alpha": splats.outputs["Alpha"], "Splat Depth": splats.outputs["Depth"],
        "Splat Holdout": splats.outputs.get("Splat Holdout"), "Meshes": _shaded(tree, join, splats, meshes, shadows.lamps(scene)),
        "Mesh Alpha": meshes.outputs["Alpha"], "Mesh Depth": meshes.outputs["Depth"], "Shadow Catcher": catcher,
        "World": environment})
    shown = scene.view_layers[layer]
    held_out = any(holdout.is_held_out(obj, shown) for obj in shown.objects)
    for name, value in (("Transparent", float(scene.render.film_transparent)), ("Held Out", float(held_out))):
        if join.inputs[name].default_value != value:
            join.inputs[name].default_value = value


def _shaded(tree, join, splats, meshes, lamps):
    """The socket of the meshes' image without the light that splats take from it, lamp by lamp."""
    image, there = meshes.outputs["Image"], {node[LAMP]: node for node in _shades(join)}
    for i, lamp in enumerate(lamps):
        node = there.pop(lamp.name_full, None)
        if node is None:
            node = _new_group(tree, SHADE, composite_nodes.shade, meshes.location.x + 260, meshes.location.y - 200 * i)
            node[LAMP] = node.label = lamp.name_full
        light = next((s for s in meshes.outputs if s.enabled and s.name.endswith(mesh_scene.light_group(i))), meshes.outputs["Image"])
        denoised = float(meshes.scene.render.engine == 'CYCLES' and meshes.scene.cycles.use_denoising)
        if node.inputs["Denoise"].default_value != denoised:
            node.inputs["Denoise"].default_value = denoised
        _feed(tree, node, {"Image": image, "Lamp": light, "Splat Shadow": splats.outputs.get(shadows.PASSES[i])})
        image = node.outputs[0]
    for node in there.values():
        tree.nodes.remove(node)
    return image


def _feed(tree, node, sockets: dict):
    """Link a node's inputs to these sockets, and to nothing where one is not in use."""
    for name, socket in sockets.items():
        links = node.inputs[name].links
        if socket is None or not socket.enabled:
            for link in links:
                tree.links.remove(link)
        elif not links or links[0].from_socket != socket:
            tree.links.new(socket, node.inputs[name])


def _new_group(tree, kind: str, build, x: float, y: float):
    """A node that shows the group of a kind, which all of them share."""
    group = next((group for group in bpy.data.node_groups if kind in group and group.library is None), None)
    if group is None:
        group = bpy.data.node_groups.new(kind, 'CompositorNodeTree')
        group[kind] = True
        build(group)  # before a node shows it, which takes over the sockets' values
    node = tree.nodes.new('CompositorNodeGroup')
    node.node_tree = group
    node.name = node.label = kind
    node.location = x, y
    return node


def _remove(tree, join):
    source, used = join.inputs["Splats"].links[0].from_socket, [link.to_socket for link in join.outputs[0].links]
    for socket in used:
        tree.links.new(source, socket)
    nodes = [join, *_shades(join), meshes_of(join)]
    groups = {node.node_tree for node in nodes[:-1]}
    for node in filter(None, nodes):
        tree.nodes.remove(node)
    for group in groups:
        if not group.users:
            bpy.data.node_groups.remove(group)

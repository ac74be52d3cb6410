# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders a scene's meshes and splats as one picture: *Render With Meshes*.

Another engine renders the meshes in a scene of their own (mesh_scene.py).  In the compositor, behind each Render Layers node of the
scene, one node joins both pictures (composite_nodes.py).  No setting of the scene is changed for it: while it is on, the engine adds the
passes that the join needs and leaves the world to it.  Nothing has to be pressed again: everything is brought into step after
each change, and at the beginning of each render.
"""
from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from . import composite_nodes, mesh_scene
from .holdout import with_meshes

MESHES, JOIN = "FAST-GS Meshes", "FAST-GS Join"
PATIENCE = 0.5
"""Seconds until a change is tried again that a render would not survive."""
MADE = "fastgs_made"
"""Custom property of a compositor that was made here."""
NEEDED = ("depth", "holdout")
"""Passes, by their names in the library's table, that the join reads; with a lamp the shadow's too."""


def needs(scene, name: str) -> bool:
    """Whether the join needs a pass of the library's table."""
    return with_meshes(scene) and (name in NEEDED or (name == "shadow" and scene.fastgs.shadow_light is not None))


@persistent
def changed(scene, depsgraph) -> None:
    """Handler, after each evaluation: bring into step what has changed, once Blender is idle.

    Not at once: Blender 5.2 crashes if objects are linked here while the compositor shows another scene.  A render does not wait for it.
    """
    if depsgraph.mode == 'VIEWPORT' and any(each.fastgs.render_meshes != 'OFF' for each in bpy.data.scenes):
        _settle_later()


def chosen(scene) -> None:
    """Set up what the scene's *Render With Meshes* asks for, or take away all of it; a render that is under way keeps its scenes."""
    if _rendering():
        _settle_later()
    else:
        _settle(scene)


def _settle_later():
    if not bpy.app.background and not bpy.app.timers.is_registered(_settle_all):
        bpy.app.timers.register(_settle_all, first_interval=0.0)


def _settle_all():
    if _rendering():
        return PATIENCE
    for scene in [scene for scene in bpy.data.scenes if not mesh_scene.is_one(scene)]:
        _settle(scene)
    return None


def _settle(scene):
    if scene.fastgs.render_meshes == 'OFF' and mesh_scene.of(scene) is not None:
        _part(scene)
        mesh_scene.remove(scene)
        _renew_passes(scene)
    follow(scene)


def _rendering() -> bool:
    return bpy.app.is_job_running('RENDER')


def _renew_passes(scene):
    for layer in scene.view_layers:
        layer.update_render_passes()


def follow(scene) -> None:
    """Bring the scene of the meshes and the compositor into step, if *Render With Meshes* is chosen."""
    if scene.fastgs.render_meshes != 'OFF' and scene.is_editable and not mesh_scene.is_one(scene):
        new = mesh_scene.of(scene) is None
        _join_all(scene, mesh_scene.follow(scene, _engine(scene.fastgs.render_meshes)))
        if new:
            _renew_passes(scene)


def _engine(chosen: str) -> str:
    if chosen == 'CYCLES':
        return 'CYCLES'
    return 'BLENDER_EEVEE_NEXT' if (4, 2, 0) <= bpy.app.version < (5, 0, 0) else 'BLENDER_EEVEE'


def _join_all(scene, other):
    tree = _own_tree(scene, other)
    for node in [node for node in tree.nodes if node.bl_idname == 'CompositorNodeRLayers' and node.scene in (None, scene)]:
        layer = node.layer or scene.view_layers[0].name
        if layer in other.view_layers:
            _join(tree, node, scene, other, layer)


def _own_tree(scene, other):
    """The scene's compositor; one that shows the scene where there is none.  A copied scene's becomes its own."""
    tree = tree_of(scene) or _new_tree(scene)
    for join in _joins(tree):
        splats, meshes = _source(join, "Splats"), _source(join, "Meshes")
        if splats is None or splats.scene in (None, scene):
            continue
        if bpy.app.version >= (5, 0, 0) and tree.users > 1:
            scene.compositing_node_group = tree.copy()
            return _own_tree(scene, other)
        splats.scene = scene
        if meshes is not None:
            meshes.scene = other
    return tree


def tree_of(scene):
    """The scene's compositor, None where it has none."""
    if bpy.app.version >= (5, 0, 0):
        return scene.compositing_node_group
    return scene.node_tree if scene.use_nodes else None


def _new_tree(scene):
    if bpy.app.version >= (5, 0, 0):
        tree = scene.compositing_node_group = bpy.data.node_groups.new("Compositing", 'CompositorNodeTree')
        tree.interface.new_socket(name="Image", in_out='OUTPUT', socket_type='NodeSocketColor')
        output = tree.nodes.new('NodeGroupOutput')
    else:
        scene.use_nodes = True  # which makes a Render Layers and a Composite node where there are none
        tree = scene.node_tree
        output = next((node for node in tree.nodes if node.bl_idname == 'CompositorNodeComposite'), None)
        output = output or tree.nodes.new('CompositorNodeComposite')
    tree[MADE] = True
    output.location = 1200, 0
    if not output.inputs[0].is_linked:
        layers = next((node for node in tree.nodes if node.bl_idname == 'CompositorNodeRLayers'), None)
        tree.links.new((layers or tree.nodes.new('CompositorNodeRLayers')).outputs["Image"], output.inputs[0])
    return tree


def _joins(tree) -> list:
    return [node for node in tree.nodes if node.bl_idname == 'CompositorNodeGroup' and node.node_tree and JOIN in node.node_tree]


def _source(join, name: str):
    """The node that a socket of the join is fed from."""
    links = join.inputs[name].links
    return links[0].from_node if links else None


def _join(tree, splats, scene, other, layer: str):
    """Let all that uses the image of a Render Layers node use what it and the meshes make together."""
    join = next((join for join in _joins(tree) if _source(join, "Splats") == splats), None)
    if join is None:
        join = _new_join(tree, splats)
    meshes = _source(join, "Meshes") or tree.nodes.new('CompositorNodeRLayers')
    if (meshes.scene, meshes.layer) != (other, layer):
        meshes.scene, meshes.layer = other, layer
        meshes.name = meshes.label = MESHES
        meshes.location = splats.location.x, splats.location.y - 420
    image = meshes.outputs["Image"]
    environment = next((s for s in meshes.outputs if s.enabled and "Env" in (s.identifier[:3], s.name[:3])), None)
    lamp = next((s for s in meshes.outputs if s.enabled and s.name.endswith(mesh_scene.LAMP)), image)
    for name, socket in (
            ("Splats", splats.outputs["Image"]), ("Splat Alpha", splats.outputs["Alpha"]), ("Splat Depth", splats.outputs["Depth"]),
            ("Splat Holdout", splats.outputs.get("Splat Holdout")), ("Splat Shadow", splats.outputs.get("Splat Shadow")),
            ("Meshes", image), ("Mesh Alpha", meshes.outputs["Alpha"]), ("Mesh Depth", meshes.outputs["Depth"]),
            ("Lamp", lamp), ("World", environment)):
        links = join.inputs[name].links
        if socket is None or not socket.enabled:
            for link in links:
                tree.links.remove(link)
        elif not links or links[0].from_socket != socket:
            tree.links.new(socket, join.inputs[name])
    transparent = float(scene.render.film_transparent)
    if join.inputs["Transparent"].default_value != transparent:
        join.inputs["Transparent"].default_value = transparent


def _new_join(tree, splats):
    group = next((group for group in bpy.data.node_groups if JOIN in group and group.library is None), None)
    if group is None:
        group = bpy.data.node_groups.new(JOIN, 'CompositorNodeTree')
        group[JOIN] = True
        composite_nodes.build(group)  # before a node shows it, which takes over the sockets' values
    used = [link.to_socket for link in splats.outputs["Image"].links]
    join = tree.nodes.new('CompositorNodeGroup')
    join.node_tree = group
    join.name = join.label = JOIN
    join.location = splats.location.x + 400, splats.location.y
    for socket in used:
        tree.links.new(join.outputs[0], socket)
    return join


def _part(scene):
    """Take the joins out of the compositor, and the compositor itself if it was made here and holds nothing else."""
    tree = tree_of(scene)
    for join in _joins(tree) if tree else ():
        splats, meshes, group = _source(join, "Splats"), _source(join, "Meshes"), join.node_tree
        for socket in [link.to_socket for link in join.outputs[0].links] if splats else ():
            tree.links.new(splats.outputs["Image"], socket)
        for node in (join, meshes):
            if node is not None:
                tree.nodes.remove(node)
        if not group.users:
            bpy.data.node_groups.remove(group)
    if tree is None or MADE not in tree or len(tree.nodes) > 2:
        return
    if bpy.app.version >= (5, 0, 0):
        bpy.data.node_groups.remove(tree)
    else:
        tree.nodes.clear()
        scene.use_nodes = False

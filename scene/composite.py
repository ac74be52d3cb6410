# SPDX-License-Identifier: GPL-3.0-or-later
"""Sets up the composite of splats and meshes: a second scene renders the meshes with another engine, the compositor joins both.

Both are rendered without the world behind them, so that edges are soft, and the splats without what the meshes hide.  One node, a group
(composite_nodes.py), joins them.  It and the node for the meshes have names of their own: setting up again uses them again, and the
user's nodes stay.
"""
from __future__ import annotations

import bpy

from . import composite_nodes, holdout, objects

PREFIX = "FAST-GS "
MESHES, JOIN = PREFIX + "Meshes", PREFIX + "Join"
KEPT = ("resolution_x", "resolution_y", "resolution_percentage", "pixel_aspect_x", "pixel_aspect_y", "fps", "fps_base", "frame_map_old",
        "frame_map_new", "use_border", "use_crop_to_border", "border_min_x", "border_max_x", "border_min_y", "border_max_y",
        "use_motion_blur", "threads_mode", "threads")
"""Render settings that the scene of the meshes takes over."""


def is_set_up(scene) -> bool:
    """Whether a scene's compositor joins what another engine has rendered in another scene."""
    tree = _tree(scene)
    return tree is not None and scene.render.use_compositing and any(
        node.bl_idname == 'CompositorNodeRLayers' and not node.mute and node.scene not in (None, scene)
        and node.scene.render.engine != 'FASTGS' for node in tree.nodes)


def engines() -> list[tuple[str, str, str]]:
    """Engines that can render the meshes, as items of a menu: the first one is Cycles where this Blender has it."""
    known = {getattr(cls, "bl_idname", "") for cls in bpy.types.RenderEngine.__subclasses__()}
    eevee = 'BLENDER_EEVEE_NEXT' if (4, 2, 0) <= bpy.app.version < (5, 0, 0) else 'BLENDER_EEVEE'
    cycles = [('CYCLES', "Cycles", "Path tracing: light, shadows and reflections of the meshes")] if 'CYCLES' in known else []
    return [*cycles, (eevee, "EEVEE", "Fast, needs a GPU")]


def set_up(scene, view_layer, engine: str) -> bpy.types.Scene:
    """Let another engine render the meshes of a view layer, and the compositor join them with the splats; returns their scene."""
    tree = _tree(scene) or _new_tree(scene)
    splats = _splats_node(tree, scene, view_layer)
    meshes = tree.nodes.get(MESHES) or tree.nodes.new('CompositorNodeRLayers')
    other = meshes.scene if meshes.name == MESHES and meshes.scene not in (None, scene) else bpy.data.scenes.new(f"{scene.name} Meshes")
    _follow(other, scene, view_layer, engine)
    world = not scene.render.film_transparent
    scene.render.film_transparent = scene.render.use_compositing = view_layer.use_pass_z = scene.fastgs.use_meshes = True
    view_layer.fastgs.use_pass_holdout = True
    view_layer.fastgs.use_pass_shadow |= scene.fastgs.shadow_light is not None
    meshes.name = meshes.label = MESHES
    meshes.scene, meshes.layer = other, other.view_layers[0].name
    _join(tree, splats, meshes, world)
    return other


def _tree(scene):
    """The scene's compositor, None where it has none."""
    if bpy.app.version >= (5, 0, 0):
        return scene.compositing_node_group
    return scene.node_tree if scene.use_nodes else None


def _new_tree(scene):
    """A compositor that shows the scene."""
    if bpy.app.version >= (5, 0, 0):
        tree = scene.compositing_node_group = bpy.data.node_groups.new("Compositing", 'CompositorNodeTree')
        tree.interface.new_socket(name="Image", in_out='OUTPUT', socket_type='NodeSocketColor')
        output = tree.nodes.new('NodeGroupOutput')
    else:
        scene.use_nodes = True  # which makes a Render Layers and a Composite node where there are none
        tree = scene.node_tree
        output = next((node for node in tree.nodes if node.bl_idname == 'CompositorNodeComposite'), None)
        output = output or tree.nodes.new('CompositorNodeComposite')
    output.location = 1200, 0
    if not output.inputs[0].is_linked:
        layers = next((node for node in tree.nodes if node.bl_idname == 'CompositorNodeRLayers'), None)
        tree.links.new((layers or tree.nodes.new('CompositorNodeRLayers')).outputs["Image"], output.inputs[0])
    return tree


def _splats_node(tree, scene, view_layer):
    """The user's node for the view layer of the splats; a new one where there is none."""
    for node in tree.nodes:
        if node.bl_idname == 'CompositorNodeRLayers' and node.name != MESHES and node.scene in (None, scene) and node.layer in (
                "", view_layer.name):
            break
    else:
        node = tree.nodes.new('CompositorNodeRLayers')
    node.scene, node.layer = scene, view_layer.name
    return node


def _follow(other, scene, view_layer, engine):
    """Let the scene of the meshes hold and show what the scene does, but for the splats."""
    for name in KEPT:
        setattr(other.render, name, getattr(scene.render, name))
    for name in ("frame_start", "frame_end", "frame_step", "camera", "world"):
        setattr(other, name, getattr(scene, name))
    other.render.engine = engine
    other.render.film_transparent = True
    for name in ("view_transform", "look", "exposure", "gamma"):
        setattr(other.view_settings, name, getattr(scene.view_settings, name))
    layer = other.view_layers[0]
    layer.use_pass_z = layer.use_pass_environment = True
    helpers = holdout.helpers(scene)  # a native copy that the camera does not see is there for its shadows and reflections
    wanted = {obj.name: obj for obj in _rendered(view_layer.layer_collection) if not objects.is_splat(obj) and (
        obj.name not in helpers or (obj.fastgs.copy_of is not None and not obj.visible_camera))}
    for obj in [obj for obj in other.collection.objects if obj.name not in wanted]:
        other.collection.objects.unlink(obj)
    for name, obj in wanted.items():
        if name not in other.collection.objects:
            other.collection.objects.link(obj)


def _rendered(layer):
    """The objects of a layer collection that final renders may show."""
    if layer.exclude or layer.collection.hide_render:
        return
    yield from layer.collection.objects
    for child in layer.children:
        yield from _rendered(child)


def _join(tree, splats, meshes, world: bool):
    """Link both pictures to the node that joins them, and let all that used the splats' image use its."""
    meshes.location = splats.location.x, splats.location.y - 420
    join = tree.nodes.get(JOIN)
    if join is None:
        used = [link.to_socket for link in splats.outputs["Image"].links]
        group = bpy.data.node_groups.new(JOIN, 'CompositorNodeTree')
        composite_nodes.build(group)  # before a node shows it, which takes over the sockets' values
        join = tree.nodes.new('CompositorNodeGroup')
        join.node_tree = group
        join.name = join.label = JOIN
        join.location = splats.location.x + 400, splats.location.y
    else:
        composite_nodes.build(join.node_tree)
        used, world = [], join.inputs["World"].is_linked
    environment = next((s for s in meshes.outputs if s.identifier == "Env" or s.name in ("Environment", "Env")), None)
    for name, socket in (
            ("Splats", splats.outputs["Image"]), ("Splat Alpha", splats.outputs["Alpha"]), ("Splat Depth", splats.outputs["Depth"]),
            ("Splat Holdout", splats.outputs["Splat Holdout"]), ("Splat Shadow", splats.outputs.get("Splat Shadow")),
            ("Meshes", meshes.outputs["Image"]), ("Mesh Alpha", meshes.outputs["Alpha"]), ("Mesh Depth", meshes.outputs["Depth"]),
            ("World", environment if world else None)):
        if socket is not None and socket.enabled:
            tree.links.new(socket, join.inputs[name])
    for socket in used:
        tree.links.new(join.outputs[0], socket)

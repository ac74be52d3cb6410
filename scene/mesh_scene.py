# SPDX-License-Identifier: GPL-3.0-or-later
"""The second scene, in which Cycles or EEVEE renders the meshes beside the splats of a scene.

It begins as a copy and shares the scene's collections, so what is added to these is in it by itself.  What it holds of its own (shutter,
camera, markers, flags of view layers ...) is compared with the scene's and written where it differs.
"""
import bpy

from . import holdout, light_probe, objects, shadows

RAYS = ("camera", "diffuse", "glossy", "transmission", "volume_scatter", "shadow")
SHARED = ("frame_start", "frame_end", "frame_step", "camera", "active_clip", "gravity", "use_gravity", "use_custom_simulation_range",
          "simulation_frame_start", "simulation_frame_end")
"""Properties of a scene itself that both have alike."""
OWN = ("engine", "film_transparent", "use_compositing", "use_sequencer", "filepath")
"""Render settings that the scene of the meshes has for itself."""

MADE = "fastgs_meshes"
"""Custom property of a scene that was made here."""


def light_group(i: int) -> str:
    """The light group of the i-th lamp whose light the splats take away; short, for files of Blender 4."""
    return f"FGS{i + 1}"


def is_one(scene) -> bool:
    """Whether a scene, evaluated or not, renders the meshes of another."""
    return scene.fastgs.splats_scene is not None


def of(scene) -> bpy.types.Scene | None:
    """The scene that renders the meshes of this one."""
    return next((other for other in bpy.data.scenes if other.fastgs.splats_scene == scene), None)


def follow(scene, engine: str) -> bpy.types.Scene:
    """Make the scene of the meshes, or bring it into step; engine: Blender's name of what renders it."""
    other = of(scene) or _new(scene)
    for name in SHARED:
        if hasattr(scene, name):
            _set(other, name, getattr(scene, name))
    _follow_bodies(scene, other)
    for part in ("display_settings", "view_settings", "unit_settings"):
        _copy(getattr(scene, part), getattr(other, part))
    _copy(scene.render, other.render, OWN)
    _copy_curve(scene.render.motion_blur_shutter_curve, other.render.motion_blur_shutter_curve)
    for name, value in zip(OWN, (engine, True, False, False)):
        _set(other.render, name, value)
    _follow_animation(scene, other)
    _follow_drivers(scene, other)
    _follow_markers(scene.timeline_markers, other.timeline_markers)
    _follow_views(scene.render.views, other.render.views)
    moved = [_follow_contents(scene.collection.children, other.collection.children),
             _follow_contents(scene.collection.objects, other.collection.objects),
             _follow_layers(scene, other), light_probe.follow(scene, other)]
    if any(moved):  # the compositor's scenes are part of a depsgraph, and Blender 5.2 crashes if it meets new objects or worlds in it
        for layer in other.view_layers:
            layer.update()
    return other


def follow_sub_frame(scene) -> None:
    """Set the sub-frame of all scenes of meshes to that of the scene which is about to be rendered: Blender sets their frame alone."""
    for other in bpy.data.scenes:
        if is_one(other) and other.frame_subframe != scene.frame_subframe:
            other.frame_float = scene.frame_current + scene.frame_subframe


def remove(other) -> None:
    """Take away a scene of meshes; what it shows belongs to the scene of the splats and stays."""
    light_probe.remove(other)
    bpy.data.scenes.remove(other)


def left_over() -> list:
    """The scenes of meshes whose splats' scene was deleted; not the last scene of a file."""
    return [scene for scene in bpy.data.scenes if MADE in scene and not is_one(scene) and scene.is_editable][:len(bpy.data.scenes) - 1]


def hide(depsgraph) -> None:
    """Leave out of an evaluated scene of meshes what is no mesh beside the splats: these, shapes that crop them, copies that show them.

    Meshes that were made of splats are left out of the camera's view alone, unless they are shadow catchers.

    It writes to the evaluated objects alone.  The lamps whose light splats take away get their light groups in the same way.
    """
    scene = depsgraph.scene.fastgs.splats_scene.original
    helpers = holdout.helpers(scene)
    for obj in bpy.data.objects:
        if objects.is_splat(obj) or (obj.name in helpers and (obj.fastgs.copy_of is None or obj.visible_camera)):
            evaluated = obj.evaluated_get(depsgraph)
            if evaluated.is_evaluated:
                surface = obj.fastgs.surface_of is not None  # which is seen in mirrors, shines, and may catch shadows
                for ray in ("camera",) * (not obj.is_shadow_catcher) if surface else RAYS:
                    setattr(evaluated, f"visible_{ray}", False)
    for i, lamp in enumerate(shadows.lamps(scene)):
        evaluated = lamp.evaluated_get(depsgraph)
        if evaluated.is_evaluated:
            evaluated.lightgroup = light_group(i)
    if depsgraph.scene.original.background_set == scene:  # for its rigid bodies; what the view layer excludes is not shown for that
        here = {obj.name_full for obj in depsgraph.view_layer.objects}
        for obj in [obj for obj in scene.objects if obj.name_full not in here]:
            evaluated = obj.evaluated_get(depsgraph)
            if evaluated.is_evaluated:
                for ray in RAYS:
                    setattr(evaluated, f"visible_{ray}", False)


def _new(scene):
    other = scene.copy()
    other.name = f"{scene.name} Meshes"
    other.fastgs.splats_scene, other[MADE] = scene, True
    other.fastgs.property_unset("render_meshes")
    if bpy.app.version >= (5, 0, 0):
        other.compositing_node_group = None
    elif other.node_tree is not None:
        other.node_tree.nodes.clear()
        other.use_nodes = False
    other.sequence_editor_clear()
    if hasattr(other, "cycles"):
        other.cycles.film_transparent_glass = True
    return other


def _follow_bodies(scene, other):
    """Let rigid bodies be where they are in the scene, whose set this one becomes: Blender evaluates the rigid bodies of sets.

    A rigid body world of its own would have a simulation of its own, which no one has played.
    """
    if other.rigidbody_world is not None:
        with bpy.context.temp_override(scene=other):
            bpy.ops.rigidbody.world_remove()
    _set(other, "background_set", scene.background_set if scene.rigidbody_world is None else scene)


def _set(target, name: str, value) -> bool:
    """Whether a property had another value."""
    changes = getattr(target, name) != value
    if changes:
        setattr(target, name, value)
    return changes


def _copy(source, target, leave=()):
    """Give a struct the plain values of another of its kind."""
    for prop in source.bl_rna.properties:
        name = prop.identifier
        if prop.is_readonly or prop.type in ('POINTER', 'COLLECTION') or name in leave:
            continue
        here, there = getattr(source, name), getattr(target, name)
        if (tuple(here) != tuple(there)) if getattr(prop, "is_array", False) else here != there:
            setattr(target, name, here)


def _copy_curve(source, target):
    for here, there in zip(source.curves, target.curves):
        points = [(*point.location, point.handle_type) for point in here.points]
        if points == [(*point.location, point.handle_type) for point in there.points]:
            continue
        while len(there.points) > max(len(points), 2):
            there.points.remove(there.points[-1])
        while len(there.points) < len(points):
            there.points.new(0, 0)
        for point, (x, y, handle) in zip(there.points, points):
            point.location, point.handle_type = (x, y), handle
        target.update()


def _follow_animation(scene, other):
    data = scene.animation_data
    action = data.action if data else None
    if action is None and other.animation_data is None:
        return
    animation = other.animation_data or other.animation_data_create()
    _set(animation, "action", action)
    if action is not None and hasattr(data, "action_slot"):  # Blender 4.4 and later
        _set(animation, "action_slot", data.action_slot)


def _follow_drivers(scene, other):
    here, there = (list(each.animation_data.drivers) if each.animation_data else [] for each in (scene, other))
    if [_driver(curve) for curve in here] != [_driver(curve) for curve in there]:
        other.animation_data_create()
        for curve in there:
            other.animation_data.drivers.remove(curve)
        for curve in here:
            other.animation_data.drivers.from_existing(src_driver=curve)


def _driver(curve) -> tuple:
    """What a driver computes, to compare it."""
    targets = [(variable.name, variable.type, target.id, target.data_path, target.transform_type, target.transform_space)
               for variable in curve.driver.variables for target in variable.targets]
    return (curve.data_path, curve.array_index, curve.mute, curve.driver.type, curve.driver.expression, curve.driver.use_self,
            [tuple(point.co) for point in curve.keyframe_points], targets)


def _follow_markers(source, target):
    wanted = [(marker.name, marker.frame, marker.camera) for marker in source]
    if wanted == [(marker.name, marker.frame, marker.camera) for marker in target]:
        return
    target.clear()
    for name, frame, camera in wanted:
        target.new(name, frame=frame).camera = camera


def _follow_views(source, target):
    for view in [view for view in target if view.name not in source]:
        target.remove(view)
    for view in source:
        _copy(view, target.get(view.name) or target.new(view.name))


def _follow_contents(source, target) -> bool:
    """Link what a scene's own collection holds, objects or collections, into another; whether anything was missing or too much."""
    gone, new = [item for item in target if item.name not in source], [item for item in source if item.name not in target]
    for item in gone:
        target.unlink(item)
    for item in new:
        target.link(item)
    return bool(gone or new)


def _follow_layers(scene, other) -> bool:
    """Give both scenes the same view layers; whether other objects are shown now."""
    moved = {layer.name for layer in other.view_layers} != {layer.name for layer in scene.view_layers}
    for layer in [layer for layer in other.view_layers if layer.name not in scene.view_layers]:
        if len(other.view_layers) > 1:
            other.view_layers.remove(layer)
        else:
            layer.name = scene.view_layers[0].name
    for layer in scene.view_layers:
        target = other.view_layers.get(layer.name) or other.view_layers.new(layer.name)
        _copy(layer, target, [prop.identifier for prop in layer.bl_rna.properties if prop.identifier.startswith(("use_pass_", "pass_"))])
        _set(target, "material_override", layer.material_override)
        for name in ("use_pass_combined", "use_pass_z", "use_pass_environment"):
            _set(target, name, True)
        _set(target, "pass_alpha_threshold", 0.0)  # the depth of glass, too
        if holdout.with_catchers(scene):
            _set(target.cycles, "use_pass_shadow_catcher", True)
        moved |= _follow_collection(layer.layer_collection, target.layer_collection)
        for i in range(len(shadows.lamps(scene))):
            if light_group(i) not in target.lightgroups:
                target.lightgroups.add(name=light_group(i))
    return moved


def _follow_collection(source, target) -> bool:
    """Copy the flags of a layer's collections; whether one was another."""
    moved = [_set(target, name, getattr(source, name)) for name in ("exclude", "holdout", "indirect_only")]
    return any(moved + [_follow_collection(child, target.children[child.name]) for child in source.children
                        if child.name in target.children])

# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects whose mesh is the surface of a splat object and moves as its Gaussians do.

The mesh has a shape key for each of the shapes of a MovingMesh.  A driver gives its value, by a curve over the capture's frame, which a
custom property of the object holds; a handler keeps that property at what the splat object shows.  All else is Blender's own: whatever
works with shape keys (simulations, motion blur, Alembic, USD) works with these, and files need neither the extension nor the model.
"""
from dataclasses import replace

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...fastgs_blender.model.gaussians import GaussianModel
from ...fastgs_blender.model.slicing import positions_at, sigmoid
from ...fastgs_blender.rendering.crops import crop_share
from ...fastgs_blender.surfaces.making import MovingMesh
from ...fastgs_blender.util.errors import FastGSError
from ...fastgs_blender.util.rotations import transformed
from .. import arrays, model_space, objects, snapshot
from ..cameras.keys import curve_of, driver_of
from ..colour import linear, rec709_to_working
from ..splats.proxy_nodes import COLOUR, modifier_of, shining_material
from ..time import clip_frame

FRAME = "Capture Frame"
"""Custom property of the objects: the capture's frame that the mesh shows."""
PATH = f'["{FRAME}"]'
NAME = "FAST-GS Surface"
"""Of the material."""


def is_one(obj) -> bool:
    """Whether an object is the surface of a splat object."""
    return obj.fastgs.surface_of is not None


def shown(obj, depsgraph) -> tuple[GaussianModel, float]:
    """What of its model a splat object shows now, crops and filters counted, and the model's time.

    Raises FastGSError where it shows nothing, or has no model whose Gaussians move.
    """
    objects.load_one_model(obj, "followed by a mesh")
    item = snapshot.instance_of(obj.evaluated_get(depsgraph), depsgraph, model_space.model_matrix(obj), True)
    item = replace(item, retime=replace(item.retime, echoes=0, fade=0.0), points=None)
    found, trouble = snapshot.Snapshot([item], *snapshot.clock(depsgraph.scene)).load()
    if trouble:
        raise FastGSError(trouble[0][1])
    if not found:
        raise FastGSError("it shows nothing on this frame; go to a frame of its clip.")
    instance = found[0]
    keep = (sigmoid(instance.model.opacity) >= instance.settings.opacity_cut)
    keep &= crop_share(instance.settings.crops, positions_at(instance.model, instance.t)) > 0.5
    if len(instance.hidden):
        keep &= ~instance.hidden
    return instance.model.take(keep), instance.t


def build(context, obj, meshes: list[MovingMesh], model: GaussianModel) -> list[bpy.types.Object]:
    """An object for each mesh, beside a splat object and its child.  Of several, each is hidden outside of its own time."""
    found = []
    place = model_space.model_matrix(obj)
    for i, moving in enumerate(meshes):
        name = f"{obj.name} Surface"
        new = bpy.data.objects.new(name, _mesh(name, moving, place, model.colour_space))
        new.parent, new.fastgs.surface_of, new.fastgs.hides_splats = obj, obj, False
        new[FRAME] = 0.0
        new.id_properties_ui(FRAME).update(description="The frame of the capture that this mesh shows; it follows the splat object")
        for collection in obj.users_collection or (context.scene.collection,):
            collection.objects.link(new)
        frames = moving.times * model.clip.frame_count
        _drive(new, moving.shapes @ place[:3, :3].T, frames, moving.curves, moving.slopes / model.clip.frame_count)
        if len(meshes) > 1:
            before = frames[0] if i else -1e9
            after = meshes[i + 1].times[0] * model.clip.frame_count if i + 1 < len(meshes) else 1e9
            for path in ("hide_viewport", "hide_render"):
                _driver(new, path, new, f"f < {before:.9g} or f >= {after:.9g}")
        found.append(new)
    modifier = modifier_of(obj)
    if modifier is not None:
        modifier.show_render = False
    follow(context.scene)
    return found


@persistent
def before(scene, depsgraph=None) -> None:
    """Handler, before a frame is evaluated: tell the meshes which frame of the capture it is."""
    follow(scene)


@persistent
def after(scene, depsgraph=None) -> None:
    """Handler, after each evaluation: the same, where keys have changed how the splat object plays its clip."""
    if depsgraph is not None:
        follow(depsgraph.scene, depsgraph)


def follow(scene, depsgraph=None) -> None:
    """Set the capture's frame of all meshes to what their splat objects, evaluated if there is a depsgraph, show."""
    frame, fps = snapshot.clock(scene)
    for obj in bpy.data.objects:
        if not is_one(obj) or not obj.is_editable or FRAME not in obj:
            continue
        if curve_of(obj, PATH) is not None or driver_of(obj, PATH) is not None:
            continue  # somebody animates it
        splat = obj.fastgs.surface_of
        evaluated = splat if depsgraph is None else splat.evaluated_get(depsgraph)
        if not objects.is_splat(splat) or (depsgraph is not None and not evaluated.is_evaluated):
            continue
        try:
            shows = clip_frame(frame, fps, snapshot.retime_of(evaluated, frame), objects.clip_of(splat))
        except FastGSError:  # its numbers are none; the panel says so
            continue
        if shows is not None and abs(obj[FRAME] - shows) > 1e-6:
            obj[FRAME] = shows
            obj.update_tag()


def _mesh(name: str, moving: MovingMesh, place: np.ndarray, colour_space: str) -> bpy.types.Mesh:
    """A mesh with shape keys, in the object's space."""
    mesh, count = bpy.data.meshes.new(name), len(moving.rest)
    arrays.fill(mesh, transformed(moving.rest, place), moving.quads)
    mesh.update(calc_edges=True)
    mesh.shade_smooth()
    light = linear(moving.colours.astype(np.float64), colour_space) @ rec709_to_working().T
    colour = mesh.color_attributes.new(COLOUR, 'FLOAT_COLOR', 'POINT')
    colour.data.foreach_set("color", np.c_[light, np.ones(count)].astype(np.float32).ravel())
    mesh.color_attributes.active_color = colour
    mesh.materials.append(bpy.data.materials.get(NAME) or shining_material(NAME))
    return mesh


def _drive(obj, shapes: np.ndarray, frames: np.ndarray, curves: np.ndarray, slopes: np.ndarray) -> None:
    """Give an object shape keys, of differences [R, V, 3] from its mesh, each driven by a curve [S, R] over the capture's frames [S]."""
    if not len(shapes):
        return
    rest, spans = arrays.points(obj.data), np.diff(frames)[:, None] / 3
    steps = np.zeros((2, len(frames), 2, curves.shape[1]))  # of the handles, left and right: along and up
    steps[0, 1:] = -np.stack([np.broadcast_to(spans, slopes[1:].shape), spans * slopes[1:]], 1)
    steps[1, :-1] = np.stack([np.broadcast_to(spans, slopes[:-1].shape), spans * slopes[:-1]], 1)
    at = np.stack([np.broadcast_to(frames[:, None], curves.shape), curves], 1)
    obj.shape_key_add(name="Basis", from_mix=False)
    for r, shape in enumerate(shapes):
        key = obj.shape_key_add(name=f"Motion {r + 1}", from_mix=False)
        key.slider_min, key.slider_max = -2.0, 2.0
        key.data.foreach_set("co", (rest + shape).astype(np.float32).ravel())
        points = _driver(key, "value", obj).keyframe_points
        points.add(len(frames))
        for name, values in (("co", at), ("handle_left", at + steps[0]), ("handle_right", at + steps[1])):
            points.foreach_set(name, np.ascontiguousarray(values[..., r], np.float32).ravel())
        for point in points:
            point.interpolation, point.handle_left_type, point.handle_right_type = 'BEZIER', 'FREE', 'FREE'
        for name, values in (("handle_left", at + steps[0]), ("handle_right", at + steps[1])):  # the types have moved them
            points.foreach_set(name, np.ascontiguousarray(values[..., r], np.float32).ravel())


def _driver(owner, path: str, obj, expression: str = ""):
    """The curve of a new driver of a property: of the object's capture frame itself, or of an expression of it, f."""
    curve = owner.driver_add(path)
    curve.keyframe_points.clear()  # it begins as a straight line, in one way or another
    for modifier in list(curve.modifiers):
        curve.modifiers.remove(modifier)
    driver = curve.driver
    driver.type = 'SCRIPTED' if expression else 'SUM'
    variable = driver.variables.new()
    variable.name = "f"
    variable.targets[0].id, variable.targets[0].data_path = obj, PATH
    if expression:
        driver.expression = expression
    return curve

# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the inputs of camera moves: the scene's camera, its subject, and the cameras that filmed the capture."""
import bpy
import numpy as np
from mathutils import Vector

from ...fastgs_blender.model.framing import is_subject
from ...fastgs_blender.util.rotations import transformed
from .. import arrays, model_space, objects
from ..splats.proxy_nodes import GAUSSIAN
from .placing import new_camera

USUAL_LENS, USUAL_SENSOR = 50.0, 36.0


def target_camera(context, make: bool) -> bpy.types.Object | None:
    """The scene's camera; with `make`, a new one takes its place."""
    scene = context.scene
    if scene.camera and scene.camera.type == 'CAMERA' and not make:
        return scene.camera
    if not make:
        return None
    camera = new_camera("Camera Move", scene.collection)
    if scene.camera and scene.camera.type == 'CAMERA':
        camera.data.lens, camera.data.sensor_width = scene.camera.data.lens, scene.camera.data.sensor_width
    camera.rotation_mode = 'QUATERNION'
    scene.camera = camera
    return camera


def subject_of(context) -> tuple[Vector, float]:
    """Middle and radius of the subject of a move: the selected splats, else the active object, else the 3D cursor."""
    chosen = [o for o in context.selected_objects if objects.is_splat(o)]
    chosen = chosen or [o for o in [context.object] if o is not None and o.type != 'CAMERA']
    chosen = chosen or [o for o in context.scene.objects if objects.is_splat(o)]
    return middle_and_radius(chosen) if chosen else (context.scene.cursor.location.copy(), 2.0)


def middle_and_radius(chosen: list[bpy.types.Object]) -> tuple[Vector, float]:
    """Middle and radius of objects; of splats, strays and a far background do not count."""
    if all(objects.is_splat(o) and o.type == 'MESH' and len(o.data.vertices) for o in chosen):
        return _most_of(chosen)
    corners = [o.matrix_world @ Vector(c) for o in chosen for c in o.bound_box]
    low, high = (Vector(f(c[i] for c in corners) for i in range(3)) for f in (min, max))
    return (low + high) / 2, max((high - low).length / 2, 1e-3)


def _most_of(splats) -> tuple[Vector, float]:
    """Middle and radius of most of the splats; a few strays, a far background and the room around them do not count."""
    points = np.concatenate([transformed(arrays.points(obj.data)[_in_box(obj.data)], np.array(obj.matrix_world)) for obj in splats])
    near = points[is_subject(points)]
    low, high = near.min(0), near.max(0)
    return Vector((low + high) / 2), max(float(np.linalg.norm(high - low)) / 2, 1e-3)


def _in_box(mesh) -> np.ndarray:
    """Which vertices of a proxy lie in the box around its subject, which four of them are corners of: [V] bool."""
    points, index = _values(mesh, model_space.PLACE, "vector", np.float32, 3), _values(mesh, GAUSSIAN, "value", np.int32)
    corners = points[index < 0] if points is not None and index is not None else ()
    return ((points >= corners.min(0)) & (points <= corners.max(0))).all(1) if len(corners) else np.ones(len(mesh.vertices), bool)


def size_of(obj) -> Vector:
    """Width, depth and height of a splat object's subject, along the object's axes and scaled as in the world; zeros where unknown."""
    index = _values(obj.data, GAUSSIAN, "value", np.int32) if obj.type == 'MESH' else None
    if index is None or not (index < 0).any():
        return Vector()
    return Vector(np.ptp(arrays.points(obj.data)[index < 0], 0) * np.linalg.norm(np.array(obj.matrix_world)[:3, :3], axis=0))


def _values(mesh, name: str, key: str, dtype, width: int = 1) -> np.ndarray | None:
    """An attribute of a mesh's vertices, [V] or [V, width]; None where it has none, and in Edit Mode, which keeps them elsewhere."""
    attribute = mesh.attributes.get(name)
    return None if attribute is None or len(attribute.data) != len(mesh.vertices) else arrays.read(attribute.data, key, dtype, width)


def far_enough(scene, size: float) -> float:
    """The distance from which a camera with Blender's usual lens has nearly all of a subject of that radius in its picture."""
    render = scene.render
    sides = render.resolution_x * render.pixel_aspect_x, render.resolution_y * render.pixel_aspect_y
    half = np.arctan(USUAL_SENSOR / 2 / USUAL_LENS * min(sides) / max(sides))
    return 0.9 * size / float(np.sin(half))


def capture_cameras(scene) -> list[bpy.types.Object]:
    """The cameras of captures that were imported into the scene."""
    return [o for o in scene.objects if o.type == 'CAMERA' and o.data.fastgs.view]

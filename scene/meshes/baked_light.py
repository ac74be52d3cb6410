# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes light and shadow: Cycles measures the diffuse light that falls on each Gaussian of a baked surface.

A small triangle stands for each Gaussian, just above the surface, in a temporary scene with the user's objects; Cycles
bakes their light into the triangles' corners.  So light does not depend on how finely the objects are meshed, and
textures keep their detail.  The user's scene is not touched.
"""
import contextlib

import bpy
import numpy as np

from ...fastgs_blender.rendering.colour import linear_to_srgb, srgb_to_linear
from ...fastgs_blender.surfaces.sampling import SurfaceSamples, neighbours, triangle_normals
from ...fastgs_blender.util.errors import FastGSError
from .. import arrays
from ..frame_range import go_to
from ..objects import is_splat
from .surface import Recorder

NAME = "FAST-GS light"
LIFT = 0.05
"""Distance of the triangles from the surface, by the distance of neighbouring Gaussians, and their size."""
BOUNCES = 3
"""Reflections of light that Cycles follows; later ones hardly add any."""
BLACK = 0.02
"""Less light than this comes from inside."""
REACH = 2.5
"""Radius within which light is averaged, by the distance of neighbours: it takes away Cycles' noise."""


def apply(context, recorder: Recorder, times: list[float], colours: np.ndarray, samples: SurfaceSamples, light_samples: int,
          light_frames: int):
    """A generator that yields the share done and returns colours [N, 4] (sRGB and opacity) as the scene's light shows them.

    A colour cannot change in time, so that it gets the mean light of `light_frames` of the recorded times, which share the
    samples.  Where both sides may be seen, the lighter one counts.  Raises FastGSError where Cycles
    is absent.
    """
    triangles = recorder.triangles()[samples.triangle]
    local = _to_local(_corners(recorder, 0, triangles), recorder.normals(samples))
    both = None
    chosen = np.unique(np.linspace(0, len(times) - 1, light_frames + 2).round()[1:-1].astype(int))
    light = np.zeros((len(samples), 3))
    for number, index in enumerate(chosen):
        yield number / len(chosen)
        go_to(context.scene, times[index])
        corners = _corners(recorder, index, triangles)
        points = np.einsum("nkd,nk->nd", corners, samples.weights)
        normals = np.einsum("nak,na->nk", _frames(corners), local)
        seen = _measure(context, points, normals, samples.spacing, light_samples / len(chosen))
        if both is None:  # a closed surface that is black outside may be one that was turned inside out
            both = np.flatnonzero(recorder.open()[samples.triangle] | (seen.max(1) < BLACK))
        if len(both):
            behind = _measure(context, points[both], -normals[both], samples.spacing, light_samples / len(chosen))
            seen[both] = np.maximum(seen[both], behind)
        light += seen / len(chosen)
    light = _smooth(light, points, normals, samples.spacing)
    return np.c_[linear_to_srgb(np.clip(srgb_to_linear(colours[:, :3]) * light, 0, 1)), colours[:, 3]]


def _corners(recorder, index, triangles):
    return recorder.positions[index][triangles].astype(np.float64)


def _frames(corners) -> np.ndarray:
    """Axes [N, 3, 3] of triangles: along an edge, across it, the normal."""
    z = triangle_normals(corners)
    x = corners[:, 1] - corners[:, 0]
    x, z = (v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-30) for v in (x, z))
    return np.stack([x, np.cross(z, x), z], 1)


def _to_local(corners, normals) -> np.ndarray:
    """Shading normals in the axes of their triangles, in which they stay while these move."""
    return np.einsum("nak,nk->na", _frames(corners), normals)


def _smooth(light, points, normals, spacing):
    """The mean over neighbours that face the same way, twice."""
    i, j, weight = neighbours(points, normals, np.ones(len(points)), REACH * spacing)
    weight = np.sqrt(weight) * np.clip(np.einsum("nd,nd->n", normals[i], normals[j]), 0, 1) ** 8
    total = 1 + np.bincount(i, weight, len(points)) + np.bincount(j, weight, len(points))
    for _ in range(2):
        around = [np.bincount(i, weight * c[j], len(points)) + np.bincount(j, weight * c[i], len(points)) for c in light.T]
        light = (light + np.stack(around, 1)) / total[:, None]
    return light


def _measure(context, points, normals, spacing, light_samples) -> np.ndarray:
    """Linear light [M, 3] on white paper at points [M, 3] that face along normals [M, 3]."""
    with contextlib.ExitStack() as stack:
        mesh = bpy.data.meshes.new(NAME)
        stack.callback(bpy.data.meshes.remove, mesh)
        material = bpy.data.materials.new(NAME)
        stack.callback(bpy.data.materials.remove, material)
        scene = bpy.data.scenes.new(NAME)
        stack.callback(bpy.data.scenes.remove, scene)
        _fill(mesh, points, normals, LIFT * spacing)
        mesh.materials.append(material)
        obj = bpy.data.objects.new(NAME, mesh)  # goes with its mesh
        for ray in ("diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
            setattr(obj, f"visible_{ray}", False)
        _furnish(scene, context.scene, light_samples)
        scene.collection.objects.link(obj)
        layer = scene.view_layers[0]
        obj.select_set(True, view_layer=layer)
        layer.objects.active = obj
        with context.temp_override(scene=scene, view_layer=layer, active_object=obj, object=obj, selected_objects=[obj]):
            try:
                bpy.ops.object.bake(type='DIFFUSE', pass_filter={'DIRECT', 'INDIRECT'}, target='VERTEX_COLORS', use_clear=True, margin=0)
            except RuntimeError as error:
                raise FastGSError(f"Cycles could not bake the light ({error}); bake without lighting.") from error
        values = arrays.read(mesh.color_attributes[NAME].data, "color", np.float32, 4)
    return values.reshape(-1, 3, 4)[..., :3].mean(1, dtype=np.float64)


def _fill(mesh, points, normals, size):
    """One small triangle for each point, lifted off the surface."""
    x = np.cross(normals, np.where(np.abs(normals[:, 2:]) < 0.9, [0, 0, 1.0], [1.0, 0, 0]))
    x /= np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12)
    y = np.cross(normals, x)
    angles = np.arange(3) * 2 * np.pi / 3
    vertices = (points + size * normals)[:, None] + size * (np.cos(angles)[:, None] * x[:, None] + np.sin(angles)[:, None] * y[:, None])
    arrays.fill(mesh, vertices.reshape(-1, 3), np.arange(3 * len(points)).reshape(-1, 3))
    mesh.update()
    mesh.color_attributes.active_color = mesh.color_attributes.new(NAME, 'FLOAT_COLOR', 'CORNER')


def _furnish(scene, original, light_samples):
    """The original's light: its objects (without splats, whose proxies cast no shadow), its world, its frame."""
    try:
        scene.render.engine = 'CYCLES'
    except TypeError as error:
        raise FastGSError("the light cannot be baked: Cycles is not enabled; enable its add-on, or bake without lighting.") from error
    for obj in original.objects:
        if not is_splat(obj) and not obj.hide_render and any(not c.hide_render for c in obj.users_collection):
            scene.collection.objects.link(obj)
    scene.world = original.world
    scene.frame_set(original.frame_current, subframe=original.frame_subframe)
    scene.cycles.device = 'CPU'
    scene.cycles.max_bounces = scene.cycles.diffuse_bounces = BOUNCES
    scene.cycles.samples = max(round(light_samples / 3), 1)  # a triangle has three corners
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False

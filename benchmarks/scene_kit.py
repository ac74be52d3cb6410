# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender scenes made of numbers alone: shapes, shape keys, painted materials, keyframes."""
from __future__ import annotations

from math import pi

import bpy
import numpy as np

# Shapes: vertices [V, 3], faces, uv [V, 2]


def grid(columns, rows, wrap=False):
    """u, v of a grid's vertices and its faces; with wrap the last column meets the first at another u."""
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    i = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    faces = np.stack([i, i + 1, i + columns + 2, i + columns + 1], 1)
    return u.ravel(), v.ravel(), faces


def ball(radius, centre=(0, 0, 0), segments=32, rings=16, stretch=(1, 1, 1)):
    u, v, faces = grid(segments, rings)
    a, b = 2 * pi * u, pi * (v - 0.5)
    points = np.stack([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)], 1) * radius * np.array(stretch)
    return points + centre, faces, np.stack([u, v], 1)


def tube(path, radius, segments=12):
    """A closed tube around points [P, 3]."""
    along = np.gradient(path, axis=0)[np.r_[0, np.arange(len(path)), len(path) - 1]]
    path = np.concatenate([path[:1], path, path[-1:]])
    rows = len(path) - 1
    radius = np.where(np.isin(np.arange(rows + 1), (0, rows)), 0, radius)
    u, v, faces = grid(segments, rows)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.cross(along, (0, 1, 0.01))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(along, side)
    row = np.round(v * rows).astype(int)
    a = 2 * pi * u[:, None]
    return path[row] + radius[row, None] * (np.cos(a) * side[row] + np.sin(a) * up[row]), faces, np.stack([u, v], 1)


def new_object(name, parts, materials, location=(0, 0, 0)):
    """An object of parts (points, faces, uv, material number), smooth."""
    points = np.concatenate([p[0] for p in parts])
    starts = np.cumsum([0] + [len(p[0]) for p in parts])
    faces = np.concatenate([p[1] + start for p, start in zip(parts, starts, strict=False)])
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points.tolist(), [], faces.tolist())
    uv = np.concatenate([p[2] for p in parts])
    loops = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", loops)
    mesh.uv_layers.new().uv.foreach_set("vector", uv[loops].astype(np.float32).ravel())
    for material in materials:
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", np.repeat([p[3] for p in parts], [len(p[1]) for p in parts]).astype(np.int32))
    mesh.polygons.foreach_set("use_smooth", np.ones(len(mesh.polygons), bool))
    mesh.update()
    obj = bpy.data.objects.new(name, mesh)
    obj.location = location
    bpy.context.scene.collection.objects.link(obj)
    return obj


def shape(obj, name, points, values):
    """A shape key with a value for each frame."""
    if obj.data.shape_keys is None:
        obj.shape_key_add(name="Basis")
    key = obj.shape_key_add(name=name)
    key.data.foreach_set("co", np.asarray(points, np.float32).ravel())
    key.slider_min, key.slider_max = -10, 10
    for frame, value in enumerate(values, 1):
        key.value = value
        key.keyframe_insert("value", frame=frame)


def animate(obj, path, values, index=-1):
    """Keyframes of a property on every frame."""
    for frame, value in enumerate(values, 1):
        if index < 0:
            setattr(obj, path, value)
        else:
            getattr(obj, path)[index] = value
        obj.keyframe_insert(path, index=index, frame=frame)


def cached(obj, points) -> None:
    """Let a mesh take these points [frames][V, 3] frame by frame, as absolute shape keys."""
    obj.shape_key_add(name="Basis")
    for k, moment in enumerate(points):
        obj.shape_key_add(name=f"Frame {k + 1}").data.foreach_set("co", np.asarray(moment, np.float32).ravel())
    keys = obj.data.shape_keys
    keys.use_relative = False
    for block in keys.key_blocks:
        block.interpolation = 'KEY_LINEAR'
    for frame in (1, len(points)):
        keys.eval_time = keys.key_blocks[frame].frame
        keys.keyframe_insert("eval_time", frame=frame)
    straight(keys)


def straight(data) -> None:
    """Straight lines between the keyframes of `data`, and beyond them."""
    action = data.animation_data.action
    curves = action.fcurves if hasattr(action, "fcurves") else action.layers[0].strips[0].channelbags[0].fcurves
    for curve in curves:
        curve.extrapolation = 'LINEAR'
        for key in curve.keyframe_points:
            key.interpolation = 'LINEAR'


# Colours: sRGB 0..1


def srgb(code):
    return np.array([int(code[i:i + 2], 16) / 255 for i in (1, 3, 5)])


def material(name, colour):
    """A material of one colour (sRGB hex) or an image [h, w, 3] in sRGB, the bottom row first."""
    made = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0, 0):
        made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"]
    shader.inputs["Roughness"].default_value = 0.8
    if isinstance(colour, str):
        value = srgb(colour)
        linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
        shader.inputs["Base Color"].default_value = made.diffuse_color = (*linear, 1)
        return made
    height, width = colour.shape[:2]
    image = bpy.data.images.new(name, width, height)
    image.pixels.foreach_set(np.dstack([colour, np.ones((height, width))]).astype(np.float32).ravel())
    image.pack()
    node = made.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    made.node_tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    return made


def canvas(width, height):
    """Pixel centres u, v in 0..1 of an image."""
    return np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)


def gradient(share, codes):
    """Colours [..., 3] of a smooth ramp."""
    stops = np.linspace(0, 1, len(codes))
    return np.stack([np.interp(share, stops, column) for column in np.array([srgb(c) for c in codes]).T], -1)


def paint(image, mask, code, soft=None):
    """Lay a colour over an image where mask (0..1) says."""
    image += np.clip(mask, 0, 1)[..., None] * (srgb(code) - image)


def noise(width, height, cells, rng) -> np.ndarray:
    """Smooth noise [height, width] with that many square cells across, mean 0, standard deviation about 1."""
    from PIL import Image

    grid = rng.normal(0, 1, (max(cells * height // width, 1) + 3, cells + 3)).astype(np.float32)
    return np.asarray(Image.fromarray(grid).resize((width, height), Image.Resampling.BICUBIC))


def edge(distance, width):
    """1 inside (distance < 0), 0 outside, with a soft edge."""
    return np.clip(0.5 - distance / width, 0, 1)


def set_world(scene, colour, strength):
    """One colour (scene linear) all around."""
    if bpy.app.version < (5, 0, 0):
        scene.world.use_nodes = True
    node = scene.world.node_tree.nodes["Background"]
    node.inputs["Color"].default_value = (*colour, 1)
    node.inputs["Strength"].default_value = strength

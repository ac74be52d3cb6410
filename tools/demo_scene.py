# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo's scene, made of numbers alone: a jelly that dances, a twisting tower, a flag in the wind, planets, a stage."""
from __future__ import annotations

from math import cos, pi, radians, sin

import bpy
import numpy as np

FRAMES, FPS = 72, 24
TOWER = (1.75, 0.55)
SPOTS = ((.06, .62, .035), (.17, .47, .05), (.30, .66, .04), (.42, .52, .055), (.47, .73, .03), (.55, .60, .05), (.70, .84, .03),
         (.81, .80, .04), (.76, .92, .025), (.93, .5, .04), (.99, .7, .03), (.11, .78, .028), (.35, .82, .03), (.22, .3, .045),
         (.38, .32, .04), (.52, .35, .045), (.02, .36, .04), (.93, .28, .035))
"""On the jelly's skin: u, v, radius."""


def build():
    """Make the scene in an empty file; returns the moving objects and the still ones."""
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end, scene.render.fps = 1, FRAMES, FPS
    moving = [jelly(), tower(), *flag(), *planets()]
    still = stage()
    light(scene)
    return moving, still


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


def phase(turns=1.0, offset=0.0):
    """An angle for each frame, `turns` rounds in the loop."""
    return 2 * pi * (turns * np.arange(FRAMES) / FRAMES + offset)


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


def edge(distance, width):
    """1 inside (distance < 0), 0 outside, with a soft edge."""
    return np.clip(0.5 - distance / width, 0, 1)


# The cast


def jelly():
    """Body, eyes, feet and antennae in one mesh, moved by shape keys, hopping three times in the loop."""
    u, v = canvas(1024, 512)
    skin = gradient(v, ["#6a1b9a", "#d81b60", "#ff5252", "#ff8a3d", "#ffc14d"])
    for k, (a, b, r) in enumerate(SPOTS):
        du = np.abs((u - a + 0.5) % 1 - 0.5) * np.cos(pi * (v - 0.5)) * 2
        paint(skin, 0.85 * edge(np.hypot(du, v - b) - r, 0.006), "#ffe082" if k % 2 else "#ff4081")
    body = ball(0.78, (0, 0, 0.86), 96, 64, (1, 1, 1.05))
    body[0][:, 2] = np.where(body[0][:, 2] < 0.45, 0.45 + 0.45 * (body[0][:, 2] - 0.45), body[0][:, 2])
    parts = [(*body, 0)]
    for side in (-1, 1):
        parts.append((*ball(0.235, (0.3 * side, -0.6, 1.12)), 1))
        parts.append((*ball(0.125, (0.29 * side, -0.745, 1.12)), 2))
        parts.append((*ball(0.042, (0.29 * side + 0.05, -0.845, 1.17), 16, 8), 1))
        parts.append((*ball(0.24, (0.4 * side, -0.22, 0.17), stretch=(1, 1.35, 0.7)), 3))
        s = np.linspace(0, 1, 14)[:, None]
        path = np.array([0.22 * side, 0.05, 1.6]) + s * np.array([0.18 * side, 0, 0.55]) + s**2 * np.array([0.2 * side, 0, -0.1])
        parts.append((*tube(path, 0.035), 3))
        parts.append((*ball(0.105, path[-1]), 4))
    arc = np.linspace(-1, 1, 24)
    smile = np.stack([0.2 * arc, -0.775 + 0.05 * arc**2, 0.80 + 0.07 * arc**2], 1)
    parts.append((*tube(smile, 0.026, 10), 2))
    obj = new_object("Jelly", parts, [material("Skin", skin), material("White", "#fffdf7"), material("Dark", "#2a1036"),
                                      material("Boots", "#4527a0"), material("Glow", "#ffe14d")], (-0.3, -0.75, 0.02))
    rest = np.array([v.co for v in obj.data.vertices])
    x, y, z = rest.T
    hop, sway = phase(3), phase(1)
    height = np.maximum(np.sin(hop), 0)
    squash = np.clip(-np.sin(hop), 0, 1) ** 1.5
    wide = 1 + 0.24 * (1 - np.abs(z - 0.6) / 1.6)
    shape(obj, "Squash", np.stack([x * wide, y * wide, z * 0.66], 1), squash)
    shape(obj, "Stretch", np.stack([x * 0.9, y * 0.9, z * 1.16], 1), height**1.2)
    shape(obj, "Sway", np.stack([x + 0.3 * (z / 1.6) ** 2, y, z], 1), np.sin(sway))
    above = np.maximum(z - 1.62, 0)
    shape(obj, "Whip", np.stack([x, y + 0.9 * above**1.5, z - 0.35 * above], 1), np.cos(hop) + 0.5 * np.sin(2 * hop))
    animate(obj, "location", 0.02 + 0.5 * height, 2)
    animate(obj, "rotation_euler", radians(14) + radians(24) * np.sin(phase(1, 0.1)), 2)
    return obj


def tower():
    """A square column of coloured bands, twisted to and fro."""
    u, v, faces = grid(64, 120)
    a = 2 * pi * u
    corner = np.maximum(np.abs(np.cos(a)), np.abs(np.sin(a)))
    bulge = 0.5 / (0.75 * corner + 0.25) * (1 + 0.10 * np.sin(2 * pi * 3 * v)) * ((v > 0) & (v < 1))
    points = np.stack([bulge * np.cos(a), bulge * np.sin(a), 2.5 * v], 1)
    s, t = canvas(256, 1024)
    image = gradient((t * 0.999), ["#1de9b6", "#00b8d4", "#2979ff", "#7c4dff", "#e040fb", "#ff4081"])
    paint(image, 0.8 * edge(np.abs((t * 9 + 0.5 * s * 4) % 1 - 0.5) - 0.13, 0.03), "#fff8e1")
    lid = ball(0.47, (0, 0, 2.46), 32, 16, (1, 1, 0.5))
    obj = new_object("Tower", [(points, faces, np.stack([u, v], 1), 0), (*lid, 1), (*ball(0.2, (0, 0, 2.8)), 2)],
                     [material("Bands", image), material("Lid", "#ffd740"), material("Ball", "#ff5252")], (*TOWER, 0.02))
    twist = obj.modifiers.new("Twist", 'SIMPLE_DEFORM')
    twist.deform_method, twist.deform_axis = 'TWIST', 'Z'
    for frame, value in enumerate(radians(110) * np.sin(phase()), 1):
        twist.angle = value
        twist.keyframe_insert("angle", frame=frame)
    return obj


def flag():
    """A cloth in which two waves travel: sine and cosine as two shape keys."""
    u, v, faces = grid(90, 54)
    s, t = canvas(960, 576)
    image = np.full((*s.shape, 3), 1.0) * srgb("#00838f")
    paint(image, edge(np.abs(t - 0.5) - 0.17 - 0.045 * np.sin(2 * pi * 2 * s), 0.006), "#fff3d6")
    x, y = (s - 0.36) * 1.667, t - 0.5
    angle, radius = np.arctan2(y, x), np.hypot(x, y)
    paint(image, edge(radius - 0.25 - 0.05 * np.cos(12 * angle), 0.006), "#ff6f00")
    paint(image, edge(radius - 0.165, 0.006), "#ffd54f")
    for k in range(3):
        paint(image, edge(np.hypot((s - 0.72 - 0.09 * k) * 1.667, t - 0.5 + 0.03 * (k % 2)) - 0.035, 0.005), "#d81b60")
    points = np.stack([1.75 * u, np.zeros_like(u), 1.05 * v], 1)
    cloth = new_object("Flag", [(points, faces, np.stack([u, v], 1), 0)], [material("Cloth", image)], (-2.3, 0.75, 1.78))
    amount, bend = 0.2 * u**0.8, -0.12 * u**2
    for name, wave, values in (("Wave A", np.sin, np.cos(phase(2))), ("Wave B", np.cos, -np.sin(phase(2)))):
        angle = 2 * pi * 1.35 * u + 0.7 * v
        y = amount * wave(angle)
        x = 1.75 * u - 0.05 * u * wave(2 * angle)
        shape(cloth, name, np.stack([x, y, points[:, 2] + 0.3 * bend * np.abs(wave(angle))], 1), values)
    cloth.rotation_euler[2] = radians(-14)
    s = np.linspace(0, 1, 30)[:, None]
    pole = new_object("Pole", [(*tube(s * np.array([0, 0, 2.95]), 0.05, 20), 0), (*ball(0.11, (0, 0, 2.98)), 1)],
                      [material("Pole", "#eceff1"), material("Gold", "#ffc107")], (-2.35, 0.75, 0))
    return [cloth, pole]


def planets():
    """Eight balls that go round the tower once in the loop, bobbing."""
    made = []
    codes = ["#ff5252", "#ff9100", "#ffd740", "#69f0ae", "#18ffff", "#448aff", "#b388ff", "#ff80ab"]
    for k, code in enumerate(codes):
        s, t = canvas(128, 64)
        image = np.full((*s.shape, 3), 1.0) * srgb(code)
        paint(image, edge(np.abs(t - 0.5) - 0.09, 0.03), "#ffffff")
        obj = new_object(f"Planet {k + 1}", [(*ball(0.155), 0)], [material(f"Planet {k + 1}", image)])
        angle = phase(1, k / len(codes))
        path = np.stack([TOWER[0] + 1.0 * np.cos(angle), TOWER[1] + 1.0 * np.sin(angle), 1.4 + 0.42 * np.sin(2 * angle + 0.6)], 1)
        animate(obj, "location", [tuple(p) for p in path])
        animate(obj, "rotation_euler", [(0.5, 0, 2 * x) for x in angle])
        made.append(obj)
    return made


def stage():
    """A round floor with rings of tiles."""
    u, v, faces = grid(160, 40)
    a, radius = 2 * pi * u, 3.25 * np.minimum(v / 0.92, 1)
    depth = np.where(v > 0.92, -(v - 0.92) / 0.08 * 0.3, 0)
    points = np.stack([radius * np.cos(a), radius * np.sin(a), depth], 1)
    x, y = canvas(1024, 1024)
    x, y = 7 * (x - 0.5), 7 * (y - 0.5)
    r, angle = np.hypot(x, y), np.arctan2(y, x) / (2 * pi)
    image = np.full((*x.shape, 3), 1.0) * srgb("#f4e8d0")
    for k, code in enumerate(["#f2b880", "#8fb8b0", "#7fa3b8", "#8fb8b0", "#7fa3b8", "#8fb8b0"]):
        ring, count = edge(np.abs(r - (0.3 + 0.5 * k)) - 0.25, 0.012), 4 + 4 * k
        tile = np.abs((angle * count + 0.25 * (k % 2)) % 1 - 0.5) - 0.25
        paint(image, ring * edge(tile * 2 * pi * np.maximum(r, 0.05) / count, 0.012), code)
    paint(image, edge(2.95 - r, 0.012), "#e2725b")
    uv = np.stack([points[:, 0] / 7 + 0.5, points[:, 1] / 7 + 0.5], 1)
    return [new_object("Stage", [(points, faces, uv, 0)], [material("Tiles", image)])]


# Light and camera


def light(scene):
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", 'SUN'))
    sun.data.energy, sun.data.angle, sun.data.color = 2.6, radians(14), (1.0, 0.93, 0.82)
    sun.rotation_euler = (radians(38), radians(-14), radians(-32))
    scene.collection.objects.link(sun)
    scene.world = bpy.data.worlds.new("World")
    set_world(scene, (0.62, 0.72, 0.95), 0.62)


def set_world(scene, colour, strength):
    """One colour (scene linear) all around."""
    if bpy.app.version < (5, 0, 0):
        scene.world.use_nodes = True
    node = scene.world.node_tree.nodes["Background"]
    node.inputs["Color"].default_value = (*colour, 1)
    node.inputs["Strength"].default_value = strength


def camera(scene):
    """A camera that swings around the stage once to and fro in the loop."""
    from mathutils import Vector

    made = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(made)
    scene.camera = made
    made.data.lens = 42
    target = Vector((-0.1, 0.0, 1.25))
    for frame, angle in enumerate(phase(), 1):
        turn = radians(-90 + 24 * sin(angle))
        made.location = target + Vector((8.6 * cos(turn), 8.6 * sin(turn), 1.9 + 0.5 * cos(angle)))
        made.rotation_euler = (target - made.location).to_track_quat('-Z', 'Y').to_euler()
        made.keyframe_insert("location", frame=frame)
        made.keyframe_insert("rotation_euler", frame=frame)
    return made

# SPDX-License-Identifier: GPL-3.0-or-later
"""What make_capture.py films: a file's animation, or a small scene of fast things; and the stage for whatever has no light."""
from __future__ import annotations

from math import pi, radians
from pathlib import Path

import bpy
import numpy as np
import scene_kit as kit

PALETTE = ("#e4572e", "#f3a712", "#a8c686", "#669bbc", "#29335c", "#b56576", "#e8d7c3", "#3c887e")


def open_file(path: Path, action: str | None) -> None:
    """A .blend or .glb, its rigs doing the action, in a scene that begins and ends with it."""
    if path.suffix.lower() == ".blend":
        bpy.ops.wm.open_mainfile(filepath=str(path))
    else:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.import_scene.gltf(filepath=str(path))
    scene = bpy.context.scene
    if action:
        if action not in bpy.data.actions:
            raise SystemExit(f"{path} has no action {action!r}, only {', '.join(sorted(a.name for a in bpy.data.actions))}.")
        chosen = bpy.data.actions[action]
        for obj in [o for o in scene.objects if o.type == 'ARMATURE'] or list(scene.objects):
            obj.animation_data_create().action = chosen
        scene.frame_start, scene.frame_end = (round(x) for x in chosen.frame_range)


def moving_meshes(times: np.ndarray) -> list:
    """The visible meshes whose surface moves in that scene time; all of them where none does."""
    scene = bpy.context.scene
    meshes = [o for o in scene.objects if o.type == 'MESH' and not o.hide_render]
    paths = []
    for time in times[:: max(1, len(times) // 8)]:
        go_to(time)
        paths.append([outline(o)[:: max(1, len(o.data.vertices) // 50)] for o in meshes])
    moving = [any(np.abs(later[k] - paths[0][k]).max() > 1e-4 for later in paths[1:]) for k in range(len(meshes))]
    return [o for o, moves in zip(meshes, moving) if moves] or meshes


def with_companions(objects) -> list:
    """The objects and every mesh that hangs on the same parent: the feet on which a dancer stands are part of the dancer."""
    def top(obj):
        return top(obj.parent) if obj.parent else obj

    tops = {top(o) for o in objects}
    return [o for o in bpy.context.scene.objects if o.type == 'MESH' and not o.hide_render and top(o) in tops]


def go_to(time: float) -> None:
    bpy.context.scene.frame_set(int(time // 1), subframe=float(time % 1))


def outline(obj) -> np.ndarray:
    """World places [V, 3] of an object's vertices now, with armatures and shape keys."""
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    points = np.empty(3 * len(evaluated.data.vertices), np.float32)
    evaluated.data.vertices.foreach_get("co", points)
    matrix = np.array(evaluated.matrix_world)
    return points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]


def extent(objects, times) -> tuple[np.ndarray, float, float]:
    """Centre [3], radius and lowest height of what the objects sweep in that time."""
    clouds = []
    for time in times[:: max(1, len(times) // 20)]:
        go_to(time)
        clouds += [outline(o) for o in objects]
    points = np.concatenate(clouds)
    centre = (points.min(0) + points.max(0)) / 2
    return centre, float(np.linalg.norm(points - centre, axis=1).max()), float(points[:, 2].min())


STAGE = 1.3
"""Radius of the stage in those of the subject."""

# A stage with a textured floor, in a softly coloured studio, sun and sky


def stage(centre, radius: float, floor: float, reach: float) -> None:
    """Around a subject: a round stage under its feet that every camera sees, in a studio of smooth colours at `reach`, beyond them all."""
    rng = np.random.default_rng(7)
    edge, thick = STAGE * radius, 0.1 * radius
    place = (centre[0], centre[1], floor)
    u, v, faces = kit.grid(96, 1)
    top = np.stack([edge * v * np.cos(2 * pi * u), edge * v * np.sin(2 * pi * u), np.zeros_like(u)], 1)
    side = np.stack([edge * np.cos(2 * pi * u), edge * np.sin(2 * pi * u), -thick * (1 - v)], 1)
    tiles, rim = kit.material("Stage", floor_image(radius, edge, rng)), kit.material("Rim", "#5f584e")
    kit.new_object("Stage", [(top, faces, top[:, :2] / (2 * edge) + 0.5, 0), (side, faces, np.stack([u, v], 1), 1)], [tiles, rim], place)

    size = 512
    x, y = kit.canvas(2 * size, size)
    tint = 0.5 + 0.09 * np.sin(2 * pi * (2 * x + 0.3)) * np.sin(2 * pi * (1.5 * y + 0.1)) + 0.07 * np.cos(2 * pi * (3 * x + y))
    walls = kit.gradient(np.clip(y * 0.8 + 0.35 * (tint - 0.5), 0, 1), ["#8c8271", "#b9b09c", "#a9bcc6", "#7f9fb8", "#5c7fa3"])
    points, faces, uv = kit.ball(reach, (0, 0, 0), 64, 32)
    dome = kit.new_object("Studio", [(points, faces, uv, 0)], [kit.material("Studio", walls)], place)
    shine(dome.data.materials[0], 1.0)
    dome.visible_diffuse = dome.visible_glossy = dome.visible_shadow = False
    light()


def floor_image(radius, edge, rng) -> np.ndarray:
    """Tiles of many colours with grain: sRGB [2048, 2048, 3] for 2 edge x 2 edge."""
    size = 2048
    x, y = (2 * edge * (a - 0.5) for a in kit.canvas(size, size))
    tile = radius / 2.2
    column, row = np.floor(x / tile).astype(int), np.floor(y / tile).astype(int)
    colours = np.array([kit.srgb(code) for code in PALETTE])
    pick = rng.integers(0, len(colours), (256, 256))[column % 256, row % 256]
    image = 0.4 * colours[pick] + 0.6 * kit.srgb("#c2b59d")
    image *= 1 - 0.12 * ((column + row) % 2)[..., None]
    seam = np.minimum(np.abs((x / tile + 0.5) % 1 - 0.5), np.abs((y / tile + 0.5) % 1 - 0.5)) * tile
    kit.paint(image, 0.7 * kit.edge(seam - 0.015 * tile, 0.03 * tile), "#6b6356")
    cells = edge / radius * np.array([11, 32])
    image += (0.04 * kit.noise(size, size, int(cells[0]), rng) + 0.03 * kit.noise(size, size, int(cells[1]), rng))[..., None]
    return np.clip(image, 0, 1)


def shine(material, strength: float):
    """Let a material give light of its own colour; returns the socket of the strength."""
    shader = material.node_tree.nodes["Principled BSDF"]
    base, glow = shader.inputs["Base Color"], shader.inputs["Emission Color"]
    if base.is_linked:
        material.node_tree.links.new(base.links[0].from_socket, glow)
        material.node_tree.links.remove(base.links[0])
    else:
        glow.default_value = base.default_value
    base.default_value = (0, 0, 0, 1)
    shader.inputs["Specular IOR Level"].default_value = 0
    shader.inputs["Emission Strength"].default_value = strength
    return shader.inputs["Emission Strength"]


def light():
    scene = bpy.context.scene
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", 'SUN'))
    sun.data.energy, sun.data.angle, sun.data.color = 2.2, radians(25), (1.0, 0.95, 0.87)
    sun.rotation_euler = (radians(35), radians(-15), radians(-30))
    scene.collection.objects.link(sun)
    scene.world = bpy.data.worlds.new("World")
    kit.set_world(scene, (0.85, 0.92, 1.0), 0.65)


# Things that touch


def touching(things: dict, frames: int) -> None:
    """Things of tests/library/touching_scenes.py, whose meshes tests bake: points [S, V, 3] over the clip, triangles, colours."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end, scene.render.fps = 1, frames + 1, 24
    rng = np.random.default_rng(5)
    count = len(next(iter(things.values())).points)
    at = np.linspace(0, count - 1, frames + 1)
    key = np.minimum(at.astype(int), count - 2)
    share = (at - key)[:, None, None]
    for thing, parts in things.items():
        u, v = kit.canvas(256, 256)
        image = grainy(np.array(parts.colour), u, v, parts.varies, rng)
        points = parts.points[0]
        low, size = points.min(0), np.ptp(points, axis=0)
        axes = np.argsort(-size)[:2]
        made = kit.new_object(thing, [(points, parts.triangles, (points - low)[:, axes] / size[axes], 0)], [kit.material(thing, image)])
        kit.cached(made, (1 - share) * parts.points[key] + share * parts.points[key + 1])


def grainy(colour, u, v, varies, rng):
    """An image [256, 256, 3] of a colour with waves and grain."""
    waves = np.sin(6.3 * (u[..., None] * rng.normal(size=3) + v[..., None] * rng.normal(size=3)) + rng.uniform(0, 6, 3))
    return np.clip(colour + 2 * varies * waves + 0.04 * kit.noise(256, 256, 24, rng)[..., None], 0.02, 0.98)


# The fast scene


def procedural(frames: int) -> None:
    """A flickering flame, a cloth with travelling waves, balls that are thrown and do not return, fast small spinners."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end, scene.render.fps = 1, frames + 1, 24
    time = np.arange(frames) / frames
    rng = np.random.default_rng(3)
    flame(time, rng)
    cloth(time)
    thrown(time)
    spinners(time)


def flame(time, rng):
    """Three tongues on a bowl.  Shape and brightness follow noise that never repeats, up to about six cycles in the clip."""
    parts = []
    for x, y, width, height in ((0, 0, 0.3, 1.25), (0.2, 0.08, 0.2, 0.85), (-0.19, -0.05, 0.2, 0.95)):
        points, faces, uv = kit.ball(1, segments=24, rings=24)
        z = (points[:, 2] + 1) / 2
        wide = width * np.sqrt(np.clip(1 - points[:, 2] ** 2, 0, 1)) * (1 - 0.75 * z) / np.maximum(np.hypot(*points[:, :2].T), 1e-6)
        tongue = np.stack([x + points[:, 0] * wide, y + points[:, 1] * wide, 0.3 + height * z], 1)
        parts.append((tongue, faces, np.stack([uv[:, 0], z], 1), 0))
    _, v = kit.canvas(16, 128)
    colour = kit.material("Flame", kit.gradient(v, ["#3f6fff", "#ffe9a8", "#ffc02e", "#ff7a18", "#d92b0f"]))
    made = kit.new_object("Flame", parts, [colour], (-0.75, -0.35, 0.0))
    x, y, z = np.array([p.co for p in made.data.vertices]).T
    high = np.clip((z - 0.3) / 1.2, 0, 1)

    def flicker(top):
        """Noise [frames] of all frequencies up to top cycles in the clip, at most 1."""
        k = np.arange(0.5, top + 0.5, 0.5)[:, None]
        wave = (rng.normal(0, 1, k.shape) * np.sin(2 * pi * (k * time + rng.uniform(0, 1, k.shape)))).sum(0)
        return wave / np.abs(wave).max()

    for name, moved, top in (("Tall", (x, y, z + 0.45 * high), 5), ("Lean x", (x + 0.35 * high**1.5, y, z), 4),
                             ("Lean y", (x, y + 0.35 * high**1.5, z), 4), ("Wave", (x + 0.12 * high * np.sin(9 * z), y, z), 6),
                             ("Thick", (x + 0.35 * (x - x.mean()) * high, y + 0.35 * y * high, z), 6)):
        kit.shape(made, name, np.stack(moved, 1), flicker(top))
    strength = shine(colour, 1.0)
    for frame, value in enumerate(1.15 + 0.45 * flicker(6), 1):
        strength.default_value = value
        strength.keyframe_insert("default_value", frame=frame)
    s = np.linspace(0, 1, 12)[:, None]
    kit.new_object("Bowl", [(*kit.tube(s * np.array([0, 0, 0.3]), 0.36, 32), 0)], [kit.material("Bowl", "#4a4e69")], (-0.75, -0.35, 0.0))


def cloth(time):
    """Waves travel along it three times in the clip: sine and cosine as two shape keys."""
    u, v, faces = kit.grid(60, 36)
    s, t = kit.canvas(480, 288)
    image = np.full((*s.shape, 3), 1.0) * kit.srgb("#1d7874")
    kit.paint(image, kit.edge(np.abs((s * 5) % 1 - 0.5) - 0.16, 0.02), "#f4e9cd")
    kit.paint(image, kit.edge(np.hypot((s - 0.5) * 1.6, t - 0.5) - 0.24, 0.01), "#ee2e31")
    rest = np.stack([1.5 * u, np.zeros_like(u), 0.95 * v], 1)
    made = kit.new_object("Cloth", [(rest, faces, np.stack([u, v], 1), 0)], [kit.material("Cloth", image)], (-0.25, 0.65, 0.75))
    angle = 2 * pi * 1.4 * u + 0.6 * v
    for name, wave, values in (("Wave A", np.sin, np.cos(2 * pi * 3 * time)), ("Wave B", np.cos, -np.sin(2 * pi * 3 * time))):
        kit.shape(made, name, np.stack([rest[:, 0], 0.2 * u**0.7 * wave(angle), rest[:, 2] - 0.05 * u], 1), values)
    s = np.linspace(0, 1, 16)[:, None]
    kit.new_object("Pole", [(*kit.tube(s * np.array([0, 0, 1.85]), 0.05, 16), 0)], [kit.material("Pole", "#e9ecef")], (-0.27, 0.65, 0))


def thrown(time):
    """Two balls: one crosses the stage in one arc, the other bounces away from its thrower."""
    for name, codes, start, speed, gravity in (("Thrown", ("#e01e37", "#fff3d6"), (-1.6, -0.9, 0.5), (3.2, 0.7, 3.9), 6.4),
                                               ("Bounced", ("#3a0ca3", "#ffd60a"), (0.2, -1.3, 1.7), (0.9, 1.9, 0.0), 9.0)):
        s, _ = kit.canvas(128, 64)
        image = np.full((*s.shape, 3), 1.0) * kit.srgb(codes[0])
        kit.paint(image, kit.edge(np.abs((s * 4) % 1 - 0.5) - 0.22, 0.02), codes[1])
        made = kit.new_object(name, [(*kit.ball(0.17), 0)], [kit.material(name, image)])
        height = start[2] + speed[2] * time - gravity * time**2 / 2
        if speed[2] == 0:
            height = bounce(start[2] - 0.17, gravity, time) + 0.17
        path = np.stack([start[0] + speed[0] * time, start[1] + speed[1] * time, np.maximum(height, 0.17)], 1)
        kit.animate(made, "location", [tuple(p) for p in path])
        kit.animate(made, "rotation_euler", [(7 * a, 4 * a, 0) for a in time])


def bounce(height, gravity, time) -> np.ndarray:
    """Heights of what is let fall and comes back with 0.8 of its speed."""
    out, speed, last, now = [], 0.0, 0.0, height
    for t in np.linspace(0, 1, 64 * len(time) + 1)[:-1]:
        speed, now = speed - gravity * (t - last), now + (speed - gravity * (t - last)) * (t - last)
        if now < 0:
            now, speed = -now, -0.8 * speed
        last = t
        out.append(now)
    return np.array(out[::64])


def spinners(time):
    """A pinwheel of four colours that turns four times, and a ball on a stick that is shaken five times."""
    parts = []
    for k in range(4):
        a = pi / 2 * k
        points, faces, uv = kit.ball(1, (0, 0, 0), 20, 10, (0.24, 0.035, 0.1))
        points[:, 0] += 0.25
        turn = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
        parts.append((points @ turn.T, faces, uv, k))
    colours = [kit.material(f"Blade {k}", code) for k, code in enumerate(("#f72585", "#ffd166", "#06d6a0", "#118ab2"))]
    wheel = kit.new_object("Pinwheel", [*parts, (*kit.ball(0.07), 0)], colours, (0.85, -0.55, 0.75))
    kit.animate(wheel, "rotation_euler", 2 * pi * 4 * time, 1)
    s = np.linspace(0, 1, 12)[:, None]
    kit.new_object("Stick", [(*kit.tube(s * np.array([0, 0, 0.75]), 0.035, 12), 0)], [kit.material("Stick", "#8d6e63")], (0.85, -0.48, 0))
    head = kit.new_object("Shaken", [(*kit.ball(0.14, (0, 0, 0.62)), 0), (*kit.tube(s * np.array([0, 0, 0.6]), 0.03, 12), 1)],
                          [kit.material("Head", "#ff9f1c"), kit.material("Neck", "#5f0f40")], (0.15, -1.0, 0))
    kit.animate(head, "rotation_euler", radians(38) * np.sin(2 * pi * 5 * time), 1)

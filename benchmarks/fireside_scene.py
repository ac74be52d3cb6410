# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene of the shipped example: a dancer with a ribbon before a fireplace, in a furnished room, at evening.

Everything returns to where it began after the last frame, so that the film of it loops.  The room is 6.8 m wide (x), its back wall lies
at y = 2.4, and it is open towards the cameras.  All lengths in metres.
"""
from __future__ import annotations

from math import pi, radians

import bpy
import fireside_dancer as dancer
import numpy as np
import scene_kit as kit
from capture_scenes import shine
from mathutils import Vector
from room_scene import block, cells_of, coloured, grain, sheet

WIDE, BACK, FRONT, HIGH = 3.4, 2.4, -2.6, 2.9
HEARTH = (-1.55, 2.05)
"""Where the fire burns (x, y)."""
TARGET = (0.0, 0.35, 1.05)
"""What all cameras look at."""
FRAMES, FPS = 40, 24
EVENING = (0.30, 0.38, 0.62)
"""The light that comes from everywhere (scene linear)."""


def fireside() -> None:
    """The whole scene, its lights and its cameras, in place of what is open."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end, scene.render.fps = 1, FRAMES, FPS
    scene.view_settings.view_transform = 'Standard'
    rng = np.random.default_rng(5)
    time = np.arange(FRAMES) / FRAMES
    walls(rng)
    fireplace(rng, time)
    furniture(rng)
    curtains(time)
    dancer.dance(time)
    light(time)
    rig()
    for material in bpy.data.materials:  # what glows has a lamp beside it
        material.cycles.emission_sampling = 'NONE'
    scene.render.engine, scene.cycles.max_bounces = 'CYCLES', 2


def rig(columns: int = 6, lens: float = 27.0) -> None:
    """Cameras in two rows on an arc in front of the dancer; cam00 stands in the midst of the others."""
    eyes = [(0.0, -3.25, 1.5)]
    for k in range(columns):
        for row in (0, 1):
            turn = radians(-62 + 124 * (k + 0.5 * row) / (columns - 0.5))
            far = 3.35 + 0.15 * row
            eyes.append((far * np.sin(turn), 0.25 - far * np.cos(turn), 0.85 if row == 0 else 2.05))
    for number, eye in enumerate(eyes):
        data = bpy.data.cameras.new(f"cam{number:02}")
        data.lens = lens
        camera = bpy.data.objects.new(data.name, data)
        camera.location = eye
        camera.rotation_euler = (Vector(TARGET) - Vector(eye)).to_track_quat('-Z', 'Y').to_euler()
        bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = bpy.data.objects["cam00"]


# The room


def walls(rng) -> None:
    """Planks with a round rug, panelling and dark wallpaper on three sides, beams under the ceiling."""
    sheet("Floor", (-WIDE, FRONT, 0), (2 * WIDE, 0, 0), (0, BACK - FRONT, 0), planks(rng))
    sheet("Back", (-WIDE, BACK, 0), (2 * WIDE, 0, 0), (0, 0, HIGH), wallpaper(2 * WIDE, rng))
    sheet("Left", (-WIDE, FRONT, 0), (0, BACK - FRONT, 0), (0, 0, HIGH), wallpaper(BACK - FRONT, rng))
    sheet("Right", (WIDE, BACK, 0), (0, FRONT - BACK, 0), (0, 0, HIGH), wallpaper(BACK - FRONT, rng))
    sheet("Ceiling", (-WIDE, FRONT, HIGH), (2 * WIDE, 0, 0), (0, BACK - FRONT, 0), grain(filled("#cbb894", (512, 512)), 0.02, rng))
    wood = timber("#4b2e1c", rng)
    block("Beams", [((-WIDE, y, HIGH - 0.16), (WIDE, y + 0.18, HIGH)) for y in (-2.0, -0.8, 0.4, 1.6)], wood)
    block("Skirting", [((-WIDE, BACK - 0.03, 0), (WIDE, BACK, 0.12)), ((-WIDE, FRONT, 0), (-WIDE + 0.03, BACK, 0.12)),
                       ((WIDE - 0.03, FRONT, 0), (WIDE, BACK, 0.12))], wood)


def filled(code, shape):
    """An image of one colour."""
    return np.full((*shape, 3), 1.0) * kit.srgb(code)


def timber(code, rng):
    u, v = kit.canvas(256, 256)
    return grain(filled(code, u.shape) * (1 + 0.15 * np.sin(40 * v + 4 * u + kit.noise(256, 256, 6, rng)))[..., None], 0.1, rng)


def planks(rng):
    u, v = kit.canvas(2048, 1504)
    x, y = (u - 0.5) * 2 * WIDE, v * (BACK - FRONT) + FRONT
    column, row, seam = cells_of(x + 9, y + 9, 1.3, 0.17, 0.37)
    image = coloured(column, row, ("#8a5a35", "#99683f", "#7a4d2c", "#946035", "#85572f"), rng)
    image = image * (1 + 0.07 * np.sin(2 * pi * (7 * y + 0.6 * kit.noise(*u.shape[::-1], 24, rng))))[..., None]
    kit.paint(image, kit.edge(seam - 0.004, 0.006), "#3a2415")
    far, turn = np.hypot(x, y), np.arctan2(y, x)
    rug = np.where((far < 1.5)[..., None], kit.srgb("#233a5e"), image)
    for inner, outer, code in ((0.0, 0.25, "#d8b26a"), (0.25, 0.3, "#7c1f2b"), (0.62, 0.66, "#d8b26a"), (1.28, 1.33, "#d8b26a"),
                               (1.33, 1.46, "#7c1f2b"), (1.46, 1.5, "#d8b26a")):
        kit.paint(rug, kit.edge(np.maximum(inner - far, far - outer), 0.012), code)
    petals = 0.46 + 0.11 * np.cos(12 * turn)
    kit.paint(rug, kit.edge(np.abs(far - petals) - 0.022, 0.012), "#e9dcc0")
    diamonds = np.abs((turn * 18 / pi) % 2 - 1) * 0.18 + np.abs(far - 0.97) - 0.15
    kit.paint(rug, kit.edge(diamonds, 0.012), "#7c1f2b")
    kit.paint(rug, kit.edge(diamonds + 0.09, 0.012), "#d8b26a")
    return grain(rug, 0.06, rng)


def wallpaper(width, rng):
    """Damask above, panels of wood below."""
    u, v = kit.canvas(int(300 * width), int(300 * HIGH))
    x, y = u * width, v * HIGH
    image = filled("#2f5450", u.shape)
    for shift in (0, 0.5):
        a, b = ((x / 0.34 + shift) % 1 - 0.5) * 0.34, ((y / 0.5 + shift) % 1 - 0.5) * 0.5
        leaf = np.hypot(a / 0.075, b / 0.14) - 1
        kit.paint(image, kit.edge(np.abs(leaf) * 0.09 - 0.012, 0.01), "#587a6e")
        kit.paint(image, kit.edge(np.hypot(a, b) - 0.032, 0.012), "#a98f58")
    panel = np.maximum(np.abs((x / 0.62) % 1 - 0.5) * 0.62 - 0.24, np.abs(y - 0.5) - 0.3)
    image = np.where((y < 0.98)[..., None], kit.srgb("#6b4226"), image)
    below = y < 0.95
    kit.paint(image, kit.edge(panel, 0.01) * below, "#7d4f2f")
    kit.paint(image, kit.edge(np.abs(panel) - 0.012, 0.008) * below, "#40250f")
    kit.paint(image, kit.edge(np.abs(y - 0.97) - 0.03, 0.008), "#8f6238")
    return grain(image, 0.06, rng)


def picture(code_sky, code_land, code_far, rng):
    """A painted landscape with a frame."""
    u, v = kit.canvas(256, 192)
    image = kit.gradient(v, [code_land, code_sky, code_sky])
    for k, (high, code) in enumerate(((0.5, code_far), (0.36, code_land))):
        hills = high + 0.08 * np.sin(7 * u + 2 * k) + 0.05 * np.sin(15 * u + k)
        kit.paint(image, kit.edge(v - hills, 0.02), code)
    kit.paint(image, kit.edge(np.hypot((u - 0.7) * 1.3, v - 0.75) - 0.08, 0.01), "#ffe9b0")
    frame = np.maximum(np.abs(u - 0.5), np.abs(v - 0.5)) > 0.455
    return grain(np.where(frame[..., None], kit.srgb("#b98b3e"), image), 0.05, rng)


def rounded(name, boxes, colour, by=0.03):
    """An object of boxes with round edges."""
    block(name, boxes, colour)
    made = bpy.data.objects[name]
    bevel = made.modifiers.new("Bevel", 'BEVEL')
    bevel.width, bevel.segments = by, 4
    weld = made.modifiers.new("Weld", 'WELD')
    made.modifiers.move(1, 0)
    weld.merge_threshold = 1e-4
    made.data.polygons.foreach_set("use_smooth", np.ones(len(made.data.polygons), bool))


def furniture(rng) -> None:
    """A shelf with books on the left, an armchair and a lamp on the right, pictures, a plant."""
    wood = timber("#6a4227", rng)
    levels = (0.08, 0.52, 0.96, 1.4, 1.84)
    block("Shelf", [((-WIDE, 0.35, z), (-WIDE + 0.34, 1.75, z + 0.04)) for z in levels]
          + [((-WIDE, y, 0), (-WIDE + 0.34, y + 0.04, 1.88)) for y in (0.32, 1.04, 1.74)], wood)
    books: dict[str, list] = {code: [] for code in ("#8c2f39", "#d9a441", "#3d6b4f", "#30517a", "#e8dcc4", "#5b3a63", "#c2693c")}
    codes = list(books)
    for z in levels[:4]:
        for low, high in ((0.37, 1.03), (1.09, 1.73)):
            y = low
            while y < high - 0.08:
                thick, tall = rng.uniform(0.03, 0.065), rng.uniform(0.24, 0.36)
                books[codes[rng.integers(len(codes))]].append(
                    ((-WIDE + 0.03, y, z + 0.04), (-WIDE + 0.27 + rng.uniform(-0.03, 0.03), y + thick, z + 0.04 + tall)))
                y += thick + 0.004
    for code, those in books.items():
        block(f"Books {code}", those, code)
    cloth = grain(filled("#b5652f", (128, 128)), 0.08, rng)
    rounded("Armchair", [((1.55, 1.2, 0.12), (2.45, 2.0, 0.46)), ((1.55, 1.85, 0.3), (2.45, 2.12, 1.12)),
                         ((1.38, 1.2, 0.12), (1.6, 2.1, 0.68)), ((2.4, 1.2, 0.12), (2.62, 2.1, 0.68))], cloth, 0.07)
    rounded("Cushion", [((1.72, 1.68, 0.48), (2.12, 1.86, 0.84))], grain(filled("#e3cf9d", (64, 64)), 0.06, rng), 0.07)
    block("Feet", [((x, y, 0), (x + 0.07, y + 0.07, 0.14)) for x in (1.45, 2.48) for y in (1.26, 2.0)], wood)
    rounded("Table", [((2.72, 1.45, 0.5), (3.22, 1.95, 0.56)), ((2.94, 1.67, 0.04), (3.0, 1.73, 0.5)),
                      ((2.8, 1.53, 0), (3.14, 1.87, 0.05))], wood, 0.02)
    foot = np.stack([np.zeros(14), np.zeros(14), np.linspace(0.56, 0.9, 14)], 1) + (2.97, 1.7, 0)
    belly = 0.03 + 0.06 * np.sin(np.linspace(0.2, 3.0, 16)) ** 2
    kit.new_object("Lamp foot", [(*kit.tube(foot, belly, 24), 0)], [kit.material("Lamp foot", "#3d6b68")])
    u, v, faces = kit.grid(48, 6)
    far, turn = 0.24 - 0.1 * v, 2 * pi * u
    shade = np.stack([2.97 + far * np.cos(turn), 1.7 + far * np.sin(turn), 0.92 + 0.3 * v], 1)
    glow = kit.material("Lampshade", kit.gradient(kit.canvas(8, 64)[1], ["#e8a95a", "#ffe2a6", "#ffdb98"]))
    shine(glow, 1.3)
    kit.new_object("Lampshade", [(shade, faces, np.stack([u, v], 1), 0)], [glow])
    sheet("Picture A", (0.15, BACK - 0.02, 1.3), (0.86, 0, 0), (0, 0, 0.62), picture("#9fc3d4", "#4d6b3c", "#7f95a6", rng))
    sheet("Picture B", (1.75, BACK - 0.02, 1.45), (0.62, 0, 0), (0, 0, 0.5), picture("#e7b98a", "#5a4a63", "#a86a5a", rng))
    sheet("Picture C", (-WIDE + 0.02, -1.3, 1.25), (0, 1.0, 0), (0, 0, 0.75), picture("#d8cfa8", "#3f5d5a", "#6d8a80", rng))
    plant((0.85, 2.0), rng)


def plant(place, rng) -> None:
    """A pot with leaves that bend outwards."""
    pot = np.stack([np.zeros(8), np.zeros(8), np.linspace(0, 0.36, 8)], 1) + (*place, 0)
    kit.new_object("Pot", [(*kit.tube(pot, np.linspace(0.13, 0.2, 10), 32), 0)], [kit.material("Pot", "#c27b52")])
    parts = []
    for k in range(26):
        turn, out, high = rng.uniform(0, 2 * pi), rng.uniform(0.15, 0.36), rng.uniform(0.35, 0.8)
        s = np.linspace(0, 1, 10)
        path = np.stack([out * s**1.5 * np.cos(turn), out * s**1.5 * np.sin(turn), 0.34 + high * (s - 0.35 * s**3)], 1) + (*place, 0)
        parts.append((*kit.tube(path, 0.006 + 0.034 * np.r_[0, np.sin(pi * s) ** 0.8, 0], 8), k % 3))
    kit.new_object("Leaves", parts, [kit.material(f"Leaf {k}", code) for k, code in enumerate(("#3f7d3a", "#56964a", "#2f6b3f"))])


def fireplace(rng, time) -> None:
    """A brick fireplace with a mantel, logs and three rings of flames."""
    x, y = HEARTH
    u, v = kit.canvas(512, 512)
    column, row, seam = cells_of(u * 1.2, v * 1.2, 0.2, 0.075, 0.5)
    stones = coloured(column, row, ("#8d5140", "#9c5d48", "#7d4536", "#a36a52"), rng)
    kit.paint(stones, kit.edge(seam - 0.006, 0.006), "#c3b5a0")
    stones = grain(stones, 0.08, rng)
    block("Hearth", [((x - 0.85, 1.75, 0), (x - 0.5, BACK, 1.15)), ((x + 0.5, 1.75, 0), (x + 0.85, BACK, 1.15)),
                     ((x - 0.5, 1.75, 0.85), (x + 0.5, BACK, 1.15)), ((x - 0.6, 1.95, 1.2), (x + 0.6, BACK, HIGH - 0.01))], stones)
    block("Soot", [((x - 0.5, BACK - 0.06, 0), (x + 0.5, BACK - 0.02, 0.85)), ((x - 0.85, 1.5, 0), (x + 0.85, 1.75, 0.06)),
                   ((x - 0.5, 1.75, 0), (x + 0.5, BACK, 0.05))], grain(filled("#2b2623", (128, 128)), 0.15, rng))
    rounded("Mantel", [((x - 0.98, 1.66, 1.15), (x + 0.98, BACK, 1.24))], timber("#57351f", rng), 0.015)
    logs = [np.linspace((x - 0.32, y - 0.06, 0.12), (x + 0.3, y + 0.05, 0.13), 6),
            np.linspace((x - 0.28, y + 0.1, 0.12), (x + 0.3, y - 0.1, 0.2), 6)]
    kit.new_object("Logs", [(*kit.tube(log, 0.065, 16), 0) for log in logs], [kit.material("Logs", "#4a3020")])
    sheet("Mirror", (x - 0.4, 1.93, 1.5), (0.8, 0, 0), (0, 0, 0.8), picture("#c9d8c5", "#6b5a34", "#8fa08a", rng))
    vase = np.stack([np.zeros(12), np.zeros(12), np.linspace(1.24, 1.5, 12)], 1) + (x - 0.72, 1.85, 0)
    kit.new_object("Vase", [(*kit.tube(vase, 0.035 + 0.05 * np.sin(np.linspace(0.3, 2.9, 14)), 24), 0)], [kit.material("Vase", "#2a7f8e")])
    for k, shift in enumerate((0.62, 0.78)):
        stick = np.stack([np.zeros(4), np.zeros(4), np.linspace(1.24, 1.44 - 0.06 * k, 4)], 1) + (x + shift, 1.82, 0)
        kit.new_object(f"Candle {k}", [(*kit.tube(stick, 0.022, 16), 0)], [kit.material(f"Candle {k}", "#f3ead2")])
        dancer.flames(f"Candle flame {k}", [(x + shift, 1.82, 1.44 - 0.06 * k, 0.016, 0.075)], time, rng)
    tongues = [(x + 0.24 * np.cos(a) * s, y + 0.1 * np.sin(a) * s, 0.14, 0.11 - 0.02 * s, 0.62 - 0.22 * s)
               for a, s in ((0, 0), (0.4, 1), (2.4, 1), (3.6, 1), (5.2, 1))]
    dancer.flames("Fire", tongues, time, rng)


def curtains(time) -> None:
    """A window on the right with the evening behind it, and two curtains that move in the draught."""
    u, v = kit.canvas(192, 192)
    panes = kit.gradient(v, ["#5f7bb0", "#8fa6d6", "#b9c4e6"])
    bars = np.minimum(np.minimum(np.abs(u - 0.5), np.abs(v - 0.5)), np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v)))
    kit.paint(panes, kit.edge(bars - 0.025, 0.01), "#d9c9a4")
    sheet("Window", (WIDE - 0.02, 0.75, 1.0), (0, -1.5, 0), (0, 0, 1.4), panes)
    shine(bpy.data.objects["Window"].data.materials[0], 0.9)
    s, t = kit.canvas(256, 256)
    image = filled("#a33b3b", s.shape) * (1 - 0.12 * np.cos(2 * pi * 9 * s))[..., None]
    kit.paint(image, kit.edge(np.abs(t - 0.06) - 0.02, 0.01), "#d8b26a")
    u, v, faces = kit.grid(72, 30)
    for name, start, across in (("Curtain left", 1.15, -0.62), ("Curtain right", -0.53, -0.62)):
        down = 1 - v
        folds = WIDE - 0.12 - 0.05 * np.cos(2 * pi * 9 * u) * (0.6 + 0.4 * down)
        hung = start + across * u * (0.85 + 0.15 * down)
        points = [np.stack([folds - 0.09 * down**1.5 * (1 + np.sin(2 * pi * (moment + 0.7 * u))),
                            hung + 0.03 * down * np.sin(2 * pi * (moment + u)), 0.35 + 2.2 * v], 1) for moment in time]
        kit.cached(kit.new_object(name, [(points[0], faces, np.stack([u, v], 1), 0)], [kit.material(name, image)]), points)
    rail = np.linspace((WIDE - 0.12, 1.3, 2.58), (WIDE - 0.12, -1.3, 2.58), 6)
    kit.new_object("Rail", [(*kit.tube(rail, 0.02, 12), 0)], [kit.material("Rail", "#b98b3e")])


def lamp(name, kind, place, energy, colour, **settings):
    data = bpy.data.lights.new(name, kind)
    data.energy, data.color = energy, colour
    for key, value in settings.items():
        setattr(data, key, value)
    made = bpy.data.objects.new(name, data)
    made.location = place
    bpy.context.scene.collection.objects.link(made)
    return made


def light(time) -> None:
    """A large soft light from the front, the window, the lamp, and the fire, which flickers a little."""
    scene = bpy.context.scene
    key = lamp("Key", 'AREA', (-1.4, -3.6, 2.7), 270, (1.0, 0.87, 0.72), shape='RECTANGLE', size=2.6, size_y=1.6)
    key.rotation_euler = (Vector((0.2, 0.8, 0.9)) - key.location).to_track_quat('-Z', 'Y').to_euler()
    window = lamp("Sky", 'AREA', (WIDE - 0.25, 0.0, 1.75), 45, (0.62, 0.75, 1.0), shape='RECTANGLE', size=1.4, size_y=1.3)
    window.rotation_euler = (0, radians(90), 0)
    lamp("Bulb", 'POINT', (2.97, 1.7, 1.12), 26, (1.0, 0.72, 0.42), shadow_soft_size=0.15)
    fire = lamp("Glow", 'POINT', (HEARTH[0], HEARTH[1] - 0.18, 0.42), 60, (1.0, 0.45, 0.16), shadow_soft_size=0.22)
    for frame, share in enumerate(1 + 0.07 * np.sin(2 * pi * (2 * time + 0.2)) + 0.05 * np.sin(2 * pi * (5 * time)), 1):
        fire.data.energy = 60 * share
        fire.data.keyframe_insert("energy", frame=frame)
    scene.world = bpy.data.worlds.new("World")
    kit.set_world(scene, EVENING, 0.6)

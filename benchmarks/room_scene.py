# SPDX-License-Identifier: GPL-3.0-or-later
"""A furnished room with two people in it, and a rig that films it from the front: what Neural 3D Video's captures are like.

The room is 5 m wide (x), 4.4 m deep (y, the back wall at 2.4) and 2.7 m high, open towards the cameras and above.  All lengths in metres.
"""
from __future__ import annotations

from math import pi, radians

import bpy
import numpy as np
import scene_kit as kit
from capture_scenes import PALETTE, shine

WIDE, BACK, FRONT, HIGH = 2.5, 2.4, -2.0, 2.7
AMBIENT = 0.45
"""How bright shadows are, as a share of a surface's own colour."""
TARGET = np.array([0.0, 0.7, 1.05])
"""What all cameras look at."""


def rig(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Eyes [count, 3] of the cameras, in three rows in front of the room, the middle one first; and where they look."""
    columns = -(-count // 3)
    k, row = np.arange(count) // 3, np.arange(count) % 3
    eyes = np.stack([-1.25 + 2.5 * k / max(columns - 1, 1) + 0.07 * ((2 * k + row) % 3 - 1),
                     -3.0 + 0.08 * ((k + row) % 3), 0.95 + 0.5 * row + 0.06 * ((k + 2 * row) % 3 - 1)], 1)
    middle = int(np.argmin(np.linalg.norm(eyes - eyes.mean(0), axis=1)))
    return eyes[[middle, *(i for i in range(count) if i != middle)]], TARGET


def furnished(frames: int) -> None:
    """The room, its furniture, a lamp, and two people: one walks through it and one waves and turns; keyframes on every frame."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end, scene.render.fps = 1, frames + 1, 48
    rng = np.random.default_rng(11)
    walls(rng)
    furniture(rng)
    time = np.arange(frames) / frames
    person("Walker", ("#b23a48", "#f4e9cd", "#2f3e46"), *walking(time))
    person("Waver", ("#1d5c8a", "#f2b134", "#463f3a"), *waving(time))
    light()


# What stands still


def walls(rng) -> None:
    """Floor of planks, wallpaper behind, bricks on the left, plaster with a frieze on the right."""
    sheet("Floor", (-WIDE, FRONT, 0), (2 * WIDE, 0, 0), (0, BACK - FRONT, 0), planks(rng))
    sheet("Back", (-WIDE, BACK, 0), (2 * WIDE, 0, 0), (0, 0, HIGH), wallpaper(rng))
    sheet("Left", (-WIDE, FRONT, 0), (0, BACK - FRONT, 0), (0, 0, HIGH), bricks(rng))
    sheet("Right", (WIDE, FRONT, 0), (0, BACK - FRONT, 0), (0, 0, HIGH), plaster(rng))


def sheet(name, corner, across, up, image) -> None:
    """A flat picture, its lower left corner, lower edge and left edge given."""
    u, v, faces = kit.grid(1, 1)
    points = np.asarray(corner) + u[:, None] * np.asarray(across, float) + v[:, None] * np.asarray(up, float)
    kit.new_object(name, [(points, faces, np.stack([u, v], 1), 0)], [kit.material(name, image)])


def grain(image, amount, rng) -> np.ndarray:
    """The image with noise of three sizes on it, within 0..1."""
    height, width = image.shape[:2]
    total = sum(share * kit.noise(width, height, cells, rng) for share, cells in ((0.5, 8), (0.7, 40), (0.5, 120)))
    return np.clip(image * (1 + amount * total)[..., None], 0, 1)


def cells_of(x, y, width, height, shifted):
    """Column and row of the bricks, and the distance to their nearest seam; rows are shifted by that share of a brick."""
    row = np.floor(y / height).astype(int)
    x = x + shifted * width * (row % 7)
    column = np.floor(x / width).astype(int)
    seam = np.minimum(np.minimum(x / width % 1, 1 - x / width % 1) * width, np.minimum(y / height % 1, 1 - y / height % 1) * height)
    return column, row, seam


def coloured(column, row, codes, rng) -> np.ndarray:
    """A colour of these for each brick."""
    palette = np.array([kit.srgb(code) for code in codes])
    return palette[rng.integers(0, len(palette), (64, 64))[column % 64, row % 64]]


def planks(rng):
    u, v = kit.canvas(1536, 1344)
    column, row, seam = cells_of(v * (BACK - FRONT), u * 2 * WIDE, 1.1, 0.16, 0.37)
    image = coloured(column, row, ("#9c6b3f", "#b07c4b", "#8a5a33", "#a8713c", "#94683f"), rng)
    image = image * (1 + 0.08 * np.sin(2 * pi * (40 * u * WIDE + kit.noise(*u.shape[::-1], 30, rng))))[..., None]
    kit.paint(image, kit.edge(seam - 0.006, 0.006), "#4a2f1b")
    rug = np.maximum(np.abs(u - 0.47) / 0.26, np.abs(v - 0.5) / 0.24) - 1
    stripes = np.floor(np.maximum(np.abs(u - 0.47) / 0.26, np.abs(v - 0.5) / 0.24) * 9).astype(int)
    rug_colours = np.array([kit.srgb(c) for c in ("#7d1538", "#e8d7c3", "#264653", "#c1440e")])[stripes % 4]
    image = np.where((rug < 0)[..., None], rug_colours, image)
    return grain(image, 0.08, rng)


def wallpaper(rng):
    u, v = kit.canvas(1536, 830)
    x, y = u * 2 * WIDE, v * HIGH
    image = np.full((*u.shape, 3), 1.0) * kit.srgb("#cdd6c4")
    image = image * (1 - 0.1 * (np.floor(x / 0.2).astype(int) % 2))[..., None]
    for k, code in enumerate(("#5b7553", "#b5838d")):
        bloom = np.hypot((x + 0.1 * k) % 0.2 - 0.1, (y + 0.13 * k) % 0.26 - 0.13)
        kit.paint(image, kit.edge(bloom - 0.04, 0.012), code)
    kit.paint(image, kit.edge(y - 0.9, 0.01), "#7a6248")
    kit.paint(image, kit.edge(np.abs(y - 0.93) - 0.03, 0.01), "#efe6d2")
    for left, low, wide, high, codes in ((0.7, 1.35, 0.8, 0.6, ("#20639b", "#f6d55c")), (2.1, 1.5, 0.5, 0.7, ("#3caea3", "#ed553b"))):
        frame = np.maximum(np.abs(x - left - wide / 2) - wide / 2, np.abs(y - low - high / 2) - high / 2)
        kit.paint(image, kit.edge(frame, 0.01), "#3b2f2f")
        inside = frame < -0.05
        hills = low + high * (0.4 + 0.15 * np.sin(9 * x) + 0.08 * np.sin(23 * x))
        image = np.where(inside[..., None], np.where((y < hills)[..., None], kit.srgb(codes[0]), kit.srgb(codes[1])), image)
    return grain(image, 0.04, rng)


def bricks(rng):
    u, v = kit.canvas(1344, 830)
    column, row, seam = cells_of(u * (BACK - FRONT), v * HIGH, 0.24, 0.08, 0.5)
    image = coloured(column, row, ("#a4503a", "#b8604a", "#8f4331", "#c07a5c", "#9a5b48"), rng)
    kit.paint(image, kit.edge(seam - 0.007, 0.006), "#cfc6b8")
    return grain(image, 0.09, rng)


def plaster(rng):
    u, v = kit.canvas(1344, 830)
    x, y = u * (BACK - FRONT), v * HIGH
    image = np.full((*u.shape, 3), 1.0) * kit.srgb("#d9c9a8")
    kit.paint(image, kit.edge(np.abs(y - 1.9) - 0.12, 0.01), "#7d8597")
    kit.paint(image, kit.edge(np.abs((x / 0.22) % 1 - 0.5) + np.abs(y - 1.9) / 0.12 - 0.45, 0.05), "#f7f3e3")
    return grain(image, 0.1, rng)


def box(low, high):
    """Points, faces and uv of a box, its corners given."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    sides = []
    for axis in range(3):
        for end in (0, 1):
            u, v, faces = kit.grid(1, 1)
            unit = np.zeros((4, 3))
            unit[:, axis], unit[:, (axis + 1) % 3], unit[:, (axis + 2) % 3] = end, u, v
            sides.append((low + unit * (high - low), faces if end else faces[:, ::-1], np.stack([u, v], 1)))
    return (np.concatenate([s[0] for s in sides]), np.concatenate([s[1] + 4 * k for k, s in enumerate(sides)]),
            np.concatenate([s[2] for s in sides]))


def block(name, boxes, colour) -> None:
    """An object of boxes (low, high) in a colour or an image; flat."""
    made = kit.new_object(name, [(*box(*corners), 0) for corners in boxes], [kit.material(name, colour)])
    made.data.polygons.foreach_set("use_smooth", np.zeros(len(made.data.polygons), bool))


def furniture(rng) -> None:
    u, v = kit.canvas(256, 256)
    check = np.where((((u * 8).astype(int) + (v * 8).astype(int)) % 2)[..., None] == 1, kit.srgb("#4d7298"), kit.srgb("#77a6b6"))
    block("Sofa", [((-2.2, 1.3, 0.0), (-0.5, 2.2, 0.42)), ((-2.2, 2.0, 0.42), (-0.5, 2.3, 0.95)), ((-2.35, 1.3, 0), (-2.2, 2.3, 0.62)),
                   ((-0.5, 1.3, 0), (-0.35, 2.3, 0.62))], grain(check, 0.08, rng))
    wood = grain(np.full((256, 256, 3), 1.0) * kit.srgb("#7f5539") * (1 + 0.15 * np.sin(40 * v + 3 * u))[..., None], 0.1, rng)
    legs = [((x, y, 0), (x + 0.06, y + 0.06, 0.5)) for x in (0.55, 1.44) for y in (0.9, 1.44)]
    block("Table", [((0.5, 0.85, 0.5), (1.55, 1.55, 0.56)), *legs], wood)
    block("Shelf", [((1.6, 2.05, z), (2.45, 2.38, z + 0.04)) for z in (0.1, 0.55, 1.0, 1.45, 1.9)]
          + [((x, 2.05, 0), (x + 0.04, 2.38, 1.94)) for x in (1.58, 2.43)], wood)
    books: dict[str, list] = {code: [] for code in PALETTE}
    for z in (0.14, 0.59, 1.04, 1.49):
        x = 1.63
        while x < 2.36:
            wide, high = rng.uniform(0.03, 0.07), rng.uniform(0.22, 0.36)
            books[PALETTE[rng.integers(len(PALETTE))]].append(((x, 2.08 + rng.uniform(0, 0.05), z), (x + wide, 2.36, z + high)))
            x += wide + 0.004
    for k, (code, those) in enumerate(books.items()):
        block(f"Books {k}", those, code)
    pot = np.stack([np.zeros(10), np.zeros(10), np.linspace(0.56, 0.8, 10)], 1) + (0.85, 1.2, 0)
    kit.new_object("Vase", [(*kit.tube(pot, 0.08, 24), 0)], [kit.material("Vase", "#2a9d8f")])
    kit.new_object("Fruit", [(*kit.ball(0.07, (1.15 + 0.1 * k, 1.1 + 0.09 * (k % 2), 0.63)), 0) for k in range(3)],
                   [kit.material("Fruit", "#e76f51")])
    stand = np.stack([np.zeros(8), np.zeros(8), np.linspace(0, 1.5, 8)], 1) + (2.15, 0.9, 0)
    kit.new_object("Stand", [(*kit.tube(stand, 0.025, 12), 0)], [kit.material("Stand", "#30343f")])
    shade = kit.material("Shade", "#ffe0a3")
    shine(shade, 1.0)
    kit.new_object("Lamp", [(*kit.ball(0.2, (2.15, 0.9, 1.6), stretch=(1, 1, 0.8)), 0)], [shade])


def light() -> None:
    """A sun with sharp shadows, and everywhere a share of each surface's own colour: pictures have no noise, whatever the samples."""
    scene = bpy.context.scene
    for made in bpy.data.materials:
        shader = made.node_tree.nodes["Principled BSDF"]
        base, glow = shader.inputs["Base Color"], shader.inputs["Emission Color"]
        if shader.inputs["Emission Strength"].default_value == 0:
            if base.is_linked:
                made.node_tree.links.new(base.links[0].from_socket, glow)
            else:
                glow.default_value = base.default_value
            shader.inputs["Emission Strength"].default_value = AMBIENT
            shader.inputs["Specular IOR Level"].default_value = 0
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", 'SUN'))
    sun.data.energy, sun.data.angle, sun.data.color = 2.4, 0.0, (1.0, 0.95, 0.87)
    sun.rotation_euler = (radians(48), 0, radians(-24))
    scene.collection.objects.link(sun)
    scene.world = bpy.data.worlds.new("World")
    kit.set_world(scene, (0.55, 0.65, 0.8), 1.0)


# People: limbs are rigid bodies between joints, which numpy moves

LIMBS = {"Torso": ("hip", "neck", 0.17, 0), "Head": ("neck", "crown", 0.115, 1)} | {
    f"{side} {limb}": (f"{side} {start}", f"{side} {end}", radius, colour) for side in ("left", "right")
    for limb, start, end, radius, colour in (("arm", "elbow", "shoulder", 0.06, 0), ("forearm", "hand", "elbow", 0.05, 1),
                                             ("thigh", "knee", "hip", 0.085, 2), ("shin", "foot", "knee", 0.06, 2))}
"""The joints of each limb from the lower one at rest to the upper one, its radius and the number of its colour."""


def person(name, codes, place, heading, swings) -> None:
    """A person at place [F, 3] (between the feet) who looks along heading [F] (0: towards the cameras, -y); swings: see joints()."""
    found = joints(place, heading, **swings)
    u, v = kit.canvas(128, 128)
    shirt = np.where(((v * 9).astype(int) % 2 == 1)[..., None], kit.srgb(codes[0]), kit.srgb(codes[1]))
    face = np.full((*u.shape, 3), 1.0) * kit.srgb("#d8a47f")
    kit.paint(face, kit.edge(0.62 - v, 0.03), codes[2])
    cloth = np.full((*u.shape, 3), 1.0) * kit.srgb(codes[2]) * (1 + 0.25 * np.sin(60 * u))[..., None]
    materials = [kit.material(f"{name} {k}", np.clip(image, 0, 1)) for k, image in enumerate((shirt, face, cloth))]
    for limb, (start, end, radius, colour) in LIMBS.items():
        a, b = found[start], found[end]
        length = float(np.linalg.norm(b[0] - a[0]))
        points, faces, uv = kit.ball(1, segments=20, rings=14)
        points = points * (radius * (1.25 if limb == "Torso" else 1.0), radius, length / 2 + 0.4 * radius) + (0, 0, length / 2)
        made = kit.new_object(f"{name} {limb}", [(points, faces, uv, colour)], materials)
        made.rotation_mode = 'QUATERNION'
        kit.animate(made, "location", [tuple(p) for p in a])
        kit.animate(made, "rotation_quaternion", [tuple(q) for q in upright(b - a, heading)])


def upright(along, heading) -> np.ndarray:
    """Quaternions [F, 4] that turn z into `along` [F, 3] after a turn by heading [F] about z."""
    unit = along / np.linalg.norm(along, axis=1, keepdims=True)
    axis = np.stack([-unit[:, 1], unit[:, 0], np.zeros(len(unit))], 1)
    q = np.concatenate([1 + unit[:, 2:], axis], 1)
    q = np.where(np.linalg.norm(q, axis=1, keepdims=True) < 1e-6, (0.0, 1.0, 0.0, 0.0), q)
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    c, s = np.cos(heading / 2), np.sin(heading / 2)
    w, x, y, z = q.T
    return np.stack([w * c - z * s, x * c + y * s, y * c - x * s, w * s + z * c], 1)


def joints(place, heading, left_arm, right_arm, left_leg, right_leg, lean) -> dict[str, np.ndarray]:
    """Places [F, 3] of the joints.  Arms [F, 3]: swing forwards, lift sideways, bend of the elbow; legs [F, 2]: swing forwards, bend of
    the knee; lean [F] forwards; all in radians."""
    def turned(points):
        c, s = np.cos(heading), np.sin(heading)
        return place + np.stack([c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1], points[:, 2]], 1)

    def along(length, forward, sideways):
        """A step that hangs down where both angles are 0."""
        down = np.stack([np.sin(sideways) + 0 * forward, -np.sin(forward) * np.cos(sideways), -np.cos(forward) * np.cos(sideways)], 1)
        return length * down

    zero = np.zeros(len(heading))
    hip = np.stack([zero, zero, zero + 0.92], 1)
    up = np.stack([zero, -np.sin(lean), np.cos(lean)], 1)
    neck = hip + 0.55 * up
    found = {"hip": hip, "neck": neck, "crown": neck + 0.29 * up}
    for side, sign, arm, leg in (("left", 1, left_arm, left_leg), ("right", -1, right_arm, right_leg)):
        shoulder = neck + np.array([0.24 * sign, 0, -0.06])
        elbow = shoulder + along(0.28, arm[:, 0], sign * arm[:, 1])
        hand = elbow + along(0.27, arm[:, 0] + arm[:, 2], sign * arm[:, 1])
        thigh = hip + np.array([0.1 * sign, 0, -0.04])
        knee = thigh + along(0.43, leg[:, 0], zero)
        found |= {f"{side} shoulder": shoulder, f"{side} elbow": elbow, f"{side} hand": hand, f"{side} hip": thigh,
                  f"{side} knee": knee, f"{side} foot": knee + along(0.4, leg[:, 0] - leg[:, 1], zero)}
    return {name: turned(points) for name, points in found.items()}


def walking(time):
    """Through the room from the left to the right, one and a half steps a second, bowing a little at the end."""
    step, ahead = 2 * pi * 1.5 * time, np.sin(2 * pi * 1.5 * time + 1)
    place = np.stack([-1.3 + 1.9 * time, 0.1 + 0.25 * np.sin(pi * time), 0.03 * np.abs(np.sin(step))], 1)
    swing, still = np.sin(step), 0.15 + 0 * time
    return place, radians(70) - 0.5 * time, dict(
        left_arm=np.stack([0.7 * swing, still, 0.4 + 0.3 * swing], 1), right_arm=np.stack([-0.7 * swing, still, 0.4 - 0.3 * swing], 1),
        left_leg=np.stack([-0.5 * swing, 0.35 * (1 + ahead)], 1), right_leg=np.stack([0.5 * swing, 0.35 * (1 - ahead)], 1),
        lean=0.05 + 0.25 * time**2)


def waving(time):
    """On one spot, turning, one arm waving fast, the other lifted slowly."""
    place = np.stack([1.05 + 0.05 * np.sin(4 * pi * time), -0.25 + 0 * time, 0 * time], 1)
    wave, none = np.sin(2 * pi * 3 * time), 0 * time
    return place, radians(-25) + 0.6 * np.sin(2 * pi * time), dict(
        left_arm=np.stack([none, 2.3 + 0.45 * wave, 0.3 + 0.2 * wave], 1),
        right_arm=np.stack([1.3 * time, 0.25 + 0.4 * time, 0.9 + none], 1),
        left_leg=np.stack([none, none], 1), right_leg=np.stack([none, none], 1), lean=0.1 * np.sin(2 * pi * time))

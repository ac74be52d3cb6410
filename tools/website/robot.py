# SPDX-License-Identifier: GPL-3.0-or-later
"""The gallery's robot: rigid parts that hang on each other's joints, and a dance that ends as it begins.  It looks along -y; metres."""
from __future__ import annotations

from math import pi

import bpy
import numpy as np
import scene_kit as kit
from capture_scenes import PALETTE, light, shine
from fireside_scene import rounded

TEAL, CREAM, STEEL, ORANGE, GLOW = "#2f8f8b", "#f2e6cf", "#3a434d", "#e4572e", "#9ff5e1"
HIP, CHEST, SHOULDER, UPPER, THIGH, SHIN = 0.86, 0.2, 0.43, 0.34, 0.33, 0.36
"""Heights and lengths."""


def dancing(frames: int, fps: int = 24) -> None:
    """The robot on its plate, with keyframes on every frame, in light."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end, scene.render.fps = 1, frames, fps
    beat = 2 * pi * np.arange(frames) / frames
    plate()
    hips = body(beat)
    for side in (-1, 1):
        arm(hips, side, beat)
        leg(hips, side, beat)
    light()


def part(name, parent, place, boxes=(), balls=(), colour=STEEL, by=0.04):
    """Boxes (low, high) with round edges, or balls (place, radius), whose joint is at `place` of the part that they hang on."""
    if boxes:
        rounded(name, boxes, colour, by)
        made = bpy.data.objects[name]
    else:
        made = kit.new_object(name, [(*kit.ball(radius, centre), 0) for centre, radius in balls], [kit.material(name, colour)])
    made.parent, made.location = parent, place
    return made


def turn(obj, **angles) -> None:
    """Keyframes of rotations about x, y and z, in radians."""
    for axis, values in angles.items():
        kit.animate(obj, "rotation_euler", np.broadcast_to(values, len(values)), "xyz".index(axis))


def plate() -> None:
    """What it stands on: rings in the gallery's colours."""
    u, v = kit.canvas(512, 512)
    ring = np.minimum((np.hypot(u - 0.5, v - 0.5) * 2 * 6).astype(int), 5)
    image = np.array([kit.srgb(code) for code in (CREAM, PALETTE[0], CREAM, PALETTE[7], PALETTE[1], PALETTE[4])])[ring]
    x, y, faces = kit.grid(64, 8)
    points = 0.95 * y[:, None] * np.stack([np.cos(2 * pi * x), np.sin(2 * pi * x), 0 * x], 1)
    rim = np.stack([0.95 * np.cos(2 * pi * x), 0.95 * np.sin(2 * pi * x), -0.08 * (1 - y)], 1)
    kit.new_object("Plate", [(points, faces, points[:, :2] / 1.9 + 0.5, 0), (rim, faces, np.stack([x, y], 1), 1)],
                   [kit.material("Plate", image), kit.material("Rim", STEEL)])


def body(beat):
    """Hips, chest and head; returns the hips."""
    hips = part("Hips", None, (0, 0, HIP), [((-0.2, -0.14, -0.07), (0.2, 0.14, 0.09))])
    kit.animate(hips, "location", [(0.07 * np.sin(b), 0, HIP - 0.035 + 0.035 * np.cos(2 * b)) for b in beat])
    turn(hips, y=0.1 * np.sin(beat), z=0.16 * np.sin(beat))
    chest = part("Chest", hips, (0, 0, CHEST), [((-0.32, -0.21, -0.1), (0.32, 0.21, 0.46))], colour=TEAL, by=0.1)
    turn(chest, x=0.06 * np.sin(2 * beat), y=-0.2 * np.sin(beat), z=-0.3 * np.sin(beat))
    part("Panel", chest, (0, 0, 0), [((-0.2, -0.235, 0.08), (0.2, -0.19, 0.36))], colour=CREAM)
    for k, code in enumerate((ORANGE, PALETTE[1], PALETTE[3])):
        part(f"Lamp {k}", chest, (-0.11 + 0.11 * k, -0.24, 0.25), balls=[((0, 0, 0), 0.035)], colour=code)
    neck = part("Neck", chest, (0, 0, 0.5), balls=[((0, 0, 0), 0.1)])
    head = part("Head", neck, (0, 0, 0.08), [((-0.34, -0.24, 0), (0.34, 0.24, 0.44))], colour=TEAL, by=0.13)
    turn(head, x=0.12 * np.sin(2 * beat + 0.6), y=0.24 * np.sin(beat + 0.5), z=0.35 * np.sin(beat + 0.2))
    part("Face", head, (0, 0, 0), [((-0.27, -0.27, 0.08), (0.27, -0.2, 0.36))], colour="#182028", by=0.06)
    for side in (-1, 1):
        eye = part(f"Eye {side}", head, (0.12 * side, -0.265, 0.23), balls=[((0, 0, 0), 0.06)], colour=GLOW)
        shine(eye.data.materials[0], 1.6)
        kit.animate(eye, "scale", 1 - 0.9 * np.exp(-((beat - 4.2) / 0.16) ** 2), 2)  # a wink of both
        part(f"Ear {side}", head, (0.36 * side, 0, 0.22), balls=[((0, 0, 0), 0.09)], colour=ORANGE)
    stem = part("Antenna", head, (0, 0, 0.42), [((-0.012, -0.012, 0), (0.012, 0.012, 0.2))], by=0.004)
    turn(stem, x=0.2 * np.sin(2 * beat + 2.2), y=-0.35 * np.sin(2 * beat + 1.1))
    part("Tip", stem, (0, 0, 0.22), balls=[((0, 0, 0), 0.055)], colour=ORANGE)
    return hips


def arm(hips, side, beat) -> None:
    """One arm goes up while the other goes down."""
    chest = bpy.data.objects["Chest"]
    swing = np.sin(beat + (0 if side > 0 else pi))
    shoulder = part(f"Shoulder {side}", chest, (SHOULDER * side, 0, 0.34), balls=[((0, 0, 0), 0.12)], colour=ORANGE)
    turn(shoulder, x=-0.35 + 0.3 * np.cos(beat), y=-side * (1.25 + 0.75 * swing))
    part(f"Upper {side}", shoulder, (0, 0, 0), [((-0.055, -0.055, -UPPER), (0.055, 0.055, -0.05))])
    elbow = part(f"Elbow {side}", shoulder, (0, 0, -UPPER), balls=[((0, 0, 0), 0.075)], colour=CREAM)
    turn(elbow, x=-0.5 - 0.4 * swing, y=-side * (0.55 + 0.5 * np.sin(2 * beat + 0.8)))
    part(f"Forearm {side}", elbow, (0, 0, 0), [((-0.085, -0.085, -0.36), (0.085, 0.085, -0.05))], colour=TEAL, by=0.05)
    fingers = [((0.05 * side, -0.06, -0.05), 0.045), ((-0.05 * side, -0.03, -0.08), 0.045)]
    part(f"Hand {side}", elbow, (0, 0, -0.42), balls=[((0, 0, 0), 0.09), *fingers], colour=CREAM)


def leg(hips, side, beat) -> None:
    """Knees bend so far that the feet stay where they are, but for the one that is lifted."""
    lift = np.clip(-side * np.sin(beat), 0, 1) ** 2
    thigh = part(f"Hip {side}", hips, (0.14 * side, 0, -0.06), balls=[((0, 0, 0), 0.1)])
    bend = 0.3 - 0.3 * np.cos(2 * beat) + 0.7 * lift
    turn(thigh, x=-bend, y=-0.18 * np.sin(beat))
    part(f"Thigh {side}", thigh, (0, 0, 0), [((-0.075, -0.075, -THIGH), (0.075, 0.075, -0.05))], colour=TEAL)
    knee = part(f"Knee {side}", thigh, (0, 0, -THIGH), balls=[((0, 0, 0), 0.085)], colour=ORANGE)
    turn(knee, x=2 * bend)
    part(f"Shin {side}", knee, (0, 0, 0), [((-0.09, -0.09, -SHIN), (0.09, 0.09, -0.04))], colour=CREAM, by=0.05)
    foot = part(f"Foot {side}", knee, (0, 0, -SHIN), [((-0.13, -0.24, -0.1), (0.13, 0.12, 0.03))], by=0.05)
    turn(foot, x=-bend)

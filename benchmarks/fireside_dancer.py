# SPDX-License-Identifier: GPL-3.0-or-later
"""What moves in fireside_scene.py: a dancer with a skirt and a ribbon, and flames.  Every motion has the clip as its period."""
from __future__ import annotations

from math import pi, radians

import numpy as np
import scene_kit as kit
from capture_scenes import shine
from room_scene import upright

TURN = radians(-30)
"""The dancer's heading on the first frame; 0 looks towards the cameras (-y)."""
SKIN, DRESS, GOLD = "#e0ac88", "#b3202c", "#e6b84f"


def wave(time, harmonic, shift=0.0):
    return np.sin(2 * pi * (harmonic * time + shift))


def dance(time) -> None:
    """One turn on the toes, one leg drawn up, a ribbon in the right hand."""
    found = joints(time)
    heading = TURN + 2 * pi * time
    limbs(found, heading)
    skirt(found, time)
    ribbon(found, time)


def direction(side, forward, up):
    """A unit vector [F, 3] in the dancer's frame: x to her left, -y ahead."""
    vector = np.stack(np.broadcast_arrays(side, -np.asarray(forward), up), -1).astype(float)
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def joints(time) -> dict[str, np.ndarray]:
    """Places [F, 3] of her joints at `time` (in clips)."""
    one = np.ones_like(time)
    sway = 0.05 * wave(time, 1, 0.1)
    hip = np.stack([0.03 * wave(time, 1), 0 * one, 1.0 + 0.025 * wave(time, 2)], -1)
    spine = direction(sway, -0.06 + 0.05 * wave(time, 1, 0.3), one)
    chest, neck = hip + 0.26 * spine, hip + 0.46 * spine
    head = neck + 0.13 * direction(0.25 * wave(time, 1, 0.2), 0.05 * one, one)
    found = {"hip": hip, "chest": chest, "neck": neck, "head": head, "crown": head + 0.16 * direction(0.2 * wave(time, 1, 0.2), 0, one)}
    arms = {"left": (1, direction(0.8, 0.25 + 0.1 * wave(time, 1, 0.6), 0.75 + 0.3 * wave(time, 1, 0.5)),
                     direction(0.12 + 0.1 * wave(time, 1), 0.3, one)),
            "right": (-1, direction(-1.0, 0.25, 0.12 + 0.25 * wave(time, 1, 0.2)),
                      direction(-0.8, 0.35 + 0.2 * wave(time, 2, 0.1), 0.35 + 0.3 * wave(time, 1, 0.1)))}
    for side, (sign, upper, lower) in arms.items():
        shoulder = neck + np.array([0.155 * sign, 0, -0.05])
        elbow = shoulder + 0.26 * upper
        found |= {f"{side} shoulder": shoulder, f"{side} elbow": elbow, f"{side} hand": elbow + 0.25 * lower,
                  f"{side} finger": elbow + 0.36 * lower}
    legs = {"left": (1, direction(0.05 - sway, 0.02, -one), direction(-0.02 - sway, -0.02, -one), direction(0, 0.25, -one)),
            "right": (-1, direction(-0.6, 0.5 + 0.1 * wave(time, 1), -0.95 + 0.15 * wave(time, 1, 0.4)),
                      direction(0.75, -0.45, -0.75), direction(0.6, -0.3, -one))}
    for side, (sign, upper, lower, toe) in legs.items():
        top = hip + np.array([0.085 * sign, 0, -0.04])
        knee = top + 0.44 * upper
        foot = knee + 0.4 * lower
        found |= {f"{side} hip": top, f"{side} knee": knee, f"{side} foot": foot, f"{side} toe": foot + 0.12 * toe}
    c, s = np.cos(TURN + 2 * pi * time), np.sin(TURN + 2 * pi * time)
    return {name: np.stack([c * p[:, 0] - s * p[:, 1], s * p[:, 0] + c * p[:, 1], p[:, 2]], -1) for name, p in found.items()}


LIMBS = (  # name, joints, radii along it, material
    ("Hips", "hip", "chest", (0.10, 0.125, 0.115, 0.095, 0.09), 1), ("Chest", "chest", "neck", (0.09, 0.115, 0.125, 0.115, 0.055), 1),
    ("Neck", "neck", "head", (0.045, 0.042, 0.042), 0),
    *((f"{side} {name}", f"{side} {start}", f"{side} {end}", radii, colour) for side in ("left", "right")
      for name, start, end, radii, colour in (
          ("upper arm", "shoulder", "elbow", (0.045, 0.048, 0.042, 0.036), 0), ("forearm", "elbow", "hand", (0.036, 0.038, 0.03, 0.024), 0),
          ("palm", "hand", "finger", (0.024, 0.034, 0.028, 0.014), 0),
          ("thigh", "hip", "knee", (0.085, 0.085, 0.07, 0.055), 0), ("shin", "knee", "foot", (0.055, 0.06, 0.05, 0.034), 0),
          ("shoe", "foot", "toe", (0.036, 0.04, 0.034, 0.018), 1))))


def limbs(found, heading) -> None:
    """Round limbs between the joints, a head with a face, and a knot of hair."""
    materials = [kit.material("Skin", SKIN), kit.material("Dress", DRESS), kit.material("Hair", "#3b2116"), kit.material("Dark", "#2a1a16"),
                 kit.material("Lips", "#b4453f"), kit.material("Gold", GOLD)]
    for name, start, end, radii, colour in LIMBS:
        a, b = found[start], found[end]
        length = float(np.linalg.norm(b[0] - a[0]))
        s = np.linspace(0, 1, 16)
        around = np.interp(np.r_[0, s, 1], np.linspace(0, 1, len(radii)), radii)
        points, faces, uv = kit.tube(np.stack([0 * s, 0 * s, length * s], 1), around, 20)
        if name in ("Hips", "Chest"):
            points = points * (1.1, 0.8, 1)
        flat = (1, 0.8, 1) if colour and "shoe" not in name else (1, 1, 1)
        ends = [(*kit.ball(radius, (0, 0, at), 20, 10, flat), colour) for radius, at in ((radii[0], 0), (radii[-1], length))]
        follow(kit.new_object(f"Dancer {name}", [(points, faces, uv, colour), *ends], materials), a, b, heading)
    face = [(*kit.ball(0.1, (0, -0.005, 0.07), stretch=(0.86, 0.95, 1.2)), 0),
            (*kit.ball(0.1, (0, 0.018, 0.088), stretch=(0.97, 1.0, 1.13)), 2),
            (*kit.ball(0.055, (0, 0.075, 0.175)), 2), (*kit.tube(np.array([(0, 0.05, 0.155), (0, 0.06, 0.165)]), 0.045, 20), 5),
            (*kit.ball(0.018, (0, -0.103, 0.06), stretch=(0.7, 0.8, 1.1)), 0),
            (*kit.ball(0.02, (0, -0.092, 0.018), stretch=(1, 0.4, 0.4)), 4)]
    for side in (-1, 1):
        face += [(*kit.ball(0.0135, (0.034 * side, -0.091, 0.078), stretch=(1.2, 0.6, 0.9)), 3),
                 (*kit.ball(0.02, (0.034 * side, -0.09, 0.106), stretch=(1, 0.4, 0.22)), 2)]
    follow(kit.new_object("Dancer Head", face, materials), found["head"], found["crown"], heading)


def follow(obj, a, b, heading) -> None:
    """Let an object stand at a [F, 3], its z axis towards b [F, 3]."""
    obj.rotation_mode = 'QUATERNION'
    kit.animate(obj, "location", [tuple(p) for p in a])
    kit.animate(obj, "rotation_quaternion", [tuple(q) for q in upright(b - a, heading)])


def skirt(found, time) -> None:
    """A wide skirt that flies out while she turns; its hem comes a little later than her hips."""
    u, v, faces = kit.grid(144, 24)
    turn = 2 * pi * u
    points = []
    for k, moment in enumerate(time):
        phase = 2 * pi * moment
        folds = np.cos(9 * turn + phase) + 0.5 * np.cos(5 * turn - 2 * phase)
        far = 0.105 + 0.46 * v**0.85 + 0.035 * v * folds
        around = turn + TURN + phase - 0.55 * v
        low = 0.03 - 0.05 * v - 0.36 * v**1.5 + 0.05 * v * np.sin(9 * turn + phase) + 0.07 * v * np.sin(turn + 2 * phase)
        points.append(np.stack([far * np.cos(around), far * np.sin(around), low], 1) + found["hip"][k] + (0, 0, 0.02))
    s, t = kit.canvas(1024, 256)
    image = np.full((*s.shape, 3), 1.0) * kit.srgb(DRESS) * (1.0 - 0.18 * t + 0.06 * np.cos(2 * pi * 9 * s))[..., None]
    for place, width, code in ((0.96, 0.035, GOLD), (0.87, 0.012, GOLD), (0.78, 0.02, "#f4e6cf")):
        kit.paint(image, kit.edge(np.abs(t - place) - width, 0.01), code)
    flower = np.hypot(((s * 18) % 1 - 0.5) * 0.12, (t - 0.52) * 0.45)
    kit.paint(image, kit.edge(flower - 0.022, 0.006), "#f4e6cf")
    kit.paint(image, kit.edge(flower - 0.009, 0.004), GOLD)
    kit.cached(kit.new_object("Skirt", [(points[0], faces, np.stack([u, v], 1), 0)], [kit.material("Skirt", image)]), points)


def ribbon(found, time) -> None:
    """A ribbon on a stick: each piece follows the stick's tip later than the one before, in loops that widen."""
    hand, finger = found["right hand"], found["right finger"]
    rod = kit.tube(np.linspace((0, 0, 0), (0, 0, 0.34), 5), 0.009, 10)
    stick = kit.new_object("Stick", [(*rod, 0)], [kit.material("Stick", "#f1e4c8")])
    follow(stick, (hand + finger) / 2, finger, TURN + 2 * pi * time)
    u, v, faces = kit.grid(220, 4)
    s = np.linspace(0, 1, 221)
    points = []
    for moment in time:
        then = joints(moment - 0.42 * s)
        along = then["right finger"] - then["right hand"]
        tip = (then["right hand"] + then["right finger"]) / 2 + 0.34 * along / np.linalg.norm(along, axis=1, keepdims=True)
        outward = tip * (1, 1, 0)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        swing = 2 * pi * (3.5 * s - 2 * moment)
        size = 0.13 * np.minimum(1, 3 * s)[:, None]
        line = tip + outward * (0.1 * s[:, None] + size * np.cos(swing)[:, None])
        line[:, 2] += size[:, 0] * np.sin(swing) - 0.42 * s**1.3
        ahead = np.gradient(line, axis=0)
        across = np.cross(ahead, outward * np.sin(swing + 0.4)[:, None] + (0, 0, 0.35) + outward * 0.4)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        width = 0.035 * (np.linspace(-1, 1, 5))
        points.append((line[None] + width[:, None, None] * across[None]).reshape(-1, 3))
    share, _ = kit.canvas(256, 8)
    colour = kit.material("Ribbon", kit.gradient(share, ["#ffd34d", "#ff9e3d", "#ff6f61", "#ffd34d"]))
    kit.cached(kit.new_object("Ribbon", [(points[0], faces, np.stack([u, v], 1), 0)], [colour]), points)


def flames(name, tongues, time, rng) -> None:
    """Tongues (x, y, z, radius, height) whose waves climb; they glow, most at the bottom."""
    parts, frames = [], []
    for x, y, z, radius, height in tongues:
        points, faces, uv = kit.ball(1, segments=20, rings=28)
        share = (points[:, 2] + 1) / 2
        thick = radius * np.sin(pi * share**0.6) ** 0.9 * (1 - 0.35 * share) + 1e-4
        unit = points[:, :2] / np.maximum(np.hypot(*points[:, :2].T), 1e-6)[:, None]
        unit = np.where(np.hypot(*points[:, :2].T)[:, None] < 1e-5, 0, unit)
        shift = rng.uniform(0, 1, 5)
        moved = []
        for t in time:
            tall = height * (1 + 0.16 * wave(t, 3, shift[0]) + 0.1 * wave(t, 5, shift[1]))
            lean = share**1.4 * radius
            bend = [lean * (0.9 * np.sin(2 * pi * (1.3 * share - n * t + a)) + 0.5 * np.sin(2 * pi * (2.6 * share - m * t + b)))
                    for n, m, a, b in ((3, 5, shift[2], shift[3]), (2, 5, shift[3], shift[4]))]
            pulse = thick * (1 + 0.25 * np.sin(2 * pi * (2 * share - 4 * t + shift[1])))
            moved.append(np.stack([x + unit[:, 0] * pulse + bend[0], y + unit[:, 1] * pulse + 0.6 * bend[1], z + tall * share], 1))
        frames.append(moved)
        parts.append((moved[0], faces, np.stack([uv[:, 0], share], 1), 0))
    colour = kit.material(name, kit.gradient(kit.canvas(8, 128)[1], ["#ff8a1c", "#fff0a8", "#ffd257", "#ffa52e", "#f2641a", "#c93b10"]))
    shine(colour, 1.6)
    tree = colour.node_tree
    facing, clear, mix = (tree.nodes.new(kind) for kind in ("ShaderNodeLayerWeight", "ShaderNodeBsdfTransparent", "ShaderNodeMixShader"))
    facing.inputs["Blend"].default_value = 0.35
    out = next(node for node in tree.nodes if node.type == 'OUTPUT_MATERIAL')
    for source, target in ((facing.outputs["Facing"], mix.inputs[0]), (tree.nodes["Principled BSDF"].outputs[0], mix.inputs[1]),
                           (clear.outputs[0], mix.inputs[2]), (mix.outputs[0], out.inputs["Surface"])):
        tree.links.new(source, target)
    made = kit.new_object(name, parts, [colour])
    kit.cached(made, [np.concatenate([moved[k] for moved in frames]) for k in range(len(time))])
    made.visible_shadow = False

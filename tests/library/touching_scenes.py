# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of things that touch and move, baked, of which it is known what each Gaussian belongs to; strokes as a hand draws them."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from moving_meshes import grid, sphere

import fastgs_blender as fg
from fastgs_blender.selecting.shapes import Stroke, touched
from fastgs_blender.surfaces.bake import surface_samples

FRAMES = 24
SUN = np.array([0.4, -0.5, 0.77])
"""Where the light comes from that shades faces."""


@dataclass(frozen=True, eq=False)
class Thing:
    """A mesh: its vertices [S, V, 3] over the clip, its triangles, its colour (sRGB), and how much the colour varies over it.

    texture  instead of these two: from places [M, 3] in the first frame to their colours [M, 3]
    shaded   faces are darker by the way that they look in the first frame
    """

    points: np.ndarray
    triangles: np.ndarray
    colour: tuple[float, float, float]
    varies: float = 0.05
    texture: Callable[[np.ndarray], np.ndarray] | None = None
    shaded: bool = False

    def shade(self) -> np.ndarray:
        """How light each of its triangles is [T]."""
        a, b, c = np.moveaxis(self.points[0][self.triangles], 1, 0)
        normal = np.cross(b - a, c - a)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
        return 0.45 + 0.55 * np.minimum(np.abs(normal @ SUN), 1)


@dataclass(frozen=True, eq=False)
class Scene:
    """A baked model, the names of its things, which of them each Gaussian belongs to [N], and which are wanted as one."""

    model: fg.GaussianModel
    names: tuple[str, ...]
    label: np.ndarray
    wanted: tuple[str, ...]

    @property
    def truth(self) -> np.ndarray:
        """Which Gaussians [N] are wanted."""
        return np.isin(self.label, [self.names.index(name) for name in self.wanted])


def baked(things: dict[str, Thing], wanted: tuple[str, ...], count: int, seed: int = 0, basis: str = "cosine") -> Scene:
    """A scene of `count` Gaussians."""
    starts = np.cumsum([0] + [thing.points.shape[1] for thing in things.values()])
    triangles = np.concatenate([thing.triangles + start for thing, start in zip(things.values(), starts)])
    part = np.repeat(np.arange(len(things)), [len(thing.triangles) for thing in things.values()])
    points = np.concatenate([thing.points for thing in things.values()], 1)
    colour, varies = (np.array([getattr(thing, key) for thing in things.values()]) for key in ("colour", "varies"))
    shade = np.concatenate([thing.shade() if thing.shaded else np.ones(len(thing.triangles)) for thing in things.values()])
    waves = 6 * np.random.default_rng(seed).normal(size=(3, 3))

    def paint(triangle, weights):
        place = np.einsum("nk,nkd->nd", weights, points[0][triangles[triangle]])
        painted = colour[part[triangle]] + varies[part[triangle], None] * np.sin(place @ waves)
        for number, thing in enumerate(things.values()):
            if thing.texture:
                painted[part[triangle] == number] = thing.texture(place[part[triangle] == number])
        return np.clip(painted * shade[triangle, None], 0.02, 0.98)

    samples = surface_samples(points, triangles, count)
    model = fg.bake(points, triangles, paint, samples=samples, part=part, basis=basis).model
    return Scene(model, tuple(things), part[samples.triangle], wanted)


def moved(points: np.ndarray, path: np.ndarray) -> np.ndarray:
    """Points [V, 3] that go along a path [S, 3]: [S, V, 3]."""
    return points + np.asarray(path)[:, None]


def still(points: np.ndarray) -> np.ndarray:
    """Points [V, 3] that stay: [S, V, 3]."""
    return np.repeat(points[None], FRAMES, 0)


def box(low, high, cells: int = 4):
    """A box from low to high of fine faces."""
    points, triangles = [], []
    face, cut = grid(cells)
    for axis in range(3):
        for side in (0.0, 1.0):
            at = np.empty((len(face), 3))
            at[:, axis], at[:, (axis + 1) % 3], at[:, (axis + 2) % 3] = side, face[:, 0], face[:, 1]
            triangles.append((cut if side else cut[:, ::-1]) + sum(map(len, points)))
            points.append(at)
    return np.asarray(low) + np.concatenate(points) * np.subtract(high, low), np.concatenate(triangles)


def limb(start, end, radius: float):
    """An ellipsoid from start to end."""
    points, triangles = sphere(12)
    along = np.subtract(end, start)
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    z = along / length
    x = np.cross(np.broadcast_to([0.0, 1, 0], z.shape), z)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    axes = np.stack([x * radius, np.cross(z, x) * radius, z * length * 0.55], -2)
    return np.einsum("vk,skd->svd", points, axes) + 0.5 * np.add(start, end)[:, None], triangles


def turning(points, angles, axis: int):
    """Points [V, 3] that turn about an axis by angles [S]: [S, V, 3]."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    out = np.repeat(np.asarray(points)[None], len(angles), 0)
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    out[..., a], out[..., b] = c * points[:, a] - s * points[:, b], s * points[:, a] + c * points[:, b]
    return out


def floor(size: float = 2.4):
    """A floor that stays: points [S, V, 3], triangles."""
    points, triangles = grid(12)
    return still((points - [0.5, 0.5, 0]) * [size, size, 1]), triangles


def _walker():
    """A figure of limbs in several colours walks over a floor; its feet stand while they carry it."""
    t = np.linspace(0, 1, FRAMES)
    hip = np.stack([-0.4 + 0.8 * t, 0 * t, 0.62 + 0.015 * np.cos(4 * np.pi * t)], 1)
    shoulder = hip + [0, 0, 0.5]
    things = {"floor": Thing(*floor(), (0.45, 0.42, 0.4), 0.08),
              "torso": Thing(*limb(hip - [0, 0, 0.05], shoulder, 0.16), (0.15, 0.3, 0.6)),
              "head": Thing(*limb(shoulder, shoulder + [0, 0, 0.3], 0.11), (0.8, 0.6, 0.5))}
    for side in (-1, 1):
        swing = side * 0.55 * np.sin(2 * np.pi * t)
        top = hip + [0, 0.1 * side, 0]
        knee = top + 0.32 * np.stack([np.sin(swing), 0 * t, -np.cos(swing)], 1)
        bent = swing - 0.5 * np.square(np.sin(np.pi * t + (0 if side > 0 else np.pi / 2)))
        foot = knee + 0.32 * np.stack([np.sin(bent), 0 * t, -np.cos(bent)], 1)
        foot[:, 2] = np.maximum(foot[:, 2], 0.03)
        hand = shoulder + [0, 0.22 * side, 0] + 0.45 * np.stack([-np.sin(swing), 0 * t, -np.cos(swing)], 1)
        things |= {f"thigh {side}": Thing(*limb(top, knee, 0.08), (0.35, 0.3, 0.28)),
                   f"shin {side}": Thing(*limb(knee, foot, 0.06), (0.3, 0.25, 0.25)),
                   f"arm {side}": Thing(*limb(shoulder + [0, 0.14 * side, 0], hand, 0.055), (0.75, 0.55, 0.45))}
    return things, tuple(name for name in things if name != "floor")


def _ball_and_box():
    """A ball rolls over a table until it touches a box."""
    t = np.linspace(0, 1, FRAMES)
    points, triangles = sphere(16)
    way = 0.325 * (1 - np.cos(np.pi * t))
    rolled = turning(points * 0.2, way / 0.2, 1)
    ball = rolled + np.stack([-0.6 + way, 0 * t, 0.2 + 0 * t], 1)[:, None]
    return {"table": Thing(*floor(1.8), (0.5, 0.35, 0.2)), "ball": Thing(ball, triangles, (0.6, 0.3, 0.25), 0.12),
            "box": Thing(still(box((0.25, -0.25, 0), (0.75, 0.25, 0.5))[0]), box((0, 0, 0), (1, 1, 1))[1], (0.55, 0.4, 0.25))}, ("ball",)


def _cloths():
    """Two cloths hang before each other and touch while they wave."""
    t = np.linspace(0, 1, FRAMES)[:, None]
    points, triangles = grid(14)
    things = {}
    for name, at, phase, colour in (("front", -0.05, 0.0, (0.6, 0.25, 0.25)), ("back", 0.05, 1.5, (0.3, 0.35, 0.6))):
        sheet = np.repeat(((points - [0.5, 0, 0]) * [1, 1, 1])[None], FRAMES, 0)[..., [0, 2, 1]]
        sheet[..., 0] += 0.25 if name == "back" else -0.15
        drop = 1 - sheet[..., 2]
        sheet[..., 1] = at + 0.16 * drop * np.sin(2 * np.pi * t + phase + 3 * sheet[..., 0])
        things[name] = Thing(sheet, triangles, colour)
    things["wall"] = Thing(still(((points - [0.5, 0, 0]) * [2, 1.3, 1])[:, [0, 2, 1]] + [0, 0.4, 0]), triangles, (0.5, 0.5, 0.5))
    return things, ("front",)


def _same_colours():
    """A ball rolls around another on a floor of the same colour, and touches it."""
    t = np.linspace(0, 1, FRAMES)
    points, triangles = sphere(16)
    angle = 1.5 + 2.5 * t
    away = 0.41 + 0.35 * (1 - np.sin(np.pi * t))
    path = np.stack([away * np.cos(angle), away * np.sin(angle), 0.2 + 0 * t], 1)
    rolled = moved(points * 0.2, path)
    grey = (0.5, 0.47, 0.44)
    return {"floor": Thing(*floor(1.8), grey, 0.03), "roller": Thing(rolled, triangles, grey, 0.03),
            "rest": Thing(still(points * 0.2 + [0, 0, 0.2]), triangles, grey, 0.03)}, ("roller",)


def _still_life():
    """A jug and a bowl stand on a table, side by side; nothing moves."""
    points, triangles = sphere(16)
    return {"table": Thing(*floor(1.8), (0.42, 0.3, 0.2)),
            "jug": Thing(still(points * [0.2, 0.2, 0.32] + [-0.15, 0, 0.31]), triangles, (0.3, 0.45, 0.5)),
            "bowl": Thing(still(points * [0.28, 0.28, 0.15] + [0.3, 0.05, 0.15]), triangles, (0.6, 0.55, 0.35))}, ("jug",)


def _lifted():
    """An arm comes, takes one of two boxes that stand on each other, and lifts it."""
    t = np.linspace(0, 1, FRAMES)
    lift = 0.4 * np.clip((t - 0.45) / 0.55, 0, 1) ** 2
    reach = 0.5 * np.clip((0.4 - t) / 0.4, 0, 1) ** 2
    corners, triangles = box((-0.2, -0.2, 0.25), (0.2, 0.2, 0.5))
    base, below = box((-0.25, -0.25, 0), (0.25, 0.25, 0.25))
    hand = np.stack([0.18 + reach, 0 * t, 0.5 + lift + 0.3 * reach], 1)
    elbow = hand + [0.45, 0, 0.25]
    return {"floor": Thing(*floor(1.8), (0.4, 0.4, 0.42)), "base": Thing(still(base), below, (0.55, 0.42, 0.3)),
            "box": Thing(moved(corners, np.stack([0 * t, 0 * t, lift], 1)), triangles, (0.5, 0.4, 0.3)),
            "arm": Thing(*limb(hand, elbow, 0.08), (0.75, 0.55, 0.45))}, ("box",)


SCENES: dict[str, Callable[[], tuple[dict[str, Thing], tuple[str, ...]]]] = {
    "walker": _walker, "ball and box": _ball_and_box, "cloths": _cloths, "same colours": _same_colours, "still life": _still_life,
    "lifted": _lifted}


def made(name: str, count: int) -> Scene:
    """One of SCENES."""
    return baked(*SCENES[name](), count)


def cameras(count: int = 8, size: tuple[int, int] = (240, 180)) -> list[fg.Camera]:
    """A ring of cameras around a scene."""
    found = []
    for k in range(count):
        angle = 2 * np.pi * k / count - 1.9
        eye = np.array([3 * np.cos(angle), 3 * np.sin(angle), 0.9 + 0.6 * (k % 3)])
        found.append(fg.Camera(*size, 1.1 * size[0], 1.1 * size[0], size[0] / 2, size[1] / 2, fg.look_at(eye, (0, 0, 0.5))))
    return found


def parts_in_view(model: fg.GaussianModel, bits: np.ndarray, camera: fg.Camera, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Where the Gaussians of `bits` cover most of a pixel, and where the others do: [h, w] bool each."""
    whole = [fg.Instance(model, np.eye(4), t, name=str(k), index=k) for k in (1, 2)]
    given = [one.part(np.flatnonzero(part)) for one, part in zip(whole, (bits, ~bits)) if part.any()]
    index = fg.render(given, camera, passes=["object_index", "alpha"])
    return (np.round(index["object_index"]) == 1) & (index["alpha"] > 0.5), (np.round(index["object_index"]) == 2) & (index["alpha"] > 0.5)


def stroke_in(mask: np.ndarray, seed: int = 0, radius: float = 4.0, tries: int = 400) -> Stroke:
    """The longest straight stroke, of many that are tried, within a mask [h, w]: as a hand draws along a thing."""
    inner = mask.copy()
    for shift in (-3, 3):
        for axis in (0, 1):
            inner &= np.roll(mask, shift, axis)
    y, x = np.nonzero(inner if inner.any() else mask)
    rng, best, length = np.random.default_rng(seed), None, -1.0
    for a, b in rng.integers(0, len(x), (tries, 2)):
        steps = np.linspace(0, 1, 60)
        along = np.stack([x[a] + (x[b] - x[a]) * steps, y[a] + (y[b] - y[a]) * steps], 1)
        reach = float(np.hypot(x[b] - x[a], y[b] - y[a]))
        if reach > length and mask[along[:, 1].astype(int), along[:, 0].astype(int)].all():
            best, length = ((x[a] + 0.5, y[a] + 0.5), (x[b] + 0.5, y[b] + 0.5)), reach
    return Stroke(tuple((float(u), float(v)) for u, v in best), radius)


def strokes(model: fg.GaussianModel, scene: Scene, view: int = 0, t: float = 1 / 3) -> list[np.ndarray]:
    """What a stroke over the wanted thing touches, and what one over the others does: [N] bool of the model."""
    camera = cameras()[view]
    seen = fg.Instance(model, np.eye(4), t).viewed(camera)
    return [touched([seen], camera, stroke_in(mask, k))[0] for k, mask in enumerate(parts_in_view(scene.model, scene.truth, camera, t))]


def overlaps(model: fg.GaussianModel, found: np.ndarray, scene: Scene, views=(1, 3, 4, 6), times=(0.05, 0.5, 0.95)) -> list[float]:
    """Intersection over union of what is found with the truth, in views and at times without strokes that show the thing."""
    result = []
    for view in views:
        for t in times:
            truth = parts_in_view(scene.model, scene.truth, cameras()[view], t)[0]
            if truth.sum() >= 60:
                mine = parts_in_view(model, found, cameras()[view], t)[0]
                result.append(float((mine & truth).sum() / (mine | truth).sum()))
    return result

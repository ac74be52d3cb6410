# SPDX-License-Identifier: GPL-3.0-or-later
"""A wall that cameras filmed, with what Clean Up is for: every Gaussian of which it is known why it is there."""
from __future__ import annotations

import dataclasses
from importlib import import_module

import numpy as np

SIDE = 41
"""Gaussians along each side of the wall, which is 2 units wide and lies at z = 0."""
WALL = SIDE * SIDE
KINDS = ("unseen", "haze", "floaters", "colours")
EACH = 6
"""Gaussians of each kind, which follow those of the wall."""


def dirty_room(fg, cameras: bool = True):
    """A model of the library `fg`: the wall, and EACH of KINDS, which lie behind it, faint before its cameras, large far beside it, and at
    its edge in another colour."""
    rng = np.random.default_rng(5)
    line = np.linspace(-1, 1, SIDE)
    x, y = (a.ravel() for a in np.meshgrid(line, line))
    colour = 0.5 + 0.2 * np.sin(3 * x) * np.cos(4 * y)
    place = [np.stack([x, y, 0 * x], 1)]
    size, opacity = [np.full((WALL, 3), (0.05, 0.05, 0.005))], [np.full(WALL, 0.95)]
    tint = [np.repeat(colour[:, None], 3, 1)]

    def add(position, scale, sigma, rgb):
        place.append(position), size.append(np.full((EACH, 3), scale)), opacity.append(np.full(EACH, sigma))
        tint.append(np.full((EACH, 3), rgb))

    around = rng.uniform(-0.6, 0.6, (EACH, 3))
    add(around * (1, 1, 0) + (0, 0, 0.4), (0.08, 0.08, 0.08), 0.9, 0.4)  # unseen
    add(around * (1, 1, 0) + (0, 0, -2.2), (0.05, 0.05, 0.05), 0.05, 0.5)  # haze
    add(np.stack([np.full(EACH, 2.4), 0.6 * np.arange(EACH) - 1.5, np.full(EACH, -0.9)], 1), (0.25, 0.25, 0.01), 0.3, 0.3)  # floaters
    line = np.linspace(-0.9, 0.9, EACH)
    add(np.stack([np.full(EACH, -1.02), line, np.full(EACH, 0.02)], 1), (0.03, 0.03, 0.03), 0.9, (0.0, 1.0, 0.0))  # colours
    position, scale, sigma, rgb = (np.concatenate(values) for values in (place, size, opacity, tint))
    eyes = [(a, b, -3.0) for a in (-0.9, -0.3, 0.3, 0.9) for b in (-0.4, 0.4)]
    rig = [fg.Camera(160, 120, 160, 160, 80, 60, fg.look_at(eye, (0.3 * eye[0] + 0.45, 0, 0), up=(0, -1, 0))) for eye in eyes]
    model = fg.GaussianModel(position=position, rotation=np.tile([1.0, 0, 0, 0], (len(position), 1)), scale=np.log(scale),
                             opacity=np.log(sigma / (1 - sigma)), features=rgb)
    viewpoint_of = import_module(f"{fg.__name__}.cameras.viewpoints").viewpoint_of
    views = tuple(viewpoint_of(camera, f"cam{k:02}", 3.0) for k, camera in enumerate(rig)) if cameras else ()
    return dataclasses.replace(model, surroundings=fg.Surroundings(cameras=views))


def rows(kind: str) -> slice:
    """Where the Gaussians of a kind are; "wall" is one, too."""
    return slice(WALL) if kind == "wall" else slice(WALL + EACH * KINDS.index(kind), WALL + EACH * (KINDS.index(kind) + 1))

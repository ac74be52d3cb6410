# SPDX-License-Identifier: GPL-3.0-or-later
"""Shapes and ways of the scenes in touching_many.py: lengths in metres, places [.., 3], moments [S] from 0 to 1."""
from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "library"))

import touching_scenes as scenes
from moving_meshes import grid, sphere

Thing = scenes.Thing
T = np.linspace(0, 1, scenes.FRAMES)
TURN = 2 * np.pi
PLANE = np.array([0.5, 0.5, 0])
"""The middle of moving_meshes.grid()."""


def path(x, y, z) -> np.ndarray:
    """A way [S, 3] of three coordinates, each a number or [S]."""
    return np.stack([x + 0 * T, y + 0 * T, z + 0 * T], 1)


AT_REST = path(0, 0, 0)


def ground(colour=(0.45, 0.42, 0.4), varies: float = 0.06, **more) -> Thing:
    """A floor."""
    return Thing(*scenes.floor(), colour, varies, **more)


def block(low, high, colour, varies: float = 0.05, way=AT_REST, cells: int = 4, **more) -> Thing:
    """A box from low to high that goes along a way."""
    points, triangles = scenes.box(low, high, cells)
    return Thing(scenes.moved(points, way), triangles, colour, varies, **more)


def egg(radii, middle, colour, varies: float = 0.05, way=AT_REST) -> Thing:
    """An ellipsoid that goes along a way without turning."""
    points, triangles = sphere(18)
    return Thing(scenes.moved(points * np.asarray(radii) + middle, way), triangles, colour, varies)


def rolling(radii, angle, way, colour, varies: float = 0.05, axis: int = 1, **more) -> Thing:
    """An ellipsoid that turns by angles [S] about an axis while it goes along a way."""
    points, triangles = sphere(18)
    return Thing(scenes.turning(points * np.asarray(radii), angle, axis) + way[:, None], triangles, colour, varies, **more)


def limb(start, end, radius: float, colour) -> Thing:
    """A limb between two ways."""
    return Thing(*scenes.limb(start, end, radius), colour)


def sheet(move: Callable, cells: int, colour, varies: float = 0.05, **more) -> Thing:
    """A cloth: move(u, v, t) gives its places [V, 3] at a moment, by where on it they are (0..1)."""
    points, triangles = grid(cells)
    u, v = points[:, 0], points[:, 1]
    return Thing(np.stack([move(u, v, t) for t in T]), triangles, colour, varies, **more)


def tube(line, radius, around: int = 12):
    """A tube along lines [S, M, 3], of a radius or of [M]: points [S, V, 3], triangles."""
    frames, count = line.shape[:2]
    along = np.gradient(line, axis=1)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    x = np.cross(np.broadcast_to([0.03, 0.05, 1.0], along.shape), along)
    x /= np.maximum(np.linalg.norm(x, axis=2, keepdims=True), 1e-6)
    y = np.cross(along, x)
    angle = np.linspace(0, TURN, around, endpoint=False)[:, None]
    wide = np.broadcast_to(radius, (count,))[:, None, None]
    points = line[:, :, None] + wide * (np.cos(angle) * x[:, :, None] + np.sin(angle) * y[:, :, None])
    i = np.arange(count - 1)[:, None] * around + np.arange(around)
    j = np.arange(count - 1)[:, None] * around + (np.arange(around) + 1) % around
    return points.reshape(frames, -1, 3), faces((i, j, i + around), (j, j + around, i + around))


def ring(radius: float, thick: float, along: int = 28, around: int = 12):
    """A torus in z = 0: points [V, 3], triangles."""
    u, v = np.meshgrid(*(np.linspace(0, TURN, n, endpoint=False) for n in (along, around)), indexing="ij")
    points = np.stack([(radius + thick * np.cos(v)) * np.cos(u), (radius + thick * np.cos(v)) * np.sin(u), thick * np.sin(v)], -1)
    i, j = np.arange(along)[:, None], np.arange(around)

    def corner(a, b):
        return (a % along) * around + b % around

    a, b, c, d = corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)
    return points.reshape(-1, 3), faces((a, b, c), (a, c, d))


def gear(teeth: int, radius: float, thick: float = 0.06, around: int = 96):
    """A gear in z = 0: points [V, 3], triangles."""
    angle = np.linspace(0, TURN, around, endpoint=False)
    reach = radius * (1 + 0.08 * np.sign(np.sin(teeth * angle)))
    rim = np.stack([reach * np.cos(angle), reach * np.sin(angle)], 1)
    top, bottom = (np.c_[rim, np.full(around, side)] for side in (thick, -thick))
    points = np.concatenate([top, bottom, [[0, 0, thick], [0, 0, -thick]]])
    i = np.arange(around)
    j = (i + 1) % around
    up, down = np.full(around, 2 * around), np.full(around, 2 * around + 1)
    sides = (i + around, j + around, j), (i + around, j, i)
    return points, faces((i, j, up), (j + around, i + around, down), *sides)


def faces(*corners) -> np.ndarray:
    """Triangles [T, 3] of which each row of corners has many."""
    return np.concatenate([np.stack(row, -1).reshape(-1, 3) for row in corners])


def checks(one, other, per_metre: float) -> Callable:
    """A texture of dice in two colours."""
    return lambda place: np.where((np.floor(place * per_metre).sum(1) % 2 == 0)[:, None], one, other)


def halves(above, below, axis: int, border: float) -> Callable:
    """A texture of one colour above a coordinate, and of another below."""
    return lambda place: np.where((place[:, axis] > border)[:, None], above, below)


def stripes(one, other, per_metre: float) -> Callable:
    """A texture of stripes across x."""
    return lambda place: np.where((np.floor(place[:, 0] * per_metre) % 2 == 0)[:, None], one, other)

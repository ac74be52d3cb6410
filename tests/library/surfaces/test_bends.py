# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians where a baked surface bends: they fit all of what they cover, and outlines hide nothing beside them."""
from __future__ import annotations

import numpy as np
from moving_meshes import grid, normals

import fastgs_blender as fg

SIDES = 16
SPEED, SCALE = 0.125, 40
"""Units a frame of the column and, the other way, of the wall; pixels of a unit."""


def column_before_a_wall():
    """(points [V, 3], whether each is the column's, triangles): a column of 16 sides along z, whose faces bend by 22.5 degrees."""
    a = 2 * np.pi * np.arange(SIDES) / SIDES
    ring = np.stack([0.5 * np.cos(a), 0.5 * np.sin(a), 0 * a], 1)
    i = np.arange(SIDES)
    j = (i + 1) % SIDES
    sides = np.concatenate([np.stack([i, j, j + SIDES], 1), np.stack([i, j + SIDES, i + SIDES], 1)])
    wall = np.array([[-2.0, 1.5, -0.5], [2.0, 1.5, -0.5], [2.0, 1.5, 0.5], [-2.0, 1.5, 0.5]])
    points = np.concatenate([ring - [0, 0, 0.5], ring + [0, 0, 0.5], wall])
    return points, np.arange(len(points)) < 2 * SIDES, np.concatenate([sides, 2 * SIDES + np.array([[0, 1, 2], [0, 2, 3]])])


def test_vectors_change_at_the_outline_and_not_beside_it():
    """The column goes right and the wall behind it left: at its outline each pixel has the vector of what its centre shows."""
    points, column, triangles = column_before_a_wall()
    way = np.where(column, SPEED, -SPEED)[:, None] * [1, 0, 0]
    model, _ = fg.bake(np.stack([points + frame * way for frame in range(4)]), triangles, count=10_000)
    pose = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 3], [0, 0, 0, 1]])
    off = []
    for shift in np.arange(0, 1, 0.1):
        camera = fg.Camera(64, 8, SCALE, SCALE, 32 + shift, 4, pose, orthographic=True)
        found = fg.render(model, camera, 1 / 4, passes=("alpha", "vector"))
        solid = found["alpha"] > 0.99
        assert solid.mean() > 0.97
        x = (np.arange(64) + 0.5 - camera.cx) / SCALE - SPEED
        truth = np.where(np.abs(x) < 0.5, SPEED, -SPEED) * SCALE
        off.append(np.abs(-found["vector"][..., 2] - truth)[solid].mean())
    assert np.mean(off) < 0.055  # 0.0501; 0.11 if they lie flat on their triangles


def test_gaussians_are_planes_through_the_surface_that_they_cover():
    """At a ridge of 20 degrees they lean to the mean of both sides and lie below it; away from it they lie in their triangles."""
    points, triangles = grid(2)
    slope = np.tan(np.radians(10))
    points[:, 2] = -slope * np.abs(points[:, 0] - 0.5)
    model, _ = fg.bake(points[None], triangles, count=2000)
    seen, width = fg.slice_model(model, 0), np.exp(model.scale[:, :2].max(1))
    away, up = np.abs(seen.position[:, 0] - 0.5) / width, normals(seen)
    tilt = np.degrees(np.arccos(np.abs(up[:, 2])))
    below = -slope * np.abs(seen.position[:, 0] - 0.5) - seen.position[:, 2]
    ridge, far = (away < 0.25) & (np.abs(seen.position[:, 1] - 0.5) < 0.4), away > 4
    assert ridge.sum() > 5 and far.sum() > 500
    assert tilt[ridge].mean() < 4 and np.abs(tilt[far] - 10).max() < 0.1
    assert 0.05 < (below / width)[ridge].mean() / np.sin(np.radians(20)) < 0.4 and np.abs(below[far]).max() < 1e-4

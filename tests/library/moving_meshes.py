# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes that move by formulas, so that tests know where their surfaces are at any time."""
import numpy as np

CUBE = np.array([[x, y, z] for x in (-.5, .5) for y in (-.5, .5) for z in (-.5, .5)])
CUBE_TRIANGLES = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
                           [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])


def turn(angle):
    """Rotation about a slanted axis [3, 3]."""
    axis = np.array([1, 2, 3]) / np.sqrt(14)
    x = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle) * -x + (1 - np.cos(angle)) * x @ x


def grid(n):
    """A unit square of n x n cells: points [V, 3] in z = 0, triangles."""
    x, y = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1))
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    triangles = np.concatenate([np.stack([i, i + 1, i + n + 2], 1), np.stack([i, i + n + 2, i + n + 1], 1)])
    return np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1), triangles


def sphere(n):
    """A unit sphere: the grid, rolled up and drawn together at the poles; normals outwards."""
    points, triangles = grid(n)
    a, b = 2 * np.pi * points[:, 0], np.pi * (points[:, 1] - 0.5)
    return np.stack([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)], 1), triangles


def normals(model_slice):
    """The short axes [N, 3] of sliced Gaussians."""
    w, x, y, z = model_slice.rotation.T
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], 1)

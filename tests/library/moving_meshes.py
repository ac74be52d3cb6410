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


def tube(n=40, m=28, radius=0.15):
    """A closed tube along x, one long: points [V, 3], triangles."""
    along, around = np.linspace(0, 1, n), np.linspace(0, 2 * np.pi, m, endpoint=False)
    wide = radius * np.sqrt(np.clip(1 - (2 * along - 1) ** 8, 0, 1))
    points = np.stack([np.repeat(along - .5, m), (wide[:, None] * np.cos(around)).ravel(), (wide[:, None] * np.sin(around)).ravel()], 1)
    i = np.arange(n - 1)[:, None] * m + np.arange(m)
    j = np.arange(n - 1)[:, None] * m + (np.arange(m) + 1) % m
    return points, np.concatenate([np.stack(corners, -1).reshape(-1, 3) for corners in ((i, j, i + m), (j, j + m, i + m))])


def twisting(t):
    """A bar that is twisted one way and back: points, triangles."""
    points, triangles = tube()
    angle = 3 * np.sin(2 * np.pi * t) * points[:, 0]
    x, y, z = (points * [1, 1.6, 0.6]).T
    return np.stack([x, np.cos(angle) * y - np.sin(angle) * z, np.sin(angle) * y + np.cos(angle) * z], 1), triangles


def swimming(t):
    """A fish that swims along x: points, triangles."""
    points, triangles = tube()
    x = points[:, 0]
    beat = 0.12 * (x + 0.7) * np.sin(2 * np.pi * (1.2 * x - 2 * t))
    return points * [1, 1, 1.4] + np.stack([0.5 * t + 0 * x, beat, 0 * x], 1), triangles


def walking(t):
    """A body whose arms and legs swing: points, triangles."""
    points, triangles = tube(30, 20, 0.5)
    swing, shapes = np.sin(2 * np.pi * t), [points[:, [1, 2, 0]] * [.36, .24, .7] + [0, 0, 1.2]]
    for side in (-1, 1):
        arm, leg = ((.11, .11, .62), (.36 * side, 0, 1.2), 1.5, .9), ((.15, .15, .8), (.12 * side, 0, .42), .82, -.7)
        for size, place, hinge, angle in (arm, leg):
            cos, sin = np.cos(side * angle * swing), np.sin(side * angle * swing)
            x, y, z = (points[:, [1, 2, 0]] * size + place - [0, 0, hinge]).T
            shapes.append(np.stack([x, cos * y - sin * z, sin * y + cos * z + hinge], 1))
    return np.concatenate(shapes), np.concatenate([triangles + i * len(points) for i in range(len(shapes))])


def waving(t):
    """A flag: points, triangles."""
    points, triangles = grid(30)
    x = 1.5 * points[:, 0]
    return np.stack([x, points[:, 1], 0.12 * x * np.sin(2 * np.pi * (1.1 * x - 2 * t))], 1), triangles


def distances(points, corners, near=40):
    """Distances [P] of points [P, 3] from the nearest of triangles [T, 3, 3], looked for among those with the nearest middles."""
    middles, out = corners.mean(1), np.empty(len(points))
    for i, p in enumerate(points):
        a, b, c = np.moveaxis(corners[np.argpartition(((middles - p) ** 2).sum(1), min(near, len(corners) - 1))[:near]], 1, 0)
        normal = np.cross(b - a, c - a)
        area = np.maximum((normal ** 2).sum(1), 1e-30)
        u, v = ((np.cross(*pair) * normal).sum(1) / area for pair in ((b - a, p - a), (p - a, c - a)))
        plane = np.abs(((p - a) * normal).sum(1)) / np.sqrt(area)
        sides = [_from_side(p, *side) for side in ((a, b), (b, c), (c, a))]
        out[i] = np.where((u >= 0) & (v >= 0) & (u + v <= 1), plane, np.min(sides, 0)).min()
    return out


def _from_side(p, a, b):
    share = np.clip(((p - a) * (b - a)).sum(1) / np.maximum(((b - a) ** 2).sum(1), 1e-30), 0, 1)
    return np.linalg.norm(p - a - share[:, None] * (b - a), axis=1)

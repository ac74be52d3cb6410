# SPDX-License-Identifier: GPL-3.0-or-later
"""Two captures of one place, made by formulas: boxes on a floor, of which each capture has a part, laid with other Gaussians."""
import numpy as np


def place(seed, boxes=9):
    """Points [N, 3] on the surfaces of a floor and of boxes on it, within 3 x 2 x 1.2 of the origin, and their normals."""
    rng = np.random.default_rng(seed)
    floor = np.stack([rng.uniform(-3, 3, 4000), rng.uniform(-2, 2, 4000), np.zeros(4000)], 1)
    points, normals = [floor], [np.tile([0.0, 0, 1], (4000, 1))]
    for _ in range(boxes):
        middle, size = np.array([rng.uniform(-2.5, 2.5), rng.uniform(-1.6, 1.6), 0]), rng.uniform(0.2, 0.6, 3)
        x, axis = rng.uniform(-1, 1, (1000, 3)), rng.integers(0, 3, 1000)
        x[np.arange(1000), axis] = np.sign(x[np.arange(1000), axis])
        points.append(x * size + middle + [0, 0, size[2]])
        normals.append(np.eye(3)[axis])
    return np.concatenate(points), np.concatenate(normals)


def colours(points):
    """sRGB colours [N, 3] that differ from place to place."""
    return np.clip(0.5 + 0.3 * np.sin(points @ np.array([[2, 0.6, 0], [0.4, 2.6, 1], [1.4, 0, 2]])), 0.05, 0.95)


def part(fg, seed, low, high, noise=0.005, count=None, **options):
    """The model of what lies between two x of a place, with noise of its own in every Gaussian's position."""
    points, normals = place(seed)
    rng = np.random.default_rng([seed, int(10 * low + 100), int(10 * high + 100)])
    rows = np.flatnonzero((points[:, 0] >= low) & (points[:, 0] <= high))
    rows = rng.permutation(rows)[:count]
    points, normals = points[rows], normals[rows]
    n = len(rows)
    turn = np.zeros((n, 4))  # from z to the normal
    turn[:, 0], turn[:, 1:] = 1 + normals[:, 2], np.cross(np.tile([0.0, 0, 1], (n, 1)), normals)
    fields = dict(position=points + noise * rng.normal(size=(n, 3)), rotation=turn, scale=np.log(np.tile([0.05, 0.05, 0.008], (n, 1))),
                  opacity=np.full(n, 4.0), features=np.clip(colours(points) + 0.02 * rng.normal(size=(n, 3)), 0, 1))
    return fg.GaussianModel(**(fields | options))


def motion(rng, angle, far, scale=1.0):
    """A similarity [4, 4] about a random axis, by radians."""
    axis, move = rng.normal(size=3), rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    x = np.cross(np.eye(3), axis)
    out = np.eye(4)
    out[:3, :3] = scale * (np.eye(3) - np.sin(angle) * x + (1 - np.cos(angle)) * x @ x)
    out[:3, 3] = far * move / np.linalg.norm(move)
    return out


def off(matrix, points):
    """Mean distance by which a matrix [4, 4] moves points [N, 3]: of an alignment after the motion that it should undo, its error."""
    return float(np.linalg.norm(points @ matrix[:3, :3].T + matrix[:3, 3] - points, axis=1).mean())


def swinging(fg, period, frames=60, fps=25.0, n=120, seed=0, **options):
    """A cloud that moves with a known period, in frames."""
    rng = np.random.default_rng(seed)
    basis = fg.Fourier(order=2, scale=frames / period)
    fields = dict(position=rng.uniform(-1, 1, (n, 3)), rotation=np.tile([1.0, 0, 0, 0], (n, 1)), scale=np.full((n, 3), -2.0),
                  opacity=np.full(n, 3.0), features=rng.uniform(size=(n, 3)), motion=0.25 * rng.normal(size=(n, 4, 3)), basis=basis,
                  clip=fg.Clip(frames, fps))
    return fg.GaussianModel(**(fields | options))

# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that make surfaces from depths: carving a volume of distances, and finding the Gaussians around points."""
from __future__ import annotations

import numpy as np

from ...util.threads import ranges, run
from .. import asserts
from .jit import inline, kernel


def carve(depths: np.ndarray, slopes: np.ndarray, poses: np.ndarray, low: np.ndarray, voxel: float, shape: tuple[int, int, int],
          reach: float, agree: int, progress=None) -> np.ndarray:
    """SurfaceBackend.carve()."""
    asserts.carve(depths, slopes, poses, low)
    out = np.empty(shape, np.float32)
    args = depths, slopes, np.ascontiguousarray(poses, np.float64), low.astype(np.float64), float(voxel)
    run(lambda begin, end: _carve(*args, reach, agree, begin, end, out), ranges(shape[0], 4), progress)
    return out


@kernel
def _carve(depths, slopes, poses, low, voxel, reach, agree, begin, end, out):
    views, height, width = depths.shape
    best = np.empty(agree, np.float64)
    for i in range(begin, end):
        for j in range(out.shape[1]):
            for k in range(out.shape[2]):
                x, y, z = low[0] + i * voxel, low[1] + j * voxel, low[2] + k * voxel
                best[:] = -reach
                for v in range(views):
                    pose = poses[v]
                    depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
                    column = int(np.floor(pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]))
                    row = int(np.floor(pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]))
                    if column < 0 or row < 0 or column >= width or row >= height:
                        continue
                    d = (depths[v, row, column] - depth) * slopes[v, row, column]
                    if d > best[agree - 1]:  # not where NaN
                        _keep(best, min(d, reach), agree)
                        if best[agree - 1] >= reach:
                            break
                out[i, j, k] = best[agree - 1]


@inline
def _keep(best, d, count):
    """Put a number into the `count` largest, which fall."""
    place = count - 1
    while place > 0 and best[place - 1] < d:
        best[place] = best[place - 1]
        place -= 1
    best[place] = d


def around(points: np.ndarray, normals: np.ndarray, places: np.ndarray, axes: np.ndarray, weights: np.ndarray, reach: float,
           count: int) -> tuple[np.ndarray, np.ndarray]:
    """SurfaceBackend.around()."""
    asserts.around(points, normals, places, axes, weights)
    low = places.min(0) if len(places) else np.zeros(3)
    cell = np.floor((places - low) / reach).astype(np.int64)
    shape = cell.max(0, initial=0) + 1
    key = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    order = np.argsort(key, kind="stable")
    number, weight = np.full((len(points), count), -1, np.int64), np.zeros((len(points), count))
    args = points, normals, places[order], axes[order], weights[order], key[order], low, shape, float(reach)
    run(lambda begin, end: _around(*args, begin, end, number, weight), ranges(len(points), 4096))
    return np.where(number >= 0, order[number], -1), weight


@kernel
def _around(points, normals, places, axes, weights, keys, low, shape, reach, begin, end, number, weight):
    count, heaviest = number.shape[1], 1.05 * weights.max()
    for p in range(begin, end):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        ci, cj = int(np.floor((x - low[0]) / reach)), int(np.floor((y - low[1]) / reach))
        ck = int(np.floor((z - low[2]) / reach))
        farthest = reach * reach  # beyond it no Gaussian weighs more than those that are found
        for i in range(max(ci - 1, 0), min(ci + 2, shape[0])):
            for j in range(max(cj - 1, 0), min(cj + 2, shape[1])):
                first, last = max(ck - 1, 0), min(ck + 1, shape[2] - 1)
                row = (i * shape[1] + j) * shape[2]
                if last < first:
                    continue
                n = np.searchsorted(keys, row + first)
                while n < len(keys) and keys[n] <= row + last:
                    dx, dy, dz = places[n, 0] - x, places[n, 1] - y, places[n, 2] - z
                    square = dx * dx + dy * dy + dz * dz
                    if square < farthest:
                        cosine = axes[n, 0] * normals[p, 0] + axes[n, 1] * normals[p, 1] + axes[n, 2] * normals[p, 2]
                        w = weights[n] * np.exp(-4 * square / (reach * reach)) * (cosine * cosine + 0.05)
                        if w > weight[p, count - 1]:
                            place = count - 1
                            while place > 0 and weight[p, place - 1] < w:
                                weight[p, place], number[p, place] = weight[p, place - 1], number[p, place - 1]
                                place -= 1
                            weight[p, place], number[p, place] = w, n
                            if weight[p, count - 1] > 0:
                                farthest = min(farthest, 0.25 * reach * reach * np.log(heaviest / weight[p, count - 1]))
                    n += 1

# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws the triangles of a holdout (rendering/holdout.py) on a GPU.

The CPU cuts them off at the near plane, lists them by tile, and computes in float64 what is linear over the picture: their edges and their
nearness.  So corners that lie far beside the picture lose no digits.
"""
import numpy as np

from ...cameras.camera import Camera
from ...rendering.holdout import points
from ..cpu import holdout as cpu
from .device import Array, Device
from .lists import grid_of
from .shaders import FARTHEST, TILE


class Occluder:
    """Triangles [F, 3, 3] in the world before a camera."""

    def __init__(self, device: Device, triangles: np.ndarray, camera: Camera) -> None:
        self.device, self.camera = device, camera
        found = cpu.Occluder.of(triangles, camera)
        starts, ids = found.lists
        self.lists = device.array(np.concatenate([starts + len(starts), ids]).astype(np.uint32))
        self.triangles = device.array(linear(found.screen, camera))

    def cover(self, grid: tuple[int, int, int, int], top: int, bottom: int) -> Array:
        """Depths of the nearest triangles in the points of each pixel, the nearest first, FARTHEST where there is none:
        [bottom - top, w, SAMPLES], for a grid of tiles that begins at that of the row `top` of the image."""
        x0, y0, width, _ = self.camera.window
        columns, first = grid[2], (grid[1] - grid_of(self.camera.window)[1]) * grid[2]
        depths = self.device.empty((bottom - top, width, len(points())))
        job = [[x0, top, x0 + width, bottom], list(grid), [top, first, self.camera.orthographic, 0],
               [min(self.camera.far, FARTHEST), float(x0), float(y0), 0.0], points().astype(np.float32)]
        self.device.run("cover", columns * grid[3], job, self.lists, self.triangles, depths, groups=True)
        return depths


def surface(device: Device, triangles: np.ndarray, camera: Camera) -> np.ndarray:
    """PictureBackend.surface(), in bands of rows of tiles where the whole is too large."""
    _, y0, width, height = camera.window
    occluder, (left, top, columns, rows) = Occluder(device, triangles, camera), grid_of(camera.window)
    at_once = max(device.binding // (4 * len(points()) * TILE * width), 1)
    out = np.empty((height, width), np.float32)
    for row in range(0, rows, at_once):
        number = min(at_once, rows - row)
        first, last = max(y0, (top + row) * TILE), min(y0 + height, (top + row + number) * TILE)
        cover = occluder.cover((left, top + row, columns, number), first, last)
        nearest = device.empty((last - first, width))
        device.run("nearest", nearest.shape[0] * width, [[nearest.shape[0] * width, 0, 0, 0]], cover, nearest)
        out[first - y0:last - y0] = nearest.numpy()
    return np.where(out < FARTHEST, out, np.float32(np.inf))


def linear(screen: np.ndarray, camera: Camera) -> np.ndarray:
    """What wgsl/cover.wgsl wants of triangles on the screen [T, 3, 3] (kernels/cpu/holdout.py): [T, 4, 4] float32.

    An edge's values are pixels, by the sum of how much they change in x and in y.
    """
    x, y = screen[..., 0] - camera.window[0], screen[..., 1] - camera.window[1]
    (ux, vx), (uy, vy) = ((np.roll(each, -1, 1), np.roll(each, -2, 1)) for each in (x, y))
    a, b = uy - vy, vx - ux
    c: np.ndarray = ux * vy - vx * uy
    area: np.ndarray = c.sum(1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        edges = np.stack([a, b, c], -1) * (np.sign(area)[:, None] / (np.abs(a) + np.abs(b)))[..., None]
        corners = 1 / screen[..., 2] if camera.orthographic else screen[..., 2]
        plane = np.stack([(each * corners).sum(1) for each in (a, b, c)], -1) / area[:, None]
    out = np.zeros((len(screen), 4, 4), np.float32)
    out[:, :3, :3], out[:, 3, :3] = edges, plane
    out[:, 0, 3], out[:, 1, 3] = screen[..., 2].min(1), screen[..., 2].max(1)
    out[(area == 0) | ~np.isfinite(out).all((1, 2)), :3, :3] = (0, 0, -1)  # is nowhere
    return out

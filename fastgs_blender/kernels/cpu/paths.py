# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures how far splats move during an exposure, and decides how many samples each tile needs (expose.py).

A few pictures' splats, at the beginning, the middle and the end of the exposure and through the rim of the lens, tell how far each
moves over the tiles it touches, in units of its own size.  Each tile uses the samples up to the level at which nothing in it moves by
more than STEP from one sample to the next.
"""
from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...cameras.camera import Camera
from ...rendering.exposure import Exposure
from .jit import inline, kernel
from .raster import TILE

STEP = 1.5
"""Standard deviations by which a splat may move from one sample to the next: a sum of Gaussians so far apart is even to 3e-4."""
ENDS = 4.0
"""Steps for the path of an opaque splat over one standard deviation, growing with the roots of path and opacity: the sum then has the
streak's ends to 3e-3."""
STILL = 0.2
"""Standard deviations of movement up to which the middle of the exposure stands for all of it."""
SHARP = 16.0
"""Samples by square pixel of its blur (radius squared) that make the edge of a mesh, which is sharper than any splat, even to 0.02."""
FADE = 4.0
"""Standard deviations to whose movement a change of opacity from 0 to 1 is equal."""
AROUND = 0.25
"""Share of the window's longer side by which snapshots reach beyond it."""
FAINT = 0.05
"""Opacity below which it does not matter that a splat comes into the picture, or leaves it, while the shutter is open."""


@dataclass(frozen=True, eq=False)
class Paths:
    """The paths of the G Gaussians of all instances during an exposure.

    box     [G, 4] float32: left, top, right, bottom of what its splat covers; right < left where it is never seen
    shift   [G, 2] float32: how far it moves while the shutter is open, in pixels
    blur    [G] float32: radius of the disc over which the lens spreads it, in pixels
    needed  [G] float32: into how many steps the exposure should be divided for it; inf: not known
    """

    box: np.ndarray
    shift: np.ndarray
    blur: np.ndarray
    needed: np.ndarray


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The splats of all G Gaussians at one time and through one point of the lens; zeros for those that are not seen.

    seen     [G] bool
    mean     [G, 2] centres in pixels
    size     [G, 2] half the boxes in which they are drawn
    root     [G, 3] the triangle L11, L21, L22 of the inverse covariance's root
    opacity  [G]
    """

    seen: np.ndarray
    mean: np.ndarray
    size: np.ndarray
    root: np.ndarray
    opacity: np.ndarray

    @classmethod
    def nothing(cls, total: int) -> Snapshot:
        """One in which nothing is seen yet."""
        mean, size, root = (np.zeros((total, width), np.float32) for width in (2, 2, 3))
        return cls(np.zeros(total, bool), mean, size, root, np.zeros(total, np.float32))

    def way_to(self, other: Snapshot, shift) -> np.ndarray:
        """How far [G] it is from this look to another, in standard deviations: movement, change of size, and of opacity."""
        a, b = (np.hypot(look.root[:, 0] * shift[:, 0] + look.root[:, 1] * shift[:, 1], look.root[:, 2] * shift[:, 1])
                for look in (self, other))
        size = 3 * np.abs(np.log(np.where(self.seen & other.seen, np.divide(
            other.size.T, self.size.T, out=np.ones_like(self.size.T), where=self.size.T > 0), 1))).max(0)
        both = np.maximum(a, b) + size + FADE * np.abs(other.opacity - self.opacity)
        alone = (self.seen ^ other.seen) & (np.maximum(self.opacity, other.opacity) > FAINT)
        return np.where(self.seen & other.seen, both, np.where(alone, np.inf, 0)).astype(np.float32)


def measure(exposure: Exposure, instances: list, camera: Camera, snapshot: Callable[..., Snapshot]) -> Paths:
    """The Paths of all Gaussians; snapshot(instances, camera, total) gives the Snapshot of all of them.

    It is taken of more than the picture: what is not seen from where it comes into the picture would need all samples there.
    """
    times, rim = _snapshot_places(exposure)
    total, margin, (x, y, width, height) = sum(len(each.model) for each in instances), int(AROUND * max(camera.window[2:])), camera.window
    looks = []
    for place in times + rim:
        moved, eye = exposure.scene(instances, camera, *place)
        looks.append(snapshot(moved, replace(eye, width=eye.width + 2 * margin, height=eye.height + 2 * margin, cx=eye.cx + margin,
                                             cy=eye.cy + margin, window=(x, y, width + 2 * margin, height + 2 * margin)), total))
    middle = looks[len(times) // 2]
    low, high = np.full((total, 2), np.inf, np.float32), np.full((total, 2), -np.inf, np.float32)
    for look in looks:
        low[look.seen] = np.minimum(low, look.mean - look.size)[look.seen]
        high[look.seen] = np.maximum(high, look.mean + look.size)[look.seen]
    path, blur, area = (np.zeros(total, np.float32) for _ in range(3))
    for a, b in itertools.pairwise(looks[:len(times)]):
        path += a.way_to(b, b.mean - a.mean)
    for look in looks[len(times):]:
        shift = look.mean - middle.mean
        blur = np.maximum(blur, np.where(look.seen & middle.seen, np.linalg.norm(shift, axis=1), 0))
        area = np.maximum(area, middle.way_to(look, shift))
    first, last = looks[0], looks[len(times) - 1]
    shift = np.where((first.seen & last.seen)[:, None], last.mean - first.mean, 0)
    reach = (1.1 * blur + 1)[:, None]
    strength = np.max([look.opacity for look in looks], 0)
    lens = _steps(2 * area, 3 * area**2, strength)
    if exposure.aperture and exposure.aperture.blades % 2:
        lens = np.where(lens > 1, 2 * lens, 1)  # a point has none opposite, which would undo what it does to first order
    needed = np.maximum(_steps(path, path / STEP, strength), lens)
    return Paths(np.concatenate([low - reach, high + reach], 1) - np.float32(margin), shift, blur, needed)


def levels_of(exposure: Exposure, paths: Paths, camera, holdout, grid) -> np.ndarray:
    """Up to which level [tiles] each tile of a grid uses the samples; holdout: triangles, or None."""
    levels = np.zeros(grid[2] * grid[3], np.int32)
    for box, needed in [(paths.box, paths.needed)] + ([] if holdout is None else [_edges(exposure, holdout, camera)]):
        paint(box, np.ceil(np.log2(np.clip(needed, 1, 1 << exposure.levels))).astype(np.int32), *grid, levels)
    return levels


def _steps(path: np.ndarray, even: np.ndarray, strength: np.ndarray | float = 1.0) -> np.ndarray:
    """Into how many steps an exposure should be divided for paths of this length, of which so many make an even streak; strength: the
    opacity of what moves."""
    return np.where(path > STILL, np.maximum(even, ENDS * np.sqrt(path * strength)), 1)


def _snapshot_places(exposure: Exposure) -> tuple[list, list]:
    """(time, point of the lens) of the few snapshots from which paths are measured: over the exposure through the middle of the lens,
    and through two points of its rim."""
    lens = exposure.aperture
    return ([(t, (0.0, 0.0)) for t in ((0.0, 0.5, 1.0) if exposure.moves else (0.5,))],
            [(0.5, (lens.radius / lens.ratio, 0.0)), (0.5, (0.0, lens.radius))] if lens else [])


def _edges(exposure: Exposure, holdout, camera) -> tuple[np.ndarray, np.ndarray]:
    """Of the triangles of a holdout, as of splats: the boxes [T, 4] that they touch, and into how many steps [T] each needs the exposure
    divided; a step is about a pixel, over which an edge is soft anyway."""
    times, rim = _snapshot_places(exposure)
    corners = []
    for time, point in times + rim:
        eye, triangles = exposure.scene([], camera, time, point)[1], exposure.holdout(holdout, time)
        triangles = np.zeros((0, 3, 3)) if triangles is None else triangles
        view = eye.local(triangles)
        corners.append(eye.pixels(np.where(view[..., 2:] > eye.near, view, np.nan)))
    if len({found.shape for found in corners}) > 1:  # other triangles at another time
        corners = [np.concatenate(corners)]
        needed = np.full(len(corners[0]), np.inf, np.float32)
    else:
        path = sum((np.linalg.norm(b - a, axis=-1).max(-1, initial=0) for a, b in itertools.pairwise(corners[:len(times)])),
                   np.zeros(len(corners[0])))
        middle = corners[len(times) // 2]
        blur = np.max([np.linalg.norm(found - middle, axis=-1).max(-1, initial=0) for found in corners[len(times):]] or [0 * path], 0)
        needed = np.maximum(_steps(path, path / STEP), _steps(2 * blur, SHARP * blur**2))
    box = np.concatenate([np.min(corners, (0, 2)), np.max(corners, (0, 2))], -1)
    return np.where(np.isnan(box), [-1e6, -1e6, 1e6, 1e6], box).astype(np.float32), np.where(np.isnan(needed), np.inf, needed)


@inline
def _tiles(boxes, i, left, top, columns, rows):
    """First and last column, first and last row of the tiles that a box touches."""
    return (max(int(max(boxes[i, 0], -1e6)) // TILE - left, 0), min(int(min(boxes[i, 2], 1e6)) // TILE - left, columns - 1),
            max(int(max(boxes[i, 1], -1e6)) // TILE - top, 0), min(int(min(boxes[i, 3], 1e6)) // TILE - top, rows - 1))


@kernel
def paint(boxes, levels, left, top, columns, rows, out):
    """Raise out [tiles] to the level of each box that touches a tile."""
    for i in range(len(boxes)):
        if not boxes[i, 0] <= boxes[i, 2]:
            continue
        first, last, upper, lower = _tiles(boxes, i, left, top, columns, rows)
        for row in range(upper, lower + 1):
            for tile in range(row * columns + first, row * columns + last + 1):
                out[tile] = max(out[tile], levels[i])


@kernel
def touch(boxes, active, left, top, columns, rows, out):
    """Mark the boxes that touch a marked tile."""
    for i in range(len(boxes)):
        if not boxes[i, 0] <= boxes[i, 2]:
            continue
        first, last, upper, lower = _tiles(boxes, i, left, top, columns, rows)
        for row in range(upper, lower + 1):
            for tile in range(row * columns + first, row * columns + last + 1):
                out[i] |= active[tile]

# SPDX-License-Identifier: GPL-3.0-or-later
"""Holdouts: opaque triangles that hide the splats behind them.

A pixel is looked at through SAMPLES points.  Each has the depth of the nearest triangle there, and a splat shows in it if its centre
lies no deeper.  So a splat's weight in a pixel is the usual one times the share of the points in which it shows.  In pixels that triangles
cover wholly, a splat shows only if its surface there (oracle.plane) lies no deeper either: large flat splats, of which floors are made,
do not reach over what stands on them.  The light that triangles stop, the pixel's `held`, is neither the splats' nor that of what lies
behind everything.
"""
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ..cameras.camera import Camera
from ..util.arguments import numbers
from ..util.errors import FastGSError

Triangles = TypeVar("Triangles", np.ndarray, np.ndarray | None)
SAMPLES = 16
"""Points in a pixel."""
NEAREST = 1e-6
"""Depth from which on triangles hide splats, where the camera's near plane does not begin later."""
EDGE = 1e-7
"""Pixels by which triangles are wider than they are, so that no gap shows between two that share an edge."""


def points() -> np.ndarray:
    """The points in a pixel [SAMPLES, 2], 0..1: Hammersley's, each in a row and in a column of its own."""
    x = np.arange(SAMPLES)
    bits = SAMPLES.bit_length() - 1
    y = sum((x >> i & 1) << (bits - 1 - i) for i in range(bits))
    return (np.stack([x, y], 1) + 0.5) / SAMPLES


def as_triangles(given: ArrayLike | None) -> np.ndarray | None:
    """What a caller gives as holdout: [F, 3, 3] float32, the corners of triangles in the world; None: nothing.

    Triangles with a corner that is not finite are left out.  Raises FastGSError for what are no triangles.
    """
    if given is None:
        return None
    found: Any = given if isinstance(given, np.ndarray) and given.dtype == np.float32 else numbers(given, "a holdout", "(F, 3, 3)")
    if found.ndim != 3 or found.shape[1:] != (3, 3):
        raise FastGSError(f"a holdout must be triangles, an array of the shape (F, 3, 3), not {found.shape}.")
    finite = np.isfinite(found).all((1, 2))
    return np.ascontiguousarray(found if finite.all() else found[finite], np.float32)


def between(before: Triangles, after: Triangles, share: float) -> Triangles:
    """Triangles between those of two moments; those of the nearer one where they are not the same ones."""
    if before is after or before is None or after is None or before.shape != after.shape:
        return after if share > 0.5 else before
    return before + np.float32(share) * (after - before)


def sample_depths(triangles: np.ndarray, camera: Camera) -> np.ndarray:
    """Depth of the nearest triangle in each point of each of the window's pixels [h, w, SAMPLES] float64, inf where there is none."""
    x0, y0, width, height = camera.window
    near, nearness = max(camera.near, NEAREST), np.zeros((height, width, SAMPLES))
    x = x0 + np.arange(width)[:, None] + points()[:, 0]
    y = y0 + np.arange(height)[:, None] + points()[:, 1]
    for corners in camera.local(triangles.astype(np.float64)):
        for part in before_the_camera(corners, near):
            depth = part[:, 2]
            scale = 1.0 if camera.orthographic else 1 / depth
            px, py = part[:, 0] * scale * camera.fx + camera.cx, part[:, 1] * scale * camera.fy + camera.cy
            columns, rows = (slice(max(int(p.min()) - 1 - o, 0), max(int(p.max()) + 2 - o, 0)) for p, o in ((px, x0), (py, y0)))
            edges = [(px[i] * py[j] - px[j] * py[i], py[i] - py[j], px[j] - px[i]) for i, j in ((1, 2), (2, 0), (0, 1))]
            area = sum(edge[0] for edge in edges)
            if area == 0:
                continue
            shares, inside = [], True
            for c, a, b in edges:
                value = (a * x[columns] + (b * y[rows])[:, None] + c) * np.sign(area)
                inside = inside & (value >= -EDGE * (abs(a) + abs(b)))
                shares.append(value / abs(area))
            found = sum(share * (d if camera.orthographic else 1 / d) for share, d in zip(shares, depth, strict=True))
            found = np.clip(1 / found if camera.orthographic else found, 1 / depth.max(), 1 / depth.min())
            box = nearness[rows, columns]
            np.maximum(box, np.where(inside, found, 0), out=box)
    with np.errstate(divide="ignore"):
        depths = 1 / nearness
    return np.where(depths <= camera.far, depths, np.inf)


def before_the_camera(corners: np.ndarray, near: float) -> list[np.ndarray]:
    """The part of a triangle [3, 3] that lies no nearer than the near plane, as triangles."""
    out: list[np.ndarray] = []
    for a, b in zip(corners, np.roll(corners, -1, 0), strict=True):
        if a[2] >= near:
            out.append(a)
        if (a[2] >= near) != (b[2] >= near):
            cut = a + (near - a[2]) / (b[2] - a[2]) * (b - a)
            cut[2] = near
            out.append(cut)
    return [np.array([out[0], out[i], out[i + 1]]) for i in range(1, len(out) - 1)]

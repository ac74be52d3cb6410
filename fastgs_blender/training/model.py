# SPDX-License-Identifier: GPL-3.0-or-later
"""The model that training begins with: its kinds from the settings, its numbers from the starting points."""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from .. import fitting
from ..appearance import RGB, SH, SH_C0, Features
from ..errors import FastGSError
from ..model import Clip, GaussianModel, Raster
from ..motion import Basis, Cosine, Fourier, Keyframes, Polynomial, Static
from ..temporal import Always, Radial

ORDERS = {"cosine": 10, "fourier": 5, "fourier+linear": 5, "paper": 5, "polynomial": 3, "keyframes": 11}
"""The usual order of each motion; about the same number of coefficients, but for STG's cubic."""
MARGIN = 0.1
"""What the Fourier series' period has to spare on either side of the clip, so that motion need not return (Gaussian-Flow)."""
PLACE = slice(6, 9)
"""The decoder's inputs that say where the camera is."""
LEAF = 96
"""Points among which nearest neighbours are looked for."""


def motion_basis(motion: str, order: int, clip: Clip) -> Basis:
    """The basis of positions for a clip; order 0 is the usual one, but at most 0.4 coefficients a frame.

    But for the printed form the clip covers just the part of the period that leaves motion free (motion-bases study):
    half-period cosines run from the first frame to the last, the Fourier series over the middle 80 % of its period.
    """
    if motion == "static" or clip.frame_count < 2:
        return Static()
    last = (clip.frame_count - 1) / clip.frame_count
    makers = {
        "cosine": lambda n: Cosine(n, 1 / last, 0.0),
        "fourier": lambda n: Fourier(n, (1 - 2 * MARGIN) / last, MARGIN),
        "fourier+linear": lambda n: Fourier(n, 1.0, 0.0, linear=True),
        "paper": Fourier,
        "polynomial": Polynomial,
        "keyframes": lambda n: Keyframes(tuple(np.linspace(0, last, max(n, 2))), "catmull-rom"),
    }
    if motion not in makers:
        raise FastGSError(f"the motion {motion!r} is unknown; there are static, {', '.join(makers)}.")
    if order:
        return makers[motion](order)
    most = max(int(fitting.SAFE * clip.frame_count), 1)
    order = ORDERS[motion]
    while motion != "paper" and order > 1 and makers[motion](order).terms > most:
        order -= 1
    return makers[motion](order)


def empty_model(settings, clip: Clip, axes: str) -> GaussianModel:
    """A model of the settings' kinds without any Gaussian.  A clip of one frame gives a model without time."""
    still = clip.frame_count < 2
    if settings.appearance == "features":
        w1 = np.random.default_rng([settings.seed, 1]).uniform(-1, 1, (6, 12)) / np.sqrt(12)
        if not settings.decoder_place:
            w1[:, PLACE] = 0
        look = Features(w1, np.zeros((3, 6)), settings.activation)  # at first every Gaussian shows its base colour
    else:
        look = RGB() if settings.appearance == "rgb" else SH(int(settings.appearance[2:]))
    return GaussianModel(
        np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, look.width)),
        basis=motion_basis(settings.motion, settings.order, clip),
        rotation_basis=Static() if still or not settings.rotation_degree else Polynomial(settings.rotation_degree),
        temporal_kind=Always() if still or settings.temporal == "always" else Radial(),
        appearance=look, raster=Raster(antialiased=settings.antialiased), clip=clip, axes=axes)


def model_from_points(points, settings, clip: Clip, axes: str, extent: float) -> GaussianModel:
    """One Gaussian a point: captures.base.Points; NaN in t: there all the time.

    Isotropic, as large as the point says, else start_size times the mean distance to the three nearest points of the same time
    (3DGS, 3.1 of the recipe), not moving.
    """
    xyz = np.asarray(points.xyz, np.float32)
    n = len(xyz)
    time = np.full(n, np.nan) if points.t is None else np.asarray(points.t, np.float64)
    timed = np.isfinite(time)
    size = np.full(n, extent)
    for moment in np.unique(np.where(timed, time, -1.0)):
        rows = np.flatnonzero(np.where(timed, time, -1.0) == moment)
        size[rows] = neighbour_distance(xyz[rows], seed=settings.seed)
    size = np.clip(np.where(np.isfinite(size), size, 0.01 * extent), 1e-5 * extent, 0.1 * extent) * settings.start_size
    if points.size is not None:
        size = np.where(np.isfinite(points.size), points.size, size)
    empty = empty_model(settings, clip, axes)
    arrays = {name: np.zeros(shape, np.float32) for name, shape in empty.shapes(n).items()}
    arrays["position"][:] = xyz
    arrays["rotation"][:, 0] = 1
    arrays["scale"][:] = np.log(size)[:, None]
    arrays["opacity"][:] = np.log(settings.start_opacity / (1 - settings.start_opacity))
    arrays["features"][:, :3] = first_colours(np.asarray(points.rgb, np.float64), empty.appearance)
    if isinstance(empty.appearance, Features):
        arrays["features"][:, 3:6] = np.asarray(points.rgb, np.float64)
    arrays["mu_tau"][:] = np.where(timed, time, 0.5)
    if isinstance(empty.temporal_kind, Radial):
        arrays["temporal"][:, 0] = -2 * np.log(np.where(timed, settings.start_life, settings.static_life))
    return replace(empty, **arrays)


def first_colours(rgb, appearance):
    """The first three columns of the features that show the colours rgb [P, 3]."""
    if isinstance(appearance, SH):
        return (rgb - 0.5) / SH_C0
    if isinstance(appearance, Features) and appearance.activation == "sigmoid":
        inside = np.clip(rgb, 0.01, 0.99)
        return np.log(inside / (1 - inside))
    return rgb


def neighbour_distance(xyz: np.ndarray, seed: int = 0, count: int = 3) -> np.ndarray:
    """Root mean squared distance [P] of each point to its `count` nearest, by k-d trees turned against each other.

    A neighbour beyond the border of a leaf of one tree is found in the other, or a slightly farther one is taken instead.
    Points that have none get inf.
    """
    xyz = np.asarray(xyz, np.float64)
    best = np.full(len(xyz), np.inf)
    if len(xyz) < 2:
        return best
    trees = 1 if len(xyz) <= LEAF else 3
    for tree in range(trees):
        turn = np.linalg.qr(np.random.default_rng([seed, 2, tree]).normal(size=(3, 3)))[0]
        turned = xyz @ turn
        for leaf in _leaves(turned, np.arange(len(xyz))):
            p = turned[leaf]
            squared = ((p[:, None] - p[None]) ** 2).sum(-1)
            k = min(count, len(leaf) - 1)
            nearest = np.partition(squared, k, axis=1)[:, :k + 1].sum(1) / max(k, 1)  # the point itself adds 0
            best[leaf] = np.minimum(best[leaf], np.sqrt(nearest) if k else np.inf)
    return best


def _leaves(xyz, rows):
    """Groups of at most LEAF rows that lie close together."""
    if len(rows) <= LEAF:
        yield rows
        return
    inside = xyz[rows]
    axis = int(np.argmax(inside.max(0) - inside.min(0)))
    half = len(rows) // 2
    order = np.argpartition(inside[:, axis], half)
    yield from _leaves(xyz, rows[order[:half]])
    yield from _leaves(xyz, rows[order[half:]])

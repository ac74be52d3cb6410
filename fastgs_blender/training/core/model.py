# SPDX-License-Identifier: GPL-3.0-or-later
"""The model that training begins with: its kinds from the settings, its numbers from the starting points."""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...model import fitting
from ...model.appearance import RGB, SH, SH_C0, Features
from ...model.gaussians import Clip, GaussianModel, Raster
from ...model.motion import Basis, Cosine, Fourier, Keyframes, Polynomial, Static
from ...model.temporal import Always, Radial
from ...util.errors import FastGSError
from ..initial.neighbours import neighbour_distance
from .hold import HELD

ORDERS = {"cosine": 10, "fourier": 5, "fourier+linear": 5, "paper": 5, "polynomial": 3, "keyframes": 11}
"""The usual order of each motion; about the same number of coefficients, but for STG's cubic."""
MARGIN = 0.1
"""What the Fourier series' period has to spare on either side of the clip, so that motion need not return (Gaussian-Flow)."""
DECODER = ("w1", "w2")
PLACE = slice(6, 9)
"""The decoder's inputs that say where the camera is."""


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


def with_arrays(template: GaussianModel, arrays: dict[str, np.ndarray], provenance: dict[str, str] | None = None) -> GaussianModel:
    """The template with what an optimiser trains instead of its own arrays: float32, not copied; the decoder's matrices among them."""
    fields = {name: array for name, array in arrays.items() if name != HELD}
    decoder = {name: fields.pop(name) for name in DECODER if name in fields}
    return replace(template, appearance=replace(template.appearance, **decoder), provenance=provenance or {}, **fields)


def lasting(model: GaussianModel) -> GaussianModel:
    """The model without the Gaussians that can never be seen."""
    peak = 1 / (1 + np.exp(-model.opacity.astype(np.float64)))
    return model.take(np.flatnonzero(peak >= model.raster.alpha_cut))


def first_colours(rgb, appearance):
    """The first three columns of the features that show the colours rgb [P, 3]."""
    if isinstance(appearance, SH):
        return (rgb - 0.5) / SH_C0
    if isinstance(appearance, Features) and appearance.activation == "sigmoid":
        inside = np.clip(rgb, 0.01, 0.99)
        return np.log(inside / (1 - inside))
    return rgb

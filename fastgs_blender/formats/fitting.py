# SPDX-License-Identifier: GPL-3.0-or-later
"""Functions that fit a model to the kinds of a poorer format: cubic motion, linear rotation, bell-shaped opacity, plain colour.

All fits are least squares over each Gaussian's own lifetime, for what it does while nobody can see it does not matter.
"""
from collections.abc import Iterator
from dataclasses import replace
from math import comb, pi, sqrt

import numpy as np

from ..model.appearance import RGB, SH, SH_C0, Changing, Features
from ..model.gaussians import GaussianModel
from ..model.motion import Basis, Polynomial, Static
from ..model.slicing import sigmoid
from ..model.temporal import Always, Radial, Window
from ..util import rotations

CHUNK = 1 << 20
"""Numbers held at once while fitting."""


def lifetimes(model: GaussianModel) -> tuple[np.ndarray, np.ndarray]:
    """Begin and end [N] of the time in which each Gaussian can be seen, within the clip, never quite empty."""
    visible = np.log(np.maximum(sigmoid(model.opacity) / model.raster.alpha_cut, 1))
    low, high = model.temporal_kind.span(visible, model.mu_tau, model.temporal)
    low, high = np.clip(low, 0, 1), np.clip(high, 0, 1)
    short = np.maximum(0.5 / model.clip.frame_count - (high - low), 0) / 2
    return low - short, high + short


def polynomial(basis: Basis, constant: np.ndarray, coefficients: np.ndarray, mu_tau: np.ndarray, centre: np.ndarray, low: np.ndarray,
               high: np.ndarray, degree: int, samples: int) -> Iterator[tuple[slice, np.ndarray, np.ndarray, np.ndarray]]:
    """Fit c_0 + sum_k c_k (t - centre)^k to constant + basis over low..high.

    constant [N, D], coefficients [N, K, D], the rest [N]; yields slices of N, the fit [n, degree + 1, D], and the true and
    fitted values [n, samples, D], a chunk at a time, float64.
    """
    u = np.linspace(-1, 1, samples)
    powers = u[:, None] ** np.arange(degree + 1)
    solve = np.linalg.pinv(powers)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    step = max(1, CHUNK // (samples * (basis.terms + 2 * constant.shape[1])))
    for start in range(0, len(constant), step):
        part = slice(start, start + step)
        t = middle[part, None] + half[part, None] * u
        weights = basis.weights(t - mu_tau[part, None].astype(np.float64) if basis.centred else t)
        true = constant[part, None] + weights @ coefficients[part].astype(np.float64)
        local = solve @ true
        shift = (middle - centre)[part]
        fit = np.zeros_like(local)
        for j in range(degree + 1):
            for k in range(j + 1):
                fit[:, k] += local[:, j] * (comb(j, k) * (-shift) ** (j - k) / half[part] ** j)[:, None]
        yield part, fit, true, powers @ local


def _samples(basis: Basis) -> int:
    """Enough to see every wave of the basis, within reason."""
    return int(min(24 + 4 * basis.max_frequency, 256))


def bell_opacity(model: GaussianModel) -> tuple[GaussianModel, list[str]]:
    """A model whose temporal opacity is Always or Radial.

    A window becomes the bell of the same centre of mass and integral; motion and rotation around mu_tau are re-expanded.
    """
    if isinstance(model.temporal_kind, (Always, Radial)):
        return model, []
    area, centre = _window_moments(model) if isinstance(model.temporal_kind, Window) else _moments(model)
    lost = ["its opacity windows with soft ends become bell curves"]
    if isinstance(model.appearance, Features) and np.any(model.features[:, 6:9]):
        lost.append("its time features count from another moment")
    low, high = lifetimes(model)
    changed = {"mu_tau": centre, "temporal": (-2 * np.log(area / sqrt(pi)))[:, None], "temporal_kind": Radial()}
    for constant, motion, name in (("position", "motion", "basis"), ("rotation", "rotation_motion", "rotation_basis")):
        basis = getattr(model, name)
        if basis.centred and basis.terms:
            c0, c = np.array(getattr(model, constant)), np.array(getattr(model, motion))
            for part, fit, _, _ in polynomial(basis, c0, c, model.mu_tau, centre, low, high, basis.terms, 24 + basis.terms):
                c0[part], c[part] = fit[:, 0], fit[:, 1:]
            changed |= {constant: c0, motion: c}
    return replace(model, **changed), lost


def _window_moments(model: GaussianModel) -> tuple[np.ndarray, np.ndarray]:
    """Integral and centre of mass [N] of Window's factor."""
    begin, end, before, after = model.temporal.T.astype(np.float64)
    before, after, root = np.exp(before), np.exp(after), 0.5 * sqrt(pi)
    flat = np.maximum(end - begin, 0)
    area = flat + root * (before + after)
    moment = 0.5 * (begin + end) * flat + root * (begin * before + end * after) + 0.5 * (after**2 - before**2)
    return area, moment / area


def _moments(model: GaussianModel, samples: int = 257) -> tuple[np.ndarray, np.ndarray]:
    """Integral and centre of mass [N] of any kind's factor over each lifetime, by samples."""
    low, high = lifetimes(model)
    total, moment = np.full(len(model), 1e-12), 0.5e-12 * (low + high)
    for u in (np.arange(samples) + 0.5) / samples:
        t = low + u * (high - low)
        factor = model.temporal_kind.factor(t, model.mu_tau, model.temporal)
        total, moment = total + factor, moment + factor * t
    return total * (high - low) / samples, moment / total


def polynomial_motion(model: GaussianModel, degree: int = 3) -> tuple[GaussianModel, list[str]]:
    """A model whose motion is static or a polynomial of this degree at most."""
    basis = model.basis
    if isinstance(basis, Static) or (isinstance(basis, Polynomial) and basis.degree <= degree):
        return model, []
    position, motion = np.empty((len(model), 3)), np.empty((len(model), degree, 3))
    error = 0.0
    samples = _samples(basis)
    fits = polynomial(basis, model.position, model.motion, model.mu_tau, model.mu_tau, *lifetimes(model), degree, samples)
    for part, fit, true, fitted in fits:
        position[part], motion[part] = fit[:, 0], fit[:, 1:]
        error += np.sum((fitted - true) ** 2)
    rms = sqrt(error / max(1, len(model) * samples))
    kind = {1: "straight", 3: "a cubic"}[degree]
    lost = f"its motion ({basis.name}, {basis.terms} terms) becomes {kind} over each lifetime, RMS error {rms:.3g} scene units"
    return replace(model, position=position, motion=motion, basis=Polynomial(degree)), [lost]


def still_rotation(model: GaussianModel) -> tuple[GaussianModel, list[str]]:
    """A model whose Gaussians do not turn: each keeps the middle of its turns over its lifetime."""
    if not model.rotation_basis.terms:
        return model, []
    rotation = np.empty((len(model), 4))
    fits = polynomial(model.rotation_basis, model.rotation, model.rotation_motion, model.mu_tau, model.mu_tau, *lifetimes(model), 0,
                      _samples(model.rotation_basis))
    for part, fit, _, _ in fits:
        rotation[part] = fit[:, 0]
    still = model.rotation_motion[:, :0]
    return replace(model, rotation=rotation, rotation_motion=still, rotation_basis=Static()), ["its rotations over time"]


def linear_rotation(model: GaussianModel) -> tuple[GaussianModel, list[str]]:
    """A model whose rotation is static or the paper's: c_0 + c_1 (t - mu_tau)."""
    basis = model.rotation_basis
    if isinstance(basis, Static) or (isinstance(basis, Polynomial) and basis.degree <= 1):
        return model, []
    rotation, turn = np.empty((len(model), 4)), np.empty((len(model), 1, 4))
    error, samples = 0.0, _samples(basis)
    fits = polynomial(basis, model.rotation, model.rotation_motion, model.mu_tau, model.mu_tau, *lifetimes(model), 1, samples)
    for part, fit, true, fitted in fits:
        rotation[part], turn[part] = fit[:, 0], fit[:, 1:]
        cosine = np.abs(np.sum(rotations.unit(true) * rotations.unit(fitted), -1))
        error += np.sum(np.degrees(2 * np.arccos(np.minimum(cosine, 1))) ** 2)
    rms = sqrt(error / max(1, len(model) * samples))
    lost = [f"its rotation ({basis.name}, {basis.terms} terms) becomes linear in time, RMS error {rms:.3g} degrees"]
    return replace(model, rotation=rotation, rotation_motion=turn, rotation_basis=Polynomial(1)), lost


def plain_colour(model: GaussianModel, keep_features: bool) -> tuple[GaussianModel, list[str]]:
    """A model whose appearance is RGB (or Features, where these may stay)."""
    if isinstance(model.appearance, Changing):
        plain = model.appearance.look
        model, lost = plain_colour(replace(model, appearance=plain, features=model.features[:, :plain.width]), keep_features)
        return model, ["its colours, which change in time, stay at their constant terms", *lost]
    appearance, f = model.appearance, model.features.astype(np.float64)
    if isinstance(appearance, SH):
        lost = [f"its view-dependent colour (SH degree {appearance.degree}) becomes its mean"] if appearance.degree else []
        return replace(model, features=np.maximum(0, 0.5 + SH_C0 * f[:, :3]), appearance=RGB()), lost
    if isinstance(appearance, Features) and not keep_features:
        hidden = np.maximum(f[:, 3:6] @ appearance.w1[:, :3].T, 0)
        rgb = f[:, :3] + hidden @ appearance.w2.T
        rgb = sigmoid(rgb) if appearance.activation == "sigmoid" else np.clip(rgb, 0, 1) if appearance.activation == "clamp" else rgb
        return replace(model, features=rgb, appearance=RGB()), ["its features and decoder become one colour a Gaussian"]
    if isinstance(appearance, (RGB, Features)):
        return model, []
    lost = [f"its appearance ({appearance.name}) becomes plain colours"]
    return replace(model, features=appearance.plain_colours(f), appearance=RGB()), lost

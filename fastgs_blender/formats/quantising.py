# SPDX-License-Identifier: GPL-3.0-or-later
"""Quantising a model: every array becomes whole numbers and powers of two to multiply them with; compressed.py packs these.

How finely a Gaussian is kept follows from how much of a picture it is.  Three whole numbers of each Gaussian say it, and everything that
a reader computes with them is exact in float64, so that all machines read the same model:

    grain    log2 of the step of its position
    weight   log2 of its share of pictures (size before a middling camera, opacity, lifetime) relative to a typical Gaussian's
    life     -log2 of the length of its lifetime

A coefficient of motion matters by what it moves within the lifetime.  With the basis' functions orthogonalised there (QR), coefficients
are rounded from the last to the first, each absorbing what rounding the later ones has moved (Babai's nearest plane); the step of
coefficient k is the position's, divided by the length of function k's own part, a table of powers of two by life and k.

A Gaussian has 24 quaternions and orders of its axes that look the same; that nearest to no rotation is kept.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from ..model.appearance import SH, momentary
from ..model.basis import Basis
from ..model.gaussians import GaussianModel
from ..model.slicing import sigmoid
from ..util import rotations
from .fitting import lifetimes

SAMPLES = 16
"""Times in a lifetime at which its motion is looked at."""
LIVES = 10
"""Values of `life`."""
FOCAL, PIXEL = 400.0, 0.55
"""A middling camera: its focal length in pixels, and the width that its pixels and the blur add to a Gaussian's."""
ROUNDING = 0.35
"""Coefficients of motion are rounded towards 0 by this instead of 0.5: zeros cost least."""
NEIGHBOURS = 64
"""Gaussians whose positions are counted from one anchor."""
SMALL_WEIGHT, LARGE_WEIGHT = -6, 6
STEPS = {"position": 0.06, "scale": 0.18, "rotation": 0.06, "opacity": 0.025, "features": 0.04, "temporal": 0.5, "mu_tau": 0.04}
"""At fineness 1 and weight 0: of the size in pixels, of ln, of a quaternion, of opacity, of colour, of ln, of a lifetime."""
BOUNDS = {"scale": (-6, -1), "rotation": (-9, -1), "opacity": (-9, -4), "features": (-9, -1), "temporal": (-5, 1), "mu_tau": (-7, 0)}
"""log2 of the least and greatest step."""


@dataclass(frozen=True)
class Steps:
    """What a file records beside whole numbers: exponents of powers of two.

    base      {array: exponent at weight 0}
    motion    [LIVES, K] of the motion's coefficients relative to the grain
    turn      [LIVES, R] of the rotation's relative to the rotation's own step
    features  [F] added to the exponent of each column
    """

    base: dict[str, int]
    motion: np.ndarray
    turn: np.ndarray
    features: np.ndarray

    def of(self, name: str, weight: np.ndarray) -> np.ndarray:
        """Exponents [N] of an array's steps."""
        return np.clip(self.base[name] - weight, *BOUNDS[name])


def quantised(model: GaussianModel, fineness: float = 1.0) -> tuple[dict[str, np.ndarray], Steps]:
    """Whole numbers by column [N, ...] of a model of finite numbers, and their steps.

    fineness  2 halves every step.
    """
    model = _canonical(model)
    low, high = lifetimes(model)
    life = np.clip(np.rint(-np.log2(np.clip(high - low, 1e-9, 1))), 0, LIVES - 1).astype(int)
    size, weight = _importance(model, high - low)
    base = {name: _exponent(step / fineness) for name, step in STEPS.items()}
    extra = np.zeros(model.features.shape[1], int)
    look = momentary(model.appearance)
    extra[:] = 1 if isinstance(look, SH) else 0
    if look.name == "features":
        extra[3:] = 1
    steps = Steps(base, np.zeros((LIVES, model.basis.terms), int), np.zeros((LIVES, model.rotation_basis.terms), int), extra)
    grain = _exponent(size) + base["position"] - weight
    columns = {"grain": grain, "weight": weight, "life": life}

    columns["mu_tau"] = _rounded(model.mu_tau, steps.of("mu_tau", weight) - life)
    mu = np.ldexp(columns["mu_tau"].astype(np.float64), steps.of("mu_tau", weight) - life)
    position = _trajectory(columns, "motion", model.basis, model.position, model.motion, model.mu_tau, mu, (low, high), grain, steps.motion)
    starts = range(0, len(model), NEIGHBOURS)
    anchor = np.array([np.median(position[at:at + NEIGHBOURS], axis=0) for at in starts]).reshape(-1, 3).astype(np.float32)
    columns["anchor"] = anchor.view("<i4").astype(np.int64)
    columns["position"] = _rounded(position - np.repeat(anchor, NEIGHBOURS, axis=0)[:len(model)], grain[:, None])
    columns["scale"] = _rounded(model.scale, steps.of("scale", weight)[:, None])
    fine = turning(columns, steps)
    rotation = _trajectory(columns, "rotation_motion", model.rotation_basis, model.rotation, model.rotation_motion, model.mu_tau, mu,
                           (low, high), fine, steps.turn)
    whole = model.rotation_basis.terms and not model.rotation_basis.centred  # else the constant term is the unit quaternion of the middle
    columns["rotation"] = _rounded(rotation if whole else rotation[:, 1:], fine[:, None])
    columns["opacity"] = _rounded(sigmoid(model.opacity), steps.of("opacity", weight))
    columns["features"] = _rounded(model.features, steps.of("features", weight)[:, None] + extra)
    for k, logarithm in enumerate(model.temporal_kind.logarithms):
        column = model.temporal[:, k]
        columns[f"temporal.{k}"] = _rounded(column, steps.of("temporal", weight)) if logarithm else column.view("<i4").astype(np.int64)
    return columns, steps


def restored(columns: dict[str, np.ndarray], steps: Steps, kinds: GaussianModel) -> dict[str, np.ndarray]:
    """The arrays of a model, float32, of columns of whole numbers; kinds: a model of its kinds."""
    weight, life, grain = (columns[name].astype(np.int32) for name in ("weight", "life", "grain"))
    life = np.clip(life, 0, LIVES - 1)
    fine = turning(columns, steps)
    rotation = _scaled(columns["rotation"], fine[:, None])
    if rotation.shape[1] == 3:
        real = np.sqrt(np.maximum(0.02, 1 - (rotation.astype(np.float64) ** 2).sum(1)))
        rotation = np.concatenate([real[:, None], rotation], 1)
    anchor = np.repeat(columns["anchor"].astype("<i4").view("<f4"), NEIGHBOURS, axis=0)[:len(weight)]
    opacity = np.clip(_scaled(columns["opacity"], steps.of("opacity", weight)), 1e-3, 1 - 1e-3)
    arrays = {
        "position": anchor + _scaled(columns["position"], grain[:, None]),
        "motion": _scaled(columns["motion"], (grain[:, None] + steps.motion[life])[..., None]),
        "scale": _scaled(columns["scale"], steps.of("scale", weight)[:, None]),
        "rotation": rotation,
        "rotation_motion": _scaled(columns["rotation_motion"], (fine[:, None] + steps.turn[life])[..., None]),
        "opacity": np.log(opacity) - np.log1p(-opacity),
        "features": _scaled(columns["features"], steps.of("features", weight)[:, None] + steps.features),
        "mu_tau": _scaled(columns["mu_tau"], steps.of("mu_tau", weight) - life),
    }
    arrays["temporal"] = np.empty((len(weight), kinds.temporal_kind.width), np.float32)
    for k, logarithm in enumerate(kinds.temporal_kind.logarithms):
        column = columns[f"temporal.{k}"]
        arrays["temporal"][:, k] = _scaled(column, steps.of("temporal", weight)) if logarithm else column.astype("<i4").view("<f4")
    return arrays


def turning(columns: dict[str, np.ndarray], steps: Steps) -> np.ndarray:
    """Exponents [N] of rotations' steps: a Gaussian that is nearly round may be turned more."""
    codes, weight = columns["scale"].astype(np.int64), columns["weight"].astype(np.int64)
    spread = np.ldexp((codes.max(1) - codes.min(1)).astype(np.float64), steps.of("scale", weight))  # ln of longest over shortest
    return steps.of("rotation", weight) - np.clip(np.frexp(spread)[1], -2, 2)


def _scaled(codes: np.ndarray, exponent: np.ndarray) -> np.ndarray:
    """codes x 2^exponent as float32."""
    powers = ((np.clip(exponent, -120, 120) + 127).astype(np.int32) << 23).view(np.float32)  # the bits of 2^exponent
    return codes.astype(np.float32) * powers


def _exponent(values) -> np.ndarray | int:
    """The nearest whole log2."""
    found = np.rint(np.log2(values)).astype(int)
    return int(found) if found.ndim == 0 else found


def _rounded(values: np.ndarray, exponent: np.ndarray) -> np.ndarray:
    return np.rint(np.ldexp(values.astype(np.float64), -exponent)).astype(np.int64)


def _importance(model: GaussianModel, life: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The size [N] that a position's step is measured in, and the weight [N]."""
    eyes = [camera.position for camera in model.surroundings.cameras] or [np.median(model.position, axis=0)]
    distance = np.min([np.linalg.norm(model.position - np.asarray(eye), axis=1) for eye in eyes], axis=0)
    distance = np.maximum(distance, 0.5 * max(float(np.median(distance)), 1e-9))
    extent = np.sort(np.exp(model.scale.astype(np.float64)), axis=1)
    pixels = np.sqrt(np.maximum(extent[:, 1] * extent[:, 2], 1e-30)) * FOCAL / distance
    pixels = np.clip(np.sqrt(pixels**2 + PIXEL**2), PIXEL, 1e4)
    share = sigmoid(model.opacity) * pixels * np.sqrt(np.clip(life, 0.02, 1))
    weight = np.clip(np.rint(np.log2(np.maximum(share / np.median(share), 1e-9))), SMALL_WEIGHT, LARGE_WEIGHT).astype(int)
    return pixels * distance / FOCAL, weight


def _canonical(model: GaussianModel) -> GaussianModel:
    """The same Gaussians with unit quaternions of constant term, and their axes in the order that is nearest to no rotation."""
    turns, orders = [], []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        matrix = np.zeros((3, 3))
        matrix[order, range(3)] = signs
        if np.linalg.det(matrix) > 0:
            turns.append(rotations.from_matrices(matrix))
            orders.append(order)
    constant = model.rotation.astype(np.float64)
    length = np.maximum(np.linalg.norm(constant, axis=1), 1e-12)[:, None]
    constant, motion = rotations.unit(constant), model.rotation_motion / length[:, None]
    choices = rotations.multiply(constant[:, None], np.array(turns)[None])
    best = np.abs(choices[..., 0]).argmax(1)
    sign = np.where(choices[np.arange(len(best)), best, :1] < 0, -1.0, 1.0)
    return replace(
        model, rotation=sign * choices[np.arange(len(best)), best],
        rotation_motion=sign[:, None] * rotations.multiply(motion, np.array(turns)[best][:, None]),
        scale=np.take_along_axis(model.scale, np.array(orders)[best], 1))


def _trajectory(columns: dict, name: str, basis: Basis, constant, coefficients, mu_true, mu, span, fine, table) -> np.ndarray:
    """Fills columns[name] with coefficients as whole numbers [N, K, D] and the table of steps; returns the constant [N, D] that fits.

    mu_true, mu  temporal centres before and after rounding; span: begin and end of lifetimes; fine: exponents [N] of the steps
    """
    n, terms = len(constant), basis.terms
    codes = np.zeros((n, terms, constant.shape[1]), np.int64)
    if not terms:
        columns[name] = codes
        return constant.astype(np.float64)
    low, high = span
    t = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, max(SAMPLES, terms + 1))
    root = np.sqrt(t.shape[1])

    def design(centre):
        return basis.weights(t - centre[:, None].astype(np.float64) if basis.centred else t)

    true = (constant[:, None] + design(mu_true) @ coefficients.astype(np.float64)) / root
    functions = np.concatenate([np.ones((n, t.shape[1], 1)), design(mu)], 2) / root
    q, r = np.linalg.qr(functions)
    wanted = q.transpose(0, 2, 1) @ true
    own = np.abs(np.einsum("nii->ni", r))
    life = columns["life"]
    for j in np.unique(life):
        table[j] = np.clip(-np.rint(np.log2(np.maximum(np.median(own[life == j, 1:], axis=0), 2.0**-30))), -30, 30)
    found = np.zeros((n, terms + 1, constant.shape[1]))
    for k in range(terms, 0, -1):
        usable = own[:, k] > 1e-9
        rest = wanted[:, k] - np.einsum("nj,njd->nd", r[:, k, k + 1:], found[:, k + 1:])
        x = np.where(usable[:, None], rest / np.where(usable, r[:, k, k], 1)[:, None], 0)
        x = np.ldexp(x, -(fine + table[life, k - 1])[:, None])
        codes[:, k - 1] = np.clip(np.sign(x) * np.floor(np.abs(x) + ROUNDING), -2**30, 2**30)
        found[:, k] = np.ldexp(codes[:, k - 1].astype(np.float64), (fine + table[life, k - 1])[:, None])
    columns[name] = codes
    return (wanted[:, 0] - np.einsum("nj,njd->nd", r[:, 0, 1:], found[:, 1:])) / r[:, 0, 0, None]

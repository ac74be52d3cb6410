# SPDX-License-Identifier: GPL-3.0-or-later
"""A model as texels: for each Gaussian a run of texels with what moves and turns it, and another with its colour.

Geometry (32 bits), in this order:

    position, logit opacity | quaternion w x y z | ln scale, mu_tau | temporal parameters, if there are any
    one texel for each term of the rotation | for x, then y, then z: the motion's terms in groups of four

Colour (16 bits): r g b | spherical harmonics, tightly: three texels hold four coefficients | base | direction | time.
Glsl.py reads what is written here.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...fastgs_blender.model.appearance import SH, SH_C0, Features
from ...fastgs_blender.model.gaussians import GaussianModel

RGB, HARMONICS, FEATURES = range(3)


@dataclass(frozen=True)
class Plan:
    """How a model's texels are laid out.

    terms, groups   terms of the motion, and texels that each axis of them takes
    turns           terms of the rotation
    temporal        whether there is a texel of temporal parameters
    look, degree    RGB, HARMONICS or FEATURES, and the harmonics' degree
    """

    terms: int
    groups: int
    turns: int
    temporal: bool
    look: int
    degree: int

    @property
    def geometry(self) -> int:
        """Texels of one Gaussian's geometry."""
        return 3 + self.temporal + self.turns + 3 * self.groups

    @property
    def colour(self) -> int:
        """Texels of one Gaussian's colour."""
        return {RGB: 1, HARMONICS: 3 * -(-((self.degree + 1) ** 2) // 4), FEATURES: 3}[self.look]


def plan(model: GaussianModel) -> Plan:
    """The layout of a model's texels."""
    look, degree = RGB, 0
    if isinstance(model.appearance, Features):
        look = FEATURES
    elif isinstance(model.appearance, SH) and model.appearance.degree:
        look, degree = HARMONICS, model.appearance.degree
    return Plan(model.basis.terms, -(-model.basis.terms // 4), model.rotation_basis.terms, model.temporal_kind.width > 0, look, degree)


def geometry(model: GaussianModel, out: np.ndarray) -> None:
    """Write the geometry texels [N, plan.geometry, 4].  What holds a number that is none gets no opacity."""
    p = plan(model)
    n = len(model)
    if not n:
        return
    out[:] = 0
    out[:, 0, :3], out[:, 0, 3] = model.position, model.opacity
    out[:, 1] = model.rotation
    out[:, 2, :3], out[:, 2, 3] = model.scale, model.mu_tau
    at = 3
    if p.temporal:
        out[:, 3, :model.temporal.shape[1]] = model.temporal
        at += 1
    out[:, at:at + p.turns] = model.rotation_motion
    at += p.turns
    for axis in range(3):
        span = out[:, at:at + p.groups].reshape(n, -1)
        span[:, :p.terms] = model.motion[:, :, axis]
        out[:, at:at + p.groups] = span.reshape(n, p.groups, 4)
        at += p.groups
    bad = ~(np.isfinite(out.reshape(n, -1)).all(1) & np.isfinite(model.features).all(1))
    out[bad] = 0
    out[bad, 0, 3] = -100


def colour(model: GaussianModel, out: np.ndarray) -> None:
    """Write the colour texels [N, plan.colour, 4]."""
    p = plan(model)
    n = len(model)
    if not n:
        return
    out[:] = 0
    features = np.nan_to_num(model.features, nan=0, posinf=0, neginf=0)
    if p.look == HARMONICS:
        out.reshape(n, -1)[:, :features.shape[1]] = features
    elif p.look == FEATURES:
        out[:, :, :3] = features.reshape(n, 3, 3)
    elif isinstance(model.appearance, SH):
        out[:, 0, :3] = np.maximum(0, 0.5 + SH_C0 * features)
    else:
        out[:, 0, :3] = features

# SPDX-License-Identifier: GPL-3.0-or-later
"""A model as the texels of two textures: for each Gaussian a run of texels with its geometry and motion, and one with its colour.

Geometry (32 bits), in this order:

    position, logit opacity | quaternion w x y z | ln scale, mu_tau | temporal parameters, if there are any
    one texel for each term of the rotation | for x, then y, then z: the motion's terms in groups of four

Colour (16 bits): the features, three in a texel; of spherical harmonics tightly: three texels hold four coefficients.
Colours that change in time have as much again for each term of their basis.
The shaders (splat.py) read it.
"""
from dataclasses import dataclass

import numpy as np

from ...model.appearance import RGB, SH, SH_C0, Changing, momentary
from ...model.gaussians import GaussianModel
from ...model.motion import Basis, Static

WIDTH = 8192
"""Texels in a row of a data texture; filled into the shaders."""


@dataclass(frozen=True)
class TexelLayout:
    """How a model's texels are laid out.

    terms, groups   terms of the motion, and texels that each axis of them takes
    turns           terms of the rotation
    temporal        whether there is a texel of temporal parameters
    colours         the code of the appearance; harmonics without degree are RGB
    degree          of the harmonics
    moment          texels of one Gaussian's constant colour, and of each of its terms
    changes         terms of the colours' basis
    """

    terms: int
    groups: int
    turns: int
    temporal: bool
    colours: int
    degree: int
    moment: int
    changes: int

    @property
    def geometry(self) -> int:
        """Texels of one Gaussian's geometry."""
        return 3 + self.temporal + self.turns + 3 * self.groups

    @property
    def colour(self) -> int:
        """Texels of one Gaussian's colour."""
        return self.moment * (1 + self.changes)


@dataclass(frozen=True)
class Place:
    """Where a model's texels begin in each texture, and how they are laid out."""

    geometry: int
    colour: int
    layout: TexelLayout


def layout_of(model: GaussianModel) -> TexelLayout:
    """The layout of a model's texels."""
    appearance, changes = momentary(model.appearance), changes_of(model).terms
    degree = getattr(appearance, "degree", 0)
    colours = RGB.code if isinstance(appearance, SH) and not degree and not changes else appearance.code
    return TexelLayout(model.basis.terms, -(-model.basis.terms // 4), model.rotation_basis.terms, model.temporal_kind.width > 0,
                       colours, degree, 3 * -(-appearance.width // 12) if colours == SH.code else appearance.width // 3, changes)


def changes_of(model: GaussianModel) -> Basis:
    """The basis of a model's colours: Static() where they do not change in time."""
    return model.appearance.basis if isinstance(model.appearance, Changing) else Static()


def write_geometry(model: GaussianModel, out: np.ndarray) -> None:
    """Write the geometry texels into out [N, layout.geometry, 4].  A Gaussian with NaN or infinity gets no opacity."""
    p = layout_of(model)
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


def write_colour(model: GaussianModel, out: np.ndarray) -> None:
    """Write the colour texels into out [N, layout.colour, 4]."""
    p = layout_of(model)
    n = len(model)
    if not n:
        return
    out[:] = 0
    appearance = momentary(model.appearance)
    features = np.nan_to_num(model.features, nan=0, posinf=0, neginf=0)
    if p.colours == SH.code:
        out.reshape(n, 1 + p.changes, -1)[..., :appearance.width] = features.reshape(n, 1 + p.changes, appearance.width)
    elif isinstance(appearance, SH):
        out[:, 0, :3] = np.maximum(0, 0.5 + SH_C0 * features)
    else:
        out[..., :3] = features.reshape(n, p.colour, 3)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Slicing: a model at one time t becomes ordinary 3D Gaussians.  Float64 array code; the kernels do the same, fused."""
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..util import rotations
from ..util.arguments import real, shown
from ..util.errors import FastGSError
from .appearance import Features, features_at, momentary
from .gaussians import GaussianModel
from .motion import Static
from .temporal import Always


@dataclass(frozen=True, eq=False)
class Slice:
    """M Gaussians at one time, float64.

    index     [M]     which of the model's Gaussians
    position  [M, 3]  mu(t)
    rotation  [M, 4]  unit quaternion q(t), w x y z
    scale     [M, 3]  standard deviations
    opacity   [M]     sigma(t), 0..1
    features  [M, F]  the model's, time features multiplied by t - mu_tau
    velocity  [M, 3]  d mu / d t, exact; times fps / frame_count = units per second

    Example:
        places = fg.slice_model(model, 0.25).position
    """

    index: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    scale: np.ndarray
    opacity: np.ndarray
    features: np.ndarray
    velocity: np.ndarray


def sigmoid(x: ArrayLike) -> np.ndarray:
    """1 / (1 + exp(-x)) without overflow."""
    return 0.5 * (1 + np.tanh(0.5 * np.asarray(x, np.float64)))


def opacities_at(model: GaussianModel, t: float, index: Any = slice(None)) -> np.ndarray:
    """Opacities sigma(t) [M] of the Gaussians of an index (paper, eq. 6)."""
    return sigmoid(model.opacity[index]) * model.temporal_kind.factor(t, model.mu_tau[index], model.temporal[index])


def positions_at(model: GaussianModel, t: float, index: Any = slice(None)) -> np.ndarray:
    """Positions mu(t) [M, 3] float64 of the Gaussians of an index (paper, eq. 3-4)."""
    return model.position[index] + model.basis.value(model.motion[index], t, model.mu_tau[index])


def quaternions_at(model: GaussianModel, t: float, index: Any = slice(None)) -> np.ndarray:
    """Quaternions q(t) [M, 4] float64 of the Gaussians of an index, not yet of unit length (paper, eq. 7)."""
    return model.rotation[index] + model.rotation_basis.value(model.rotation_motion[index], t, model.mu_tau[index])


def slice_model(model: GaussianModel, t: float, cull: bool = True) -> Slice:
    """The model at time t (any real number).

    With cull, Gaussians whose sigma(t) lies under the model's alpha cut are left out first, so that neither
    their motion nor their colour is read: they cannot touch a pixel.

    Example:
        now = fg.slice_model(model, t=0.25)
    """
    if not isinstance(model, GaussianModel):
        raise FastGSError(f"a model is wanted, as fg.load(path) reads it, not {shown(model)}.")
    t = real(t, "the time of a model")
    sigma = opacities_at(model, t)
    index = np.flatnonzero(sigma >= model.raster.alpha_cut) if cull else np.arange(len(model))
    mu_tau = model.mu_tau[index].astype(np.float64)
    motion = model.motion[index]
    features = features_at(model.appearance, model.features[index], t, mu_tau)
    if isinstance(model.appearance, Features):
        features[:, 6:9] *= (t - mu_tau)[:, None]
    return Slice(
        index=index,
        position=model.position[index] + model.basis.value(motion, t, mu_tau),
        rotation=rotations.unit(quaternions_at(model, t, index)),
        scale=np.exp(model.scale[index].astype(np.float64)),
        opacity=sigma[index],
        features=features,
        velocity=model.basis.rate(motion, t, mu_tau),
    )


def freeze(model: GaussianModel, t: float) -> GaussianModel:
    """A static model that looks as the given one does at time t (a frame for tools that know no time).

    Opacities that vanish at t are left out.  The appearance stays; time features are evaluated at t and folded in.

    Example:
        fg.save(fg.freeze(model, t=0.25), "still.ply")
    """
    return still(model, slice_model(model, t))


def still(model: GaussianModel, s: Slice) -> GaussianModel:
    """A static model of the Gaussians of a slice; everything but their arrays is the given model's."""
    count = len(s.index)
    # a static model is looked at at t = 0: with time features, the factor t - mu_tau is then 1
    mu_tau = np.full(count, -1.0 if isinstance(model.appearance, Features) else 0.0)
    odds = np.clip(s.opacity, 1e-7, 1 - 1e-7)
    return replace(
        model, position=s.position, rotation=s.rotation, scale=np.log(s.scale), opacity=np.log(odds / (1 - odds)),
        features=s.features, appearance=momentary(model.appearance), motion=np.zeros((count, 0, 3)), mu_tau=mu_tau,
        rotation_motion=np.zeros((count, 0, 4)), temporal=np.zeros((count, 0)), basis=Static(), rotation_basis=Static(),
        temporal_kind=Always(), clip=replace(model.clip, frame_count=1), parts=model.parts.take(s.index),
    )

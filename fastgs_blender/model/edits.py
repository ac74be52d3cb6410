# SPDX-License-Identifier: GPL-3.0-or-later
"""Edits: changes of position, opacity, size, colour and shape for each Gaussian of a model at one time, for example by Geometry Nodes.

An edit applies to the slice of a model at one time.  The edited model is a static one with its Gaussians in the same rows, so that
everything that renders models renders edited ones.
"""
from dataclasses import dataclass, replace

import numpy as np

from ..util import rotations
from ..util.arguments import numbers, real
from ..util.errors import FastGSError
from .appearance import Changing, Features, features_at, momentary
from .gaussians import GaussianModel
from .slicing import sigmoid, slice_model, still

SAME = 1e-6
"""Times that differ by less are one time: Blender's attributes hold single precision."""
UNSEEN = 1e-30
"""Stands for the opacity 0 where one divides by it."""


@dataclass(frozen=True, eq=False)
class State:
    """A model's N Gaussians at one time, as they may be edited; float32.

    t         the time
    position  [N, 3]  in the model's space
    velocity  [N, 3]  in units per second
    scale     [N, 3]  standard deviations along the Gaussian's axes
    opacity   [N]     0..1, with fading in and out
    colour    [N, 3]  in the model's colour space, from no particular side
    age       [N]     how much of its lifetime has passed, 0..1
    """

    t: float
    position: np.ndarray
    velocity: np.ndarray
    scale: np.ndarray
    opacity: np.ndarray
    colour: np.ndarray
    age: np.ndarray


def state_of(model: GaussianModel, t: float) -> State:
    """The Gaussians of a model at time t, rounded to single precision; what is not finite is 0."""
    t = float(np.float32(real(t, "the time of a state")))
    mu_tau = model.mu_tau.astype(np.float64)
    with np.errstate(all="ignore"):
        moved, velocity = (given(model.motion, t, mu_tau) for given in (model.basis.value, model.basis.rate))
        shown = sigmoid(model.opacity)
        visible = np.log(np.maximum(shown / model.raster.alpha_cut, 1 + 1e-9))
        begin, end = model.temporal_kind.span(visible, mu_tau, model.temporal)
        # of harmonics and decoders the first three columns alone are colour from no particular side
        columns = model.features if isinstance(model.appearance, Changing) else model.features[:, :3]
        colour = momentary(model.appearance).plain_colours(features_at(model.appearance, columns, t, mu_tau))
        found = {
            "position": model.position + moved, "velocity": velocity / max(model.clip.duration, 1e-9),
            "scale": np.exp(model.scale.astype(np.float64)), "opacity": shown * model.temporal_kind.factor(t, mu_tau, model.temporal),
            "colour": colour, "age": np.clip((t - begin) / np.maximum(end - begin, 1e-12), 0, 1),
        }
        found = {name: value.astype(np.float32) for name, value in found.items()}
    return State(t, **{name: np.where(np.isfinite(value), value, np.float32(0)) for name, value in found.items()})


@dataclass(frozen=True, eq=False)
class Edit:
    """Changes of the N Gaussians of a model at time t.  None, or NaN in a row, leaves them as they are.

    t         the time of the state that was edited
    position  [N, 3]  in the model's space
    scale     [N, 3]  standard deviations along the Gaussian's axes
    opacity   [N]     as it is seen, with fading in and out
    colour    [N, 3]  in the model's colour space, as State.colour.  What differs with the view fades with its channel, and never grows
    hidden    [N]     bool: which are not shown
    deform    [N, 3, 3]  linear maps by which the Gaussians are turned and stretched about their centres

    Example:
        edit = fg.Edit(0.5, opacity=np.full(len(model), 0.25))
        picture = fg.render(edit.applied(model), camera)
    """

    t: float
    position: np.ndarray | None = None
    scale: np.ndarray | None = None
    opacity: np.ndarray | None = None
    colour: np.ndarray | None = None
    hidden: np.ndarray | None = None
    deform: np.ndarray | None = None

    def applied(self, model: GaussianModel, t: float | None = None) -> GaussianModel:
        """The static model that looks as the given one does at time t with this edit; its rows are the model's.

        At another time than the edit's own (an echo, the other end of a fading loop) Gaussians are moved by as much, and their opacity
        changes by the same factor.  Raises FastGSError where the shapes are not those of the model's Gaussians.
        """
        self._check(len(model))
        t = self.t if t is None else t
        now = slice_model(model, self.t if abs(t - self.t) < SAME else t, cull=False)
        fed = now if abs(t - self.t) < SAME else slice_model(model, self.t, cull=False)
        position, opacity = now.position, now.opacity
        with np.errstate(all="ignore"):
            if self.position is not None:
                position = _kept(self.position + (now.position - fed.position), position)
            if self.opacity is not None:
                ratio = np.where(fed.opacity > UNSEEN, now.opacity / np.maximum(fed.opacity, UNSEEN), 1)
                opacity = np.clip(_kept(self.opacity * ratio, opacity), 0, 1)
            scale = now.scale if self.scale is None else _kept(np.maximum(self.scale, 0), now.scale)
        if self.hidden is not None:
            opacity = np.where(self.hidden, 0, opacity)
        features = now.features if self.colour is None else _recoloured(model, now.features, self.colour)
        rotation = now.rotation
        if self.deform is not None:
            rotation, scale = _deformed(rotation, scale, self.deform)
        with np.errstate(divide="ignore"):
            return still(model, replace(now, position=position, rotation=rotation, scale=scale, opacity=opacity, features=features))

    def _check(self, count: int) -> None:
        real(self.t, "the time of an edit")
        for name, shape in {"position": (3,), "scale": (3,), "opacity": (), "colour": (3,), "hidden": (), "deform": (3, 3)}.items():
            value = getattr(self, name)
            if value is not None and np.shape(numbers(value, f"an edit's {name}", "(N, ...)")) != (count, *shape):
                raise FastGSError(f"an edit's {name} must have the shape {(count, *shape)} for this model, not {np.shape(value)}.")


def mixed(a: GaussianModel, t_a: float, b: GaussianModel, t_b: float, share: float) -> GaussianModel:
    """The static model between two states of the same Gaussians: a at t_a (share 0) and b at t_b (share 1)."""
    if share <= 0 or share >= 1:
        model, t = (a, t_a) if share <= 0 else (b, t_b)
        return still(model, slice_model(model, t, cull=False))
    p, q = slice_model(a, t_a, cull=False), slice_model(b, t_b, cull=False)
    nearer = np.where((p.rotation * q.rotation).sum(1, keepdims=True) < 0, -q.rotation, q.rotation)
    between = {name: (1 - share) * getattr(p, name) + share * getattr(q, name) for name in ("position", "scale", "opacity", "features")}
    return still(a, replace(p, rotation=rotations.unit((1 - share) * p.rotation + share * nearer), **between))


def _kept(wanted: np.ndarray, before: np.ndarray) -> np.ndarray:
    """The wanted values, with the values from before in rows that are not finite."""
    good = np.isfinite(wanted)
    good = good if good.ndim == 1 else good.all(1, keepdims=True)
    return np.where(good, wanted, before)


def _recoloured(model: GaussianModel, features: np.ndarray, colour: np.ndarray) -> np.ndarray:
    """Features [N, F] of a moment, changed so that the finite rows of `colour` [N, 3] are the colours of their Gaussians."""
    appearance = momentary(model.appearance)
    rows = np.flatnonzero(np.isfinite(colour).all(1))
    out, wanted = features.copy(), colour[rows].astype(np.float64)
    before = appearance.plain_colours(features[rows])
    same = np.isclose(wanted, before, rtol=1e-6, atol=1e-6)
    share = np.clip(np.divide(wanted, before, out=same.astype(np.float64), where=before > 0), 0, 1)
    out[rows, :3] = appearance.features_of(wanted)[:, :3]
    rest = out[rows, 3:]
    if isinstance(appearance, Features):
        out[rows, 3:] = rest * share.mean(1, keepdims=True)
    else:
        out[rows, 3:] = (rest.reshape(len(rows), -1, 3) * share[:, None]).reshape(rest.shape)
    return out


def _deformed(rotation: np.ndarray, scale: np.ndarray, deform: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations [N, 4] and standard deviations [N, 3] of Gaussians that linear maps [N, 3, 3] have turned and stretched."""
    changed = np.flatnonzero(np.isfinite(deform).all((1, 2)) & (np.abs(deform - np.eye(3)).max((1, 2)) > 1e-7))
    root = deform[changed] @ (rotations.to_matrices(rotation[changed]) * scale[changed, None, :])
    axes, lengths, _ = np.linalg.svd(root)
    axes *= np.sign(np.linalg.det(axes))[:, None, None]
    rotation, scale = rotation.copy(), scale.copy()
    rotation[changed], scale[changed] = rotations.from_matrices(axes), lengths
    return rotation, scale

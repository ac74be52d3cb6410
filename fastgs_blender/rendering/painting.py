# SPDX-License-Identifier: GPL-3.0-or-later
"""The colours of an instance's Gaussians as its camera sees them, and the features with which they have other ones."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..model.appearance import SH, SH_C0, Appearance, Changing, Features, decode, features_at, momentary
from ..model.slicing import positions_at
from ..util.threads import PIECE, ranges
from .colour import linear_to_srgb, srgb_to_linear
from .instances import ViewedInstance


def seen_colours(instance: ViewedInstance, index: np.ndarray, places: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """(features [M, F] at the instance's time, colours [M, 3] in the model's space, without looks) of the Gaussians `index`, float32.

    places  theirs [M, 3] in the model's space, if these are known
    """
    model, ray = instance.model, _rays(instance, index, places)
    appearance, features, mu_tau = momentary(model.appearance), np.take(model.features, index, 0), model.mu_tau[index].astype(np.float64)
    if isinstance(model.appearance, Changing):
        features = features_at(model.appearance, features, instance.t, mu_tau).astype(np.float32)
    if isinstance(appearance, Features):
        now = _now(features, (instance.t - mu_tau).astype(np.float32))
        centre = instance.camera_to_model[:3, 3].astype(np.float32)
        pieces = [decode(now[a:b], centre, ray[a:b], appearance) for a, b in ranges(len(now), PIECE)]  # see threads.product()
        return features, np.concatenate(pieces or [features[:, :3]])
    return features, appearance.seen(features, ray)


def painted(instance: ViewedInstance, index: np.ndarray, gains: Sequence[np.ndarray],
            places: np.ndarray) -> tuple[Appearance, list[np.ndarray]]:
    """The features [M, F] with which the Gaussians `index` of an instance, at places [M, 3] in the model's space, have their colours times
    gains [M, 3], scene linear, as its camera sees them: one for each of the gains; and what makes colours of them."""
    model, appearance = instance.model, momentary(instance.model.appearance)
    unit = SH_C0 if isinstance(appearance, SH) else 1.0
    if isinstance(appearance, Features):
        bare = replace(appearance, activation="none")
        features, before = seen_colours(replace(instance, model=replace(model, appearance=bare)), index, places)
        appearance, colour = bare, appearance.activated(before)
    else:
        features, colour = seen_colours(instance, index, places)
        before = colour
    linear, out = colour if model.colour_space == "linear" else srgb_to_linear(np.maximum(colour, 0)), list[np.ndarray]()
    for gain in gains:
        rows = np.flatnonzero((gain != gains[0]).any(1)) if out else slice(None)
        seen = linear[rows] * gain[rows].astype(np.float32)
        own = features[rows, :3] + ((seen if model.colour_space == "linear" else linear_to_srgb(seen)) - before[rows]) / np.float32(unit)
        out.append((out or [features])[0].copy())
        out[-1][rows, :3] = own
    return appearance, out


def _rays(instance: ViewedInstance, index: np.ndarray, places: np.ndarray | None) -> np.ndarray:
    """Unit vectors [M, 3] float32 in the model's space, from the camera to the Gaussians."""
    ray = (positions_at(instance.model, instance.t, index) if places is None else places) - instance.camera_to_model[:3, 3]
    return (ray / np.maximum(np.sqrt(np.einsum("mi,mi->m", ray, ray)), 1e-30)[:, None]).astype(np.float32)


def _now(features: np.ndarray, age: np.ndarray) -> np.ndarray:
    """What a decoder reads of features [M, 9] of Gaussians of an age [M]."""
    now = features.copy()
    now[:, 6:9] *= age[:, None]
    return now

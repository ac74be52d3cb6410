# SPDX-License-Identifier: GPL-3.0-or-later
"""The colours of an instance's Gaussians as its camera sees them, and the features with which they have those of a light."""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..model.appearance import Appearance, Changing, Features, decode, features_at, momentary
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


def shares_of(bare: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Which share [L, M] of the irradiance of lamps [L, 3, M], by channel, is left; 1 where there is none."""
    bare, left = bare.mean(1), left.mean(1)
    return np.divide(left, bare, out=np.ones_like(bare), where=bare > 1e-12)


def bare(appearance: Appearance) -> Appearance:
    """What makes colours of the features that painted() gives."""
    appearance = momentary(appearance)
    return replace(appearance, activation="none") if isinstance(appearance, Features) else appearance


def painted(instance: ViewedInstance, index: np.ndarray, places: np.ndarray, light: np.ndarray, unlit: np.ndarray | None,
            drops: bool) -> tuple[list[np.ndarray], np.ndarray]:
    """PictureBackend.painted() in NumPy."""
    model, settings, appearance = instance.model, instance.settings, momentary(instance.model.appearance)
    nothing, meshes, all_, splats = light.sum(0)
    most, captured, shadows = np.maximum(nothing, 1e-12), settings.captured_light, settings.shadows
    past = np.where(nothing > 1e-12, meshes / most, 1)
    lamps = settings.lamp_light / np.pi * (1 if unlit is None else unlit.T)
    free = captured + lamps * (nothing - shadows * (nothing - splats))
    gain = captured * (1 - shadows * (1 - past)) + lamps * (nothing - shadows * (nothing - all_))
    features, before = seen_colours(replace(instance, model=replace(model, appearance=bare(model.appearance)))
                                    if isinstance(appearance, Features) else instance, index, places)
    colour = appearance.activated(before) if isinstance(appearance, Features) else before
    linear, out = colour if model.colour_space == "linear" else srgb_to_linear(np.maximum(colour, 0)), list[np.ndarray]()
    for each in (gain, free)[:1 + drops]:
        seen = linear * each.T.astype(np.float32)
        out.append(features.copy())
        out[-1][:, :3] += ((seen if model.colour_space == "linear" else linear_to_srgb(seen)) - before) / np.float32(appearance.unit)
    takes = shadows * (captured * light[:, 0] / most + lamps * light[:, 3]) / np.maximum(free, 1e-12)
    numbers = np.concatenate([takes, *(shares_of(light[:, 0], light[:, stage])[:, None] for stage in (1, 3))], 1).T
    return out, numbers.astype(np.float32)[:len(index) * drops]


def _rays(instance: ViewedInstance, index: np.ndarray, places: np.ndarray | None) -> np.ndarray:
    """Unit vectors [M, 3] float32 in the model's space, from the camera to the Gaussians."""
    ray = (positions_at(instance.model, instance.t, index) if places is None else places) - instance.camera_to_model[:3, 3]
    return (ray / np.maximum(np.sqrt(np.einsum("mi,mi->m", ray, ray)), 1e-30)[:, None]).astype(np.float32)


def _now(features: np.ndarray, age: np.ndarray) -> np.ndarray:
    """What a decoder reads of features [M, 9] of Gaussians of an age [M]."""
    now = features.copy()
    now[:, 6:9] *= age[:, None]
    return now

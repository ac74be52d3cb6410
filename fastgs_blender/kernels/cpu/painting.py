# SPDX-License-Identifier: GPL-3.0-or-later
"""The colours of Gaussians in a light (rendering/painting.py)."""
from __future__ import annotations

import math

import numpy as np
from numba import float32

from ...model.appearance import ACTIVATIONS, Changing, Features, features_at, momentary
from ...rendering.colour import SRGB_CUT, SRGB_GAMMA, SRGB_LINEAR_CUT, SRGB_OFFSET, SRGB_SLOPE
from ...util.threads import portions, run
from .. import asserts
from .appearance import FEATURES, appear, directed, direction_of
from .decode import NONE, activate
from .jit import inline, kernel
from .splats import plain

LEAST = float32(1e-12)
"""Light that counts as none."""


def painted(instance, index: np.ndarray, places: np.ndarray, light: np.ndarray, unlit: np.ndarray | None,
            drops: bool) -> tuple[list[np.ndarray], np.ndarray]:
    """PictureBackend.painted()."""
    asserts.painted(index, places, light, unlit)
    model, settings, look = instance.model, instance.settings, momentary(instance.model.appearance)
    features, rows, mu_tau = plain(model.features), index, model.mu_tau[index].astype(np.float64)
    if isinstance(model.appearance, Changing):
        features, rows = features_at(model.appearance, features[index], instance.t, mu_tau).astype(np.float32), np.arange(len(index))
    matrices, activation = [np.empty((0, 0), np.float32)] * 2, NONE
    if isinstance(look, Features):
        matrices, activation = [plain(look.w1), plain(look.w2)], ACTIVATIONS.index(look.activation)
    out = np.empty((1 + drops, len(index), features.shape[1]), np.float32)
    numbers = np.empty((len(index) * drops, 5, len(light)), np.float32)
    rest = (rows, np.ascontiguousarray(features), instance.t - mu_tau, places, np.ascontiguousarray(light),
            np.empty((0, 3), np.float32) if unlit is None else np.ascontiguousarray(unlit, np.float32),
            tuple(float(share) for share in (settings.captured_light, settings.lamp_light / np.pi, settings.shadows)),
            (look.code, getattr(look, "degree", 0), activation, model.colour_space == "linear", look.unit),
            *matrices, instance.camera_to_model[:3, 3].copy(), out, numbers)
    run(lambda first, last: paint(first, last, *rest), portions(len(index)))
    return list(out), numbers


@kernel
def paint(first, last, index, features, age, places, light, unlit, shares, look, w1, w2, eye, out, numbers):
    """painted() of the Gaussians index[first:last], of an age [M]; out [1 or 2, M, F], numbers [M, 5, L] or none.

    shares  of the captured light, of the lamps' (over pi), and how dark shadows are
    look    code and degree of the appearance, activation, whether colours are linear, and how much colour a feature of 1 is
    """
    kind, degree, activation, linear, unit = look
    captured, bright, shadows = float32(shares[0]), float32(shares[1]), float32(shares[2])
    colour, terms, inputs = np.empty(9, np.float32), np.empty(25), np.empty(12, np.float32)
    for m in range(first, last):
        n = index[m]
        if directed(kind):
            appear(kind, features, n, degree, places[m, 0], places[m, 1], places[m, 2], age[m], eye, False, terms, colour)
        else:
            for c in range(9 if kind == FEATURES else 3):
                colour[c] = features[n, c] * age[m] if c >= 6 else features[n, c]
        if kind == FEATURES:
            for k in range(3):
                inputs[k], inputs[3 + k], inputs[6 + k] = colour[3 + k], colour[6 + k], eye[k]
            inputs[9], inputs[10], inputs[11], _ = direction_of(places[m, 0], places[m, 1], places[m, 2], eye, False)
            add_decoded(inputs, w1, w2, colour)
        for g in range(len(out)):
            for k in range(features.shape[1]):
                out[g, m, k] = features[n, k]
        for c in range(3):
            bare, meshes, both, splats = float32(0.0), float32(0.0), float32(0.0), float32(0.0)
            for lamp in range(len(light)):
                bare, meshes = bare + light[lamp, 0, c, m], meshes + light[lamp, 1, c, m]
                both, splats = both + light[lamp, 2, c, m], splats + light[lamp, 3, c, m]
            past, lamps = meshes / bare if bare > LEAST else float32(1.0), bright * (unlit[m, c] if len(unlit) else float32(1.0))
            free = captured + lamps * (bare - shadows * (bare - splats))
            gain = captured * (float32(1.0) - shadows * (float32(1.0) - past)) + lamps * (bare - shadows * (bare - both))
            before, shown = colour[c], activate(colour[c], activation)
            for g in range(len(out)):
                if g and gain == free:
                    out[g, m, c] = out[0, m, c]
                else:
                    seen = (shown if linear else to_linear(shown)) * (free if g else gain)
                    out[g, m, c] += ((seen if linear else to_srgb(seen)) - before) / float32(unit)
            for lamp in range(numbers.shape[2] if len(numbers) else 0):
                takes = captured * light[lamp, 0, c, m] / max(bare, LEAST) + lamps * light[lamp, 3, c, m]
                numbers[m, c, lamp] = shadows * takes / max(free, LEAST)
        for lamp in range(numbers.shape[2] if len(numbers) else 0):
            bare = (light[lamp, 0, 0, m] + light[lamp, 0, 1, m] + light[lamp, 0, 2, m]) / float32(3.0)
            for row, stage in ((3, 1), (4, 3)):
                left = (light[lamp, stage, 0, m] + light[lamp, stage, 1, m] + light[lamp, stage, 2, m]) / float32(3.0)
                numbers[m, row, lamp] = left / bare if bare > LEAST else float32(1.0)


@inline
def add_decoded(inputs, w1, w2, colour):
    """Add to a colour [3] what a decoder makes of inputs [12], before its activation."""
    for j in range(6):
        total = w1[j, 0] * inputs[0]
        for i in range(1, 12):
            total += w1[j, i] * inputs[i]
        if total > float32(0.0):
            for c in range(3):
                colour[c] += w2[c, j] * total


@inline
def to_linear(x):
    """A linear value of an sRGB one, of 0 where that is less."""
    x = max(x, float32(0.0))
    if x <= float32(SRGB_CUT):
        return x / float32(SRGB_SLOPE)
    return math.pow((x + float32(SRGB_OFFSET)) * float32(1 / (1 + SRGB_OFFSET)), float32(SRGB_GAMMA))


@inline
def to_srgb(x):
    """The sRGB value of a linear one."""
    a = abs(x)
    if a <= float32(SRGB_LINEAR_CUT):
        return x * float32(SRGB_SLOPE)
    return math.copysign(float32(1 + SRGB_OFFSET) * math.pow(a, float32(1 / SRGB_GAMMA)) - float32(SRGB_OFFSET), x)

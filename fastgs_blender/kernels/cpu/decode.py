# SPDX-License-Identifier: GPL-3.0-or-later
"""The decoder of feature splatting, per pixel: appearance.decode, fused with the rays and the premultiplication."""
from __future__ import annotations

import math

import numpy as np
from numba import float32

from ...rendering.instances import LIMIT
from .jit import inline, kernel

SIGMOID, CLAMP, NONE = range(3)
MOST = float32(LIMIT)
BLOCK = 64
"""Pixels decoded together, so that the small matrices are multiplied with vectors."""


@inline
def begin(to_model):
    """Allocate the arrays of a block of pixels: inputs [12, BLOCK], hidden [6, BLOCK], base [3, BLOCK]."""
    inputs, hidden, base = np.zeros((12, BLOCK), np.float32), np.empty((6, BLOCK), np.float32), np.zeros((3, BLOCK), np.float32)
    for i in range(3):
        inputs[6 + i, :] = to_model[3, i]
    return inputs, hidden, base


@inline
def decode_block(row, start, n, features, weight, w1, w2, to_model, lens, orthographic, x0, y0, inputs, hidden, base):
    """n pixels from `start` of a row: fill inputs and hidden, and base with the colour before the activation.

    Returns whether anything covers them; where nothing does, nothing is filled.
    """
    covered = False
    for p in range(n):
        covered |= weight[row, start + p] > float32(0.0)
    if not covered:
        return False
    for p in range(n):
        share = weight[row, start + p]
        inverse = float32(1.0) / share if share > float32(0.0) else float32(0.0)
        for i in range(3):
            base[i, p] = features[row, start + p, i] * inverse
        for i in range(6):
            inputs[i, p] = features[row, start + p, 3 + i] * inverse
    fx, fy, cx, cy = lens
    v = 0.0 if orthographic else (y0 + row + 0.5 - cy) / fy
    for p in range(n):
        u = 0.0 if orthographic else (x0 + start + p + 0.5 - cx) / fx
        dx = to_model[0, 0] * u + to_model[0, 1] * v + to_model[0, 2]
        dy = to_model[1, 0] * u + to_model[1, 1] * v + to_model[1, 2]
        dz = to_model[2, 0] * u + to_model[2, 1] * v + to_model[2, 2]
        scale = 1.0 / max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-30)
        inputs[9, p], inputs[10, p], inputs[11, p] = dx * scale, dy * scale, dz * scale
    for j in range(6):
        for p in range(BLOCK):
            total = w1[j, 0] * inputs[0, p]
            for i in range(1, 12):
                total += w1[j, i] * inputs[i, p]
            hidden[j, p] = total if total > float32(0.0) else float32(0.0)
    for c in range(3):
        for p in range(BLOCK):
            total = base[c, p]
            for j in range(6):
                total += w2[c, j] * hidden[j, p]
            base[c, p] = total
    return True


@inline
def activate(value, activation):
    """The output activation of a number."""
    if activation == SIGMOID:
        return float32(1.0) / (float32(1.0) + math.exp(-value))
    if activation == CLAMP:
        return min(max(value, float32(0.0)), float32(1.0))
    return value


@kernel
def decode(first, last, features, weight, w1, w2, activation, to_model, lens, orthographic, x0, y0, out):
    """Rows first..last of out [h, w, 3], premultiplied, from blended features [h, w, C >= 9] with their weight [h, w].

    Colours that are beyond LIMIT, or not a number, become 0.

    to_model [4, 3] float64: rotation and scale of camera to model, then the camera's centre there; lens: fx, fy, cx, cy.
    """
    inputs, hidden, base = begin(to_model)
    width = out.shape[1]
    for row in range(first, last):
        for start in range(0, width, BLOCK):
            n = min(BLOCK, width - start)
            if decode_block(row, start, n, features, weight, w1, w2, to_model, lens, orthographic, x0, y0, inputs, hidden, base):
                for p in range(n):
                    share = weight[row, start + p]
                    for c in range(3):
                        value = activate(base[c, p], activation) * share
                        out[row, start + p, c] = value if abs(value) <= MOST else float32(0.0)
            else:
                out[row, start:start + n, :] = float32(0.0)

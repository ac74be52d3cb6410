# SPDX-License-Identifier: GPL-3.0-or-later
"""The decoder of feature splatting, per pixel: appearance.decode, fused with the rays and the premultiplication."""
from __future__ import annotations

import math

import numpy as np
from numba import float32

from .jit import kernel

SIGMOID, CLAMP, NONE = range(3)


@kernel
def decode(first, last, features, weight, w1, w2, activation, to_model, lens, x0, y0, orthographic, out):
    """Rows first..last of out [h, w, 3], premultiplied, from blended features [h, w, C >= 9] with their weight [h, w].

    to_model [4, 3] float64: rotation and scale of camera to model, then the camera's centre there; lens: fx, fy, cx, cy.
    """
    inputs, hidden = np.empty(12, np.float32), np.empty(6, np.float32)
    for i in range(3):
        inputs[6 + i] = to_model[3, i]
    fx, fy, cx, cy = lens
    for row in range(first, last):
        v = 0.0 if orthographic else (y0 + row + 0.5 - cy) / fy
        for col in range(out.shape[1]):
            share = weight[row, col]
            if not (share > 0.0):
                out[row, col, :] = float32(0.0)
                continue
            u = 0.0 if orthographic else (x0 + col + 0.5 - cx) / fx
            dx = to_model[0, 0] * u + to_model[0, 1] * v + to_model[0, 2]
            dy = to_model[1, 0] * u + to_model[1, 1] * v + to_model[1, 2]
            dz = to_model[2, 0] * u + to_model[2, 1] * v + to_model[2, 2]
            length = max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-30)
            inputs[9], inputs[10], inputs[11] = dx / length, dy / length, dz / length
            inverse = float32(1.0) / share
            for i in range(6):
                inputs[i] = features[row, col, 3 + i] * inverse
            for j in range(6):
                total = float32(0.0)
                for i in range(12):
                    total += w1[j, i] * inputs[i]
                hidden[j] = max(total, float32(0.0))
            for c in range(3):
                value = features[row, col, c] * inverse
                for j in range(6):
                    value += w2[c, j] * hidden[j]
                if activation == SIGMOID:
                    value = float32(1.0) / (float32(1.0) + math.exp(-value))
                elif activation == CLAMP:
                    value = min(max(value, float32(0.0)), float32(1.0))
                out[row, col, c] = value * share

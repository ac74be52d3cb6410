# SPDX-License-Identifier: GPL-3.0-or-later
"""Backward pass of decode.py: gradients of the blended features, of their weight, and of the decoder's two matrices."""
from __future__ import annotations

import numpy as np
from numba import float32

from .decode import BLOCK, CLAMP, SIGMOID, activate, begin, decode_block
from .jit import kernel


@kernel
def decode_backward(first, last, features, weight, w1, w2, activation, to_model, lens, orthographic, x0, y0,
                    grad, grad_features, grad_weight, grad_w1, grad_w2):
    """From grad [h, w, 3], that of the premultiplied colour, to that of rows first..last of features and weight, both overwritten.

    grad_features [h, w, C]: channels after the nine features become 0.  grad_w1 [6, 12] and grad_w2 [3, 6] float64 are the sums
    over these rows.  The other arguments are decode.decode's.
    """
    inputs, hidden, base = begin(to_model)
    back, back_hidden, back_inputs = np.zeros((3, BLOCK), np.float32), np.empty((6, BLOCK), np.float32), np.empty((6, BLOCK), np.float32)
    sums1, sums2 = np.zeros((6, 12, BLOCK), np.float32), np.zeros((3, 6, BLOCK), np.float32)
    width = grad.shape[1]
    for row in range(first, last):
        for start in range(0, width, BLOCK):
            n = min(BLOCK, width - start)
            if not decode_block(row, start, n, features, weight, w1, w2, to_model, lens, orthographic, x0, y0, inputs, hidden, base):
                grad_features[row, start:start + n, :] = float32(0.0)
                grad_weight[row, start:start + n] = float32(0.0)
                continue
            for p in range(n):
                share = weight[row, start + p]
                by_weight = float32(0.0)
                for c in range(3):
                    g, value = grad[row, start + p, c], base[c, p]
                    shown = activate(value, activation)
                    by_weight += g * shown
                    if activation == SIGMOID:
                        g *= shown * (float32(1.0) - shown)
                    elif activation == CLAMP and not (value >= float32(0.0) and value <= float32(1.0)):
                        g = float32(0.0)
                    back[c, p] = g * share
                grad_weight[row, start + p] = by_weight
            for p in range(n, BLOCK):
                back[0, p], back[1, p], back[2, p] = float32(0.0), float32(0.0), float32(0.0)
            for j in range(6):
                for p in range(BLOCK):
                    total = w2[0, j] * back[0, p] + w2[1, j] * back[1, p] + w2[2, j] * back[2, p]
                    back_hidden[j, p] = total if hidden[j, p] > float32(0.0) else float32(0.0)
            for i in range(6):
                for p in range(BLOCK):
                    total = w1[0, i] * back_hidden[0, p]
                    for j in range(1, 6):
                        total += w1[j, i] * back_hidden[j, p]
                    back_inputs[i, p] = total
            for c in range(3):
                for j in range(6):
                    for p in range(BLOCK):
                        sums2[c, j, p] += back[c, p] * hidden[j, p]
            for j in range(6):
                for i in range(12):
                    for p in range(BLOCK):
                        sums1[j, i, p] += back_hidden[j, p] * inputs[i, p]
            # the features were divided by their weight
            for p in range(n):
                share = weight[row, start + p]
                inverse = float32(1.0) / share if share > float32(0.0) else float32(0.0)
                along = float32(0.0)
                for c in range(3):
                    g = back[c, p] * inverse
                    along += g * features[row, start + p, c]
                    grad_features[row, start + p, c] = g
                for i in range(6):
                    g = back_inputs[i, p] * inverse
                    along += g * features[row, start + p, 3 + i]
                    grad_features[row, start + p, 3 + i] = g
                for c in range(9, features.shape[2]):
                    grad_features[row, start + p, c] = float32(0.0)
                grad_weight[row, start + p] = grad_weight[row, start + p] - along * inverse if share > float32(0.0) else float32(0.0)
    for j in range(6):
        for i in range(12):
            total = 0.0
            for p in range(BLOCK):
                total += np.float64(sums1[j, i, p])
            grad_w1[j, i] = total
    for c in range(3):
        for j in range(6):
            total = 0.0
            for p in range(BLOCK):
                total += np.float64(sums2[c, j, p])
            grad_w2[c, j] = total

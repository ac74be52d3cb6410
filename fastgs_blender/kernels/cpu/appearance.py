# SPDX-License-Identifier: GPL-3.0-or-later
"""What one Gaussian adds to a picture, and its gradient, as model/appearance.py states it (seen): a colour, or a decoder's features.

Loops over all Gaussians ask directed() first: for each call of the others numba counts references of arrays, which takes 80 ns.
"""
from __future__ import annotations

import math

import numpy as np

from ...model.appearance import RGB, Features
from ...model.appearance import SH as HARMONICS
from .jit import inline
from .spherical import sh_colour, sh_slope

CONSTANT, SH, FEATURES = RGB.code, HARMONICS.code, Features.code


@inline
def directed(code):
    """Whether it depends on the direction.  Else it is the features themselves, of a decoder's the last three times the age."""
    if code == CONSTANT:
        return False
    return code != FEATURES


@inline
def direction_of(px, py, pz, eye, orthographic):
    """Unit direction in which a position is seen, and its length before."""
    if orthographic:
        dx, dy, dz = eye[0], eye[1], eye[2]
    else:
        dx, dy, dz = px - eye[0], py - eye[1], pz - eye[2]
    norm = max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-30)
    return dx / norm, dy / norm, dz / norm, norm


@inline
def appear(code, features, n, degree, px, py, pz, delta, eye, orthographic, terms, out):
    """Write the colour of features[n] into out [9], where it is directed, of a Gaussian at (px, py, pz) at an age delta.

    terms [25]: room to work.
    """
    if code == SH:
        dx, dy, dz, _ = direction_of(px, py, pz, eye, orthographic)
        sh_colour(features, n, degree, dx, dy, dz, terms, out)


@inline
def appear_backward(code, features, n, degree, px, py, pz, eye, orthographic, g, row, channel, terms, colour, out):
    """From the gradient g[row, channel ...] of what appear() gave, where it is directed: writes that of the features, returns that of the
    position."""
    gx, gy, gz = 0.0, 0.0, 0.0
    if code == SH:
        dx, dy, dz, distance = direction_of(px, py, pz, eye, orthographic)
        sh_colour(features, n, degree, dx, dy, dz, terms, colour)
        red = np.float64(g[row, channel]) if colour[0] > 0.0 else 0.0
        green = np.float64(g[row, channel + 1]) if colour[1] > 0.0 else 0.0
        blue = np.float64(g[row, channel + 2]) if colour[2] > 0.0 else 0.0
        for b in range((degree + 1) * (degree + 1)):
            along = red * features[n, 3 * b] + green * features[n, 3 * b + 1] + blue * features[n, 3 * b + 2]
            out[n, 3 * b], out[n, 3 * b + 1], out[n, 3 * b + 2] = terms[b] * red, terms[b] * green, terms[b] * blue
            terms[b] = along
        if not orthographic:
            hx, hy, hz = sh_slope(degree, dx, dy, dz, terms)
            along = hx * dx + hy * dy + hz * dz
            gx, gy, gz = (hx - along * dx) / distance, (hy - along * dy) / distance, (hz - along * dz) / distance
    return gx, gy, gz

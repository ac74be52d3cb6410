# SPDX-License-Identifier: GPL-3.0-or-later
"""Temporal opacity of one Gaussian, and its gradient, as model/temporal.py states it; p[n] are the Gaussian's parameters."""
from __future__ import annotations

from ...model.temporal import Radial, Window, WindowedRadial
from .jit import inline
from .lanes import exp

RADIAL, WINDOW, RADIAL_WINDOW = Radial.code, Window.code, WindowedRadial.code


@inline
def temporal_factor(code, t, mu_tau, p, n):
    """The factor at a time t, of a Gaussian with the centre mu_tau."""
    if code == RADIAL:
        delta = t - mu_tau
        return exp(-exp(p[n, 0]) * delta * delta)
    if code == WINDOW:
        early, late = max(p[n, 0] - t, 0.0) / exp(p[n, 2]), max(t - p[n, 1], 0.0) / exp(p[n, 3])
        return exp(-early * early - late * late)
    if code == RADIAL_WINDOW:
        delta, outside = t - mu_tau, max(p[n, 1] - t, t - p[n, 2], 0.0) / exp(p[n, 3])
        return exp(-exp(p[n, 0]) * delta * delta - outside * outside)
    return 1.0


@inline
def temporal_slope(code, t, mu_tau, p, n, g, out):
    """g is the gradient of the factor's logarithm; writes that of the parameters, returns that of mu_tau."""
    if code in (RADIAL, RADIAL_WINDOW):
        delta, speed = t - mu_tau, exp(p[n, 0])
        out[n, 0] = -g * speed * delta * delta
        if code == RADIAL_WINDOW:
            width = exp(p[n, 3])
            outside = max(p[n, 1] - t, t - p[n, 2], 0.0) / width
            before = p[n, 1] - t >= t - p[n, 2]
            out[n, 1] = -2.0 * g * outside / width if before else 0.0
            out[n, 2] = 0.0 if before else 2.0 * g * outside / width
            out[n, 3] = 2.0 * g * outside * outside
        return 2.0 * g * speed * delta
    if code == WINDOW:
        before, after = exp(p[n, 2]), exp(p[n, 3])
        early, late = max(p[n, 0] - t, 0.0) / before, max(t - p[n, 1], 0.0) / after
        out[n, 0], out[n, 1] = -2.0 * g * early / before, 2.0 * g * late / after
        out[n, 2], out[n, 3] = 2.0 * g * early * early, 2.0 * g * late * late
    return 0.0

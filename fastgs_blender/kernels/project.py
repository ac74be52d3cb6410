# SPDX-License-Identifier: GPL-3.0-or-later
"""Slice, cull and project, fused: one pass over a model's arrays at one time, for one camera.

A Gaussian that is not opaque enough at this time, lies before the near plane or off the window leaves the pass as early as
possible.  Arithmetic is float64: arrays are float32, but far or long thin splats need the precision.
"""
from __future__ import annotations

import math

import numpy as np
from numba import float32

from . import raster
from .jit import inline, kernel
from .spherical import sh_colour

RGB, SH, FEATURES = range(3)
ALWAYS, RADIAL, WINDOW = range(3)
SCALE = math.sqrt(0.5 * math.log2(math.e))
"""Turns a Mahalanobis distance into the root of the exponent of 2."""


@inline
def _temporal_factor(code, t, mu_tau, p):
    """Temporal opacity; p [P] are the Gaussian's parameters (temporal.py)."""
    if code == RADIAL:
        delta = t - mu_tau
        return math.exp(-math.exp(p[0]) * delta * delta)
    if code == WINDOW:
        early, late = max(p[0] - t, 0.0) / math.exp(p[2]), max(t - p[1], 0.0) / math.exp(p[3])
        return math.exp(-early * early - late * late)
    return 1.0


@inline
def _add_motion(value, coefficients, index, weights, centred, delta):
    """value [D] += the basis' weighted coefficients [K, D]: all of them with powers of delta, or those listed in index."""
    if centred:
        for d in range(len(value)):
            total = 0.0
            for k in range(len(coefficients) - 1, -1, -1):
                total = (total + coefficients[k, d]) * delta
            value[d] += total
    else:
        for m in range(len(index)):
            w = weights[m]
            for d in range(len(value)):
                value[d] += w * coefficients[index[m], d]


@kernel
def project(first, last, arrays, times, view, lens, constants, look, geometry, shade, depth):
    """Project the Gaussians first..last; write those that can be seen from row `first` on and return their number.

    arrays     position, rotation, scale, opacity, features, motion, rotation_motion, mu_tau, temporal of the model
    times      (t, temporal code, (index, weights, centred) of the motion, the same of the rotation)
    view       [5, 3] float64: rows 0-2 model to camera, row 3 its translation, row 4 the camera's centre (or, orthographic,
               its direction) in model space
    lens       [13] float64: fx, fy, cx, cy, near, limits of x/z and y/z (4), first and last pixel centre in x and in y (4)
    constants  (blur, alpha max, alpha cut, antialiased, orthographic)
    look       (appearance code, degree, first channel, weight channel or -1, depth channel or -1)
    geometry, shade, depth   of the splats, see raster.py
    """
    position, rotation, scale, opacity, features, motion, rotation_motion, mu_tau, temporal = arrays
    t, temporal_code, moving, turning = times
    fx, fy, cx, cy, near, low_x, high_x, low_y, high_y, left, right, top, bottom = lens
    blur, alpha_max, alpha_cut, antialiased, orthographic = constants
    appearance, degree, channel, weight_channel, depth_channel = look
    centre, q, factor, colour = np.empty(3), np.empty(4), np.empty((3, 3)), np.empty(3)
    out = first
    for n in range(first, last):
        sigma = _temporal_factor(temporal_code, t, np.float64(mu_tau[n]), temporal[n]) / (1.0 + math.exp(-np.float64(opacity[n])))
        if not (sigma >= alpha_cut):
            continue
        delta = t - np.float64(mu_tau[n])
        for d in range(3):
            centre[d] = position[n, d]
        _add_motion(centre, motion[n], moving[0], moving[1], moving[2], delta)
        x = view[0, 0] * centre[0] + view[0, 1] * centre[1] + view[0, 2] * centre[2] + view[3, 0]
        y = view[1, 0] * centre[0] + view[1, 1] * centre[1] + view[1, 2] * centre[2] + view[3, 1]
        z = view[2, 0] * centre[0] + view[2, 1] * centre[1] + view[2, 2] * centre[2] + view[3, 2]
        if not (z > near and z < np.inf):
            continue

        for d in range(4):
            q[d] = rotation[n, d]
        _add_motion(q, rotation_motion[n], turning[0], turning[1], turning[2], delta)
        norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        if norm > 1e-12:
            for d in range(4):
                q[d] /= norm
        else:
            q[0], q[1], q[2], q[3] = 1.0, 0.0, 0.0, 0.0
        _rotation(q, factor)

        # rows of J W, then times R S: the 2 x 3 factor of the projected covariance
        if orthographic:
            mx, my, a02, a12, depth_scale = fx * x + cx, fy * y + cy, 0.0, 0.0, 1.0
        else:
            mx, my, depth_scale = fx * (x / z) + cx, fy * (y / z) + cy, 1.0 / z
            a02 = -min(max(x / z, low_x), high_x)
            a12 = -min(max(y / z, low_y), high_y)
        s00, s01, s11 = 0.0, 0.0, 0.0
        p = np.empty((2, 3))
        for j in range(3):
            column_0 = view[0, 0] * factor[0, j] + view[0, 1] * factor[1, j] + view[0, 2] * factor[2, j]
            column_1 = view[1, 0] * factor[0, j] + view[1, 1] * factor[1, j] + view[1, 2] * factor[2, j]
            column_2 = view[2, 0] * factor[0, j] + view[2, 1] * factor[1, j] + view[2, 2] * factor[2, j]
            size = math.exp(np.float64(scale[n, j])) * depth_scale
            p[0, j] = fx * (column_0 + a02 * column_2) * size
            p[1, j] = fy * (column_1 + a12 * column_2) * size
            s00 += p[0, j] * p[0, j]
            s01 += p[0, j] * p[1, j]
            s11 += p[1, j] * p[1, j]
        sharp = ((p[0, 1] * p[1, 2] - p[0, 2] * p[1, 1]) ** 2 + (p[0, 2] * p[1, 0] - p[0, 0] * p[1, 2]) ** 2
                 + (p[0, 0] * p[1, 1] - p[0, 1] * p[1, 0]) ** 2)
        det = sharp + blur * (s00 + s11) + blur * blur
        s00 += blur
        s11 += blur
        if not (det > 0.0 and s00 + s11 < np.inf):
            continue
        if antialiased:
            sigma *= math.sqrt(sharp / det)
            if not (sigma >= alpha_cut):
                continue
        reach = 2.0 * math.log(sigma / alpha_cut)
        radius_x, radius_y = math.sqrt(reach * s00), math.sqrt(reach * s11)
        if not (mx + radius_x >= left and mx - radius_x <= right and my + radius_y >= top and my - radius_y <= bottom):
            continue

        if appearance == SH:
            for d in range(3):
                q[d] = view[4, d] if orthographic else centre[d] - view[4, d]
            norm = max(math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]), 1e-30)
            sh_colour(features[n], degree, q[0] / norm, q[1] / norm, q[2] / norm, colour)
        good = True
        for c in range(raster.CHANNEL, shade.shape[1]):
            shade[out, c] = float32(0.0)
        for c in range(9 if appearance == FEATURES else 3):
            value = colour[c] if appearance == SH else np.float64(features[n, c])
            if c >= 6:
                value *= delta
            good = good and abs(value) < np.inf
            shade[out, raster.CHANNEL + channel + c] = value
        if not good:
            continue
        if weight_channel >= 0:
            shade[out, raster.CHANNEL + weight_channel] = float32(1.0)
        if depth_channel >= 0:
            shade[out, raster.CHANNEL + depth_channel] = z
        root = math.sqrt(s11)
        geometry[out, raster.MEAN_X] = mx
        geometry[out, raster.MEAN_Y] = my
        geometry[out, raster.L11] = SCALE * root / math.sqrt(det)
        geometry[out, raster.L21] = -SCALE * s01 / (root * math.sqrt(det))
        geometry[out, raster.L22] = SCALE / root
        shade[out, raster.LOG2_OPACITY] = math.log2(sigma)
        shade[out, raster.ALPHA_MAX] = alpha_max
        shade[out, raster.LOG2_CUT] = math.log2(alpha_cut)
        shade[out, raster.DEPTH] = z
        shade[out, raster.RADIUS_X] = radius_x + 1e-3
        shade[out, raster.RADIUS_Y] = radius_y + 1e-3
        depth[out] = z
        out += 1
    return out - first


@inline
def _rotation(q, m):
    """m [3, 3] becomes the rotation matrix of the unit quaternion q [4], w x y z."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    m[0, 0], m[0, 1], m[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    m[1, 0], m[1, 1], m[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    m[2, 0], m[2, 1], m[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)

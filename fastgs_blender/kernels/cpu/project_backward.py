# SPDX-License-Identifier: GPL-3.0-or-later
"""Backward pass of project.py: from gradients of splats to gradients of the model's arrays.

Every row has one Gaussian, so that nothing is added up across rows.  What the forward pass computed is computed again.
"""
from __future__ import annotations

import math

import numpy as np
from numba import float32

from . import raster
from .appearance import FEATURES, appear_backward, directed
from .jit import inline, kernel
from .lanes import exp
from .project import SCALE, _axes, _covariance, _cross, _moved3, _moved4, _project_axis, _quaternion, _shear, rows_of
from .temporal import temporal_slope

PER_LN2 = 1.0 / math.log(2.0)


@inline
def _clear(n, gradients):
    """Zeros for a Gaussian that was not drawn, or not seen."""
    position, rotation, scale, opacity, features, motion, rotation_motion, mu_tau, temporal = gradients
    zero = float32(0.0)
    for i in range(3):
        position[n, i], scale[n, i] = zero, zero
    for i in range(4):
        rotation[n, i] = zero
    for i in range(features.shape[1]):
        features[n, i] = zero
    for k in range(motion.shape[1]):
        for i in range(3):
            motion[n, k, i] = zero
    for k in range(rotation_motion.shape[1]):
        for i in range(4):
            rotation_motion[n, k, i] = zero
    for i in range(temporal.shape[1]):
        temporal[n, i] = zero
    opacity[n], mu_tau[n] = zero, zero


@inline
def _moves_nothing(row, g_geometry, g_log2, g_channels):
    """Whether a splat's gradient is zero: it was drawn, behind others that let nothing through."""
    moved = g_log2[row] != 0.0
    for i in range(g_geometry.shape[1]):
        moved = moved or g_geometry[row, i] != 0.0
    for i in range(g_channels.shape[1]):
        moved = moved or g_channels[row, i] != 0.0
    return not moved


@inline
def _spread3(c, n, index, weights, centred, delta, gx, gy, gz, out):
    """From the gradient of project._moved3 to that of c, written to out[n]; returns that of delta."""
    slope = 0.0
    if centred:
        power = 1.0
        for k in range(c.shape[1]):
            slope += (k + 1) * power * (gx * c[n, k, 0] + gy * c[n, k, 1] + gz * c[n, k, 2])
            power *= delta
            out[n, k, 0], out[n, k, 1], out[n, k, 2] = gx * power, gy * power, gz * power
    else:
        if len(index) < c.shape[1]:
            for k in range(c.shape[1]):
                out[n, k, 0], out[n, k, 1], out[n, k, 2] = 0.0, 0.0, 0.0
        for m in range(len(index)):
            w, k = weights[m], index[m]
            out[n, k, 0], out[n, k, 1], out[n, k, 2] = w * gx, w * gy, w * gz
    return slope


@inline
def _spread4(c, n, index, weights, centred, delta, gw, gx, gy, gz, out):
    """The same of project._moved4."""
    slope = 0.0
    if centred:
        power = 1.0
        for k in range(c.shape[1]):
            slope += (k + 1) * power * (gw * c[n, k, 0] + gx * c[n, k, 1] + gy * c[n, k, 2] + gz * c[n, k, 3])
            power *= delta
            out[n, k, 0], out[n, k, 1], out[n, k, 2], out[n, k, 3] = gw * power, gx * power, gy * power, gz * power
    else:
        if len(index) < c.shape[1]:
            for k in range(c.shape[1]):
                out[n, k, 0], out[n, k, 1], out[n, k, 2], out[n, k, 3] = 0.0, 0.0, 0.0, 0.0
        for m in range(len(index)):
            w, k = weights[m], index[m]
            out[n, k, 0], out[n, k, 1], out[n, k, 2], out[n, k, 3] = w * gw, w * gx, w * gy, w * gz
    return slope


@inline
def _quaternion_slope(q, g0, g1, g2):
    """Gradient of a quaternion before it was normalised, from those of the columns of its rotation matrix."""
    w, x, y, z, norm = q
    if norm == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    gw = 2.0 * (x * (g1[2] - g2[1]) + y * (g2[0] - g0[2]) + z * (g0[1] - g1[0]))
    gx = 2.0 * (w * (g1[2] - g2[1]) + y * (g1[0] + g0[1]) + z * (g2[0] + g0[2]) - 2.0 * x * (g1[1] + g2[2]))
    gy = 2.0 * (w * (g2[0] - g0[2]) + x * (g1[0] + g0[1]) + z * (g2[1] + g1[2]) - 2.0 * y * (g0[0] + g2[2]))
    gz = 2.0 * (w * (g0[1] - g1[0]) + x * (g2[0] + g0[2]) + y * (g2[1] + g1[2]) - 2.0 * z * (g0[0] + g1[1]))
    along = gw * w + gx * x + gy * y + gz * z
    return (gw - along * w) / norm, (gx - along * x) / norm, (gy - along * y) / norm, (gz - along * z) / norm


@kernel
def project_backward(first, last, row, end, source, slopes, detach_time, gradients, arrays, times, view, lens, constants, channel_plan):
    """Gradients of the Gaussians first..last, of which the rows row..end were written; source as project.project gives it.

    slopes       gradients of the splats: geometry [M, 5], log2 of the opacity [M], channels [M, C]
    detach_time  mu_tau's gradient comes through the temporal opacity alone (STG)
    gradients    as `arrays`, written in full: zeros for Gaussians that were not drawn
    arrays ...   see project.project
    """
    position, rotation, scale, opacity, features, motion, rotation_motion, mu_tau, temporal = arrays
    g_position, g_rotation, g_scale, g_opacity, g_features, g_motion, g_rotation_motion, g_mu_tau, g_temporal = gradients
    g_geometry, g_log2, g_channels = slopes
    t, temporal_code, (m_index, m_weights, m_centred), (r_index, r_weights, r_centred) = times
    fx, fy, _, _, _, _, low_x, high_x, low_y, high_y, _, _, _, _ = lens
    blur, _, _, antialiased, orthographic, _, _ = constants
    appearance, degree, channel, _, depth_channel, _ = channel_plan
    row0, row1, row2, shift, eye = rows_of(view)
    terms, colour = np.empty(25), np.empty(3)
    for n in range(first, last):
        if row == end or source[row] != n:
            _clear(n, gradients)
            continue
        if _moves_nothing(row, g_geometry, g_log2, g_channels):
            _clear(n, gradients)
            row += 1
            continue
        delta = t - np.float64(mu_tau[n])
        px, py, pz = _moved3(motion, n, m_index, m_weights, m_centred, delta)
        px, py, pz = px + position[n, 0], py + position[n, 1], pz + position[n, 2]
        x = row0[0] * px + row0[1] * py + row0[2] * pz + shift[0]
        y = row1[0] * px + row1[1] * py + row1[2] * pz + shift[1]
        z = row2[0] * px + row2[1] * py + row2[2] * pz + shift[2]
        q = _quaternion(rotation, n, _moved4(rotation_motion, n, r_index, r_weights, r_centred, delta))
        _, _, a02, a12, per_depth = _shear(x, y, z, lens, orthographic)
        axes = _axes(q[0], q[1], q[2], q[3])
        u0, v0 = _project_axis(axes[0], row0, row1, row2, a02, a12)
        u1, v1 = _project_axis(axes[1], row0, row1, row2, a02, a12)
        u2, v2 = _project_axis(axes[2], row0, row1, row2, a02, a12)
        size0, size1, size2 = exp(scale[n, 0]) * per_depth, exp(scale[n, 1]) * per_depth, exp(scale[n, 2]) * per_depth
        u, v = (fx * u0 * size0, fx * u1 * size1, fx * u2 * size2), (fy * v0 * size0, fy * v1 * size1, fy * v2 * size2)
        _, s01, s11, sharp, det = _covariance(u, v, blur)

        # opacity
        g_sigma = PER_LN2 * np.float64(g_log2[row])
        g_opacity[n] = g_sigma * (1.0 - 1.0 / (1.0 + exp(-opacity[n])))
        g_mu = temporal_slope(temporal_code, t, np.float64(mu_tau[n]), temporal, n, g_sigma, g_temporal)

        # the triangle of the inverse covariance: L11 = SCALE sqrt(s11 / det), L21 = -SCALE s01 / sqrt(s11 det), L22 = SCALE / sqrt(s11)
        root, root_det = math.sqrt(s11), math.sqrt(det)
        g11 = np.float64(g_geometry[row, raster.L11]) * SCALE * root / root_det
        g21 = np.float64(g_geometry[row, raster.L21]) * SCALE / (root * root_det)
        g22 = np.float64(g_geometry[row, raster.L22]) * SCALE / root
        g_det = -0.5 * (g11 - g21 * s01) / det
        g_s11 = 0.5 * (g11 + g21 * s01 - g22) / s11
        g_s01 = -g21
        g_sharp = 0.0
        if antialiased:
            g_det -= 0.5 * g_sigma / det
            g_sharp = 0.5 * g_sigma / sharp
        # det = sharp + blur (u.u + v.v) + blur^2, sharp = |u x v|^2
        g_sharp, g_uu, g_vv = 2.0 * (g_sharp + g_det), 2.0 * blur * g_det, 2.0 * (blur * g_det + g_s11)
        normal = _cross(u, v)
        across_u, across_v = _cross(v, normal), _cross(normal, u)
        gu0, gv0 = g_sharp * across_u[0] + g_uu * u[0] + g_s01 * v[0], g_sharp * across_v[0] + g_vv * v[0] + g_s01 * u[0]
        gu1, gv1 = g_sharp * across_u[1] + g_uu * u[1] + g_s01 * v[1], g_sharp * across_v[1] + g_vv * v[1] + g_s01 * u[1]
        gu2, gv2 = g_sharp * across_u[2] + g_uu * u[2] + g_s01 * v[2], g_sharp * across_v[2] + g_vv * v[2] + g_s01 * u[2]
        scale0, scale1, scale2 = gu0 * u[0] + gv0 * v[0], gu1 * u[1] + gv1 * v[1], gu2 * u[2] + gv2 * v[2]
        g_scale[n, 0], g_scale[n, 1], g_scale[n, 2] = scale0, scale1, scale2

        # the axes, and through the shear and the depth the position in the camera
        gu0, gu1, gu2 = gu0 * fx * size0, gu1 * fx * size1, gu2 * fx * size2
        gv0, gv1, gv2 = gv0 * fy * size0, gv1 * fy * size1, gv2 * fy * size2
        r0, r1, r2 = row0[0] + a02 * row2[0], row0[1] + a02 * row2[1], row0[2] + a02 * row2[2]
        s0, s1, s2 = row1[0] + a12 * row2[0], row1[1] + a12 * row2[1], row1[2] + a12 * row2[2]
        axis0 = (gu0 * r0 + gv0 * s0, gu0 * r1 + gv0 * s1, gu0 * r2 + gv0 * s2)
        axis1 = (gu1 * r0 + gv1 * s0, gu1 * r1 + gv1 * s1, gu1 * r2 + gv1 * s2)
        axis2 = (gu2 * r0 + gv2 * s0, gu2 * r1 + gv2 * s1, gu2 * r2 + gv2 * s2)
        gx, gy = fx * np.float64(g_geometry[row, raster.MEAN_X]), fy * np.float64(g_geometry[row, raster.MEAN_Y])
        gz = np.float64(g_channels[row, depth_channel]) if depth_channel >= 0 else 0.0
        if not orthographic:
            tan_x, tan_y = x / z, y / z
            deep0 = row2[0] * axes[0][0] + row2[1] * axes[0][1] + row2[2] * axes[0][2]
            deep1 = row2[0] * axes[1][0] + row2[1] * axes[1][1] + row2[2] * axes[1][2]
            deep2 = row2[0] * axes[2][0] + row2[1] * axes[2][1] + row2[2] * axes[2][2]
            if tan_x > low_x and tan_x < high_x:
                gx -= gu0 * deep0 + gu1 * deep1 + gu2 * deep2
            if tan_y > low_y and tan_y < high_y:
                gy -= gv0 * deep0 + gv1 * deep1 + gv2 * deep2
            gx, gy = gx / z, gy / z
            gz -= gx * tan_x + gy * tan_y + (scale0 + scale1 + scale2) / z
        gx, gy, gz = (row0[0] * gx + row1[0] * gy + row2[0] * gz, row0[1] * gx + row1[1] * gy + row2[1] * gz,
                      row0[2] * gx + row1[2] * gy + row2[2] * gz)

        # colour
        g_delta = 0.0
        if directed(appearance):
            by_x, by_y, by_z = appear_backward(appearance, features, n, degree, px, py, pz, eye, orthographic, g_channels, row, channel,
                                               terms, colour, g_features)
            gx, gy, gz = gx + by_x, gy + by_y, gz + by_z
        else:
            for c in range(9 if appearance == FEATURES else 3):
                g = np.float64(g_channels[row, channel + c])
                if c >= 6:
                    g_delta += g * features[n, c]
                    g *= delta
                g_features[n, c] = g

        # time
        g_position[n, 0], g_position[n, 1], g_position[n, 2] = gx, gy, gz
        g_delta += _spread3(motion, n, m_index, m_weights, m_centred, delta, gx, gy, gz, g_motion)
        qw, qx, qy, qz = _quaternion_slope(q, axis0, axis1, axis2)
        g_rotation[n, 0], g_rotation[n, 1], g_rotation[n, 2], g_rotation[n, 3] = qw, qx, qy, qz
        g_delta += _spread4(rotation_motion, n, r_index, r_weights, r_centred, delta, qw, qx, qy, qz, g_rotation_motion)
        g_mu_tau[n] = g_mu if detach_time else g_mu - g_delta
        row += 1


@kernel
def observe(first, last, source, g_geometry, g_absolute, attributes, size, gradient, absolute, seen, radius):
    """Add the rows first..last of one view to the statistics of training (training/core/statistics.py), each [N].

    size: of the whole image, in pixels.
    """
    half_x, half_y = 0.5 * size[0], 0.5 * size[1]
    longest = np.float64(max(size[0], size[1]))
    for row in range(first, last):
        n = source[row]
        gradient[n] += math.hypot(g_geometry[row, raster.MEAN_X] * half_x, g_geometry[row, raster.MEAN_Y] * half_y)
        absolute[n] += math.hypot(g_absolute[row, 0] * half_x, g_absolute[row, 1] * half_y)
        seen[n] += float32(1.0)
        radius[n] = max(radius[n], float32(max(attributes[row, raster.RADIUS_X], attributes[row, raster.RADIUS_Y]) / longest))

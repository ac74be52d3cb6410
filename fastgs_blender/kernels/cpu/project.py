# SPDX-License-Identifier: GPL-3.0-or-later
"""Slice, cull and project, fused: one pass over a model's arrays at one time, for one camera.

A Gaussian that is not opaque enough at this time, lies before the near plane or off the window leaves the pass as early as
possible.  Arithmetic is float64: arrays are float32, but far or long thin splats need the precision.
"""
from __future__ import annotations

import math

import numpy as np
from numba import float32

from ...rendering import oracle
from ...rendering.distance import MARGIN, STEEP
from ...rendering.instances import LIMIT
from . import raster
from .crop import crop_share, in_ball
from .jit import exp, inline, kernel
from .look import FAINTEST, GRADED, OPACITY, SIZED, grade, size_factor
from .spherical import sh_colour
from .temporal import temporal_factor

RGB, SH, FEATURES = range(3)
REACH = oracle.REACH
PIXEL = 4
"""Place of a view's pixel size in distance.Sampling.row."""
SCALE = math.sqrt(0.5 * math.log2(math.e))
"""Turns a Mahalanobis distance into the root of the exponent of 2."""


@inline
def rows_of(view):
    """The rows of view [5, 3] as numbers: arrays would be read again after every write."""
    return ((view[0, 0], view[0, 1], view[0, 2]), (view[1, 0], view[1, 1], view[1, 2]), (view[2, 0], view[2, 1], view[2, 2]),
            (view[3, 0], view[3, 1], view[3, 2]), (view[4, 0], view[4, 1], view[4, 2]))


@inline
def _moved3(c, n, index, weights, centred, delta):
    """Sum of the weighted coefficients c[n] [K, 3]: with powers of delta, or of those listed, with their weights."""
    x, y, z = 0.0, 0.0, 0.0
    if centred:
        for k in range(c.shape[1] - 1, -1, -1):
            x, y, z = (x + c[n, k, 0]) * delta, (y + c[n, k, 1]) * delta, (z + c[n, k, 2]) * delta
    else:
        for m in range(len(index)):
            w, k = weights[m], index[m]
            x, y, z = x + w * c[n, k, 0], y + w * c[n, k, 1], z + w * c[n, k, 2]
    return x, y, z


@inline
def _moved4(c, n, index, weights, centred, delta):
    """The same for c[n] [K, 4]."""
    a, x, y, z = 0.0, 0.0, 0.0, 0.0
    if centred:
        for k in range(c.shape[1] - 1, -1, -1):
            a, x, y, z = (a + c[n, k, 0]) * delta, (x + c[n, k, 1]) * delta, (y + c[n, k, 2]) * delta, (z + c[n, k, 3]) * delta
    else:
        for m in range(len(index)):
            w, k = weights[m], index[m]
            a, x, y, z = a + w * c[n, k, 0], x + w * c[n, k, 1], y + w * c[n, k, 2], z + w * c[n, k, 3]
    return a, x, y, z


@inline
def _quaternion(constant, n, turn):
    """The unit quaternion of constant[n] + turn, and the length of the sum; the identity and 0 where that vanishes."""
    qw, qx, qy, qz = turn
    qw, qx, qy, qz = qw + constant[n, 0], qx + constant[n, 1], qy + constant[n, 2], qz + constant[n, 3]
    norm = math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
    if norm <= 1e-12:
        return 1.0, 0.0, 0.0, 0.0, 0.0
    unit = 1.0 / norm
    return qw * unit, qx * unit, qy * unit, qz * unit, norm


@inline
def _axes(qw, qx, qy, qz):
    """Columns of the rotation matrix of a unit quaternion."""
    return ((1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy + qw * qz), 2 * (qx * qz - qw * qy)),
            (2 * (qx * qy - qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz + qw * qx)),
            (2 * (qx * qz + qw * qy), 2 * (qy * qz - qw * qx), 1 - 2 * (qx * qx + qy * qy)))


@inline
def _shear(x, y, z, lens, orthographic):
    """Centre in pixels, the Jacobian's third column (without focal length and depth), and 1 / depth (orthographic: 1)."""
    fx, fy, cx, cy, _, _, low_x, high_x, low_y, high_y, _, _, _, _ = lens
    if orthographic:
        return fx * x + cx, fy * y + cy, 0.0, 0.0, 1.0
    return fx * (x / z) + cx, fy * (y / z) + cy, -min(max(x / z, low_x), high_x), -min(max(y / z, low_y), high_y), 1.0 / z


@inline
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inline
def _turned(axis, row0, row1, row2, size):
    """An axis in model space, of a size, in the camera."""
    x, y, z = axis
    return ((row0[0] * x + row0[1] * y + row0[2] * z) * size, (row1[0] * x + row1[1] * y + row1[2] * z) * size,
            (row2[0] * x + row2[1] * y + row2[2] * z) * size)


@inline
def _nearness(x, y, z, along_x, along_y, f0, f1, f2):
    """oracle.nearness of a Gaussian beside the picture, from the columns of its factor in the camera."""
    deep = math.sqrt(f0[2] * f0[2] + f1[2] * f1[2] + f2[2] * f2[2])
    if not z < REACH * deep:
        return 1.0 / z
    share = min(REACH - z / deep, 1.0)
    s0, s1, s2 = _cross(f1, f2), _cross(f2, f0), _cross(f0, f1)
    a0, a1, a2 = (s0[0] * along_x + s0[1] * along_y + s0[2], s1[0] * along_x + s1[1] * along_y + s1[2],
                  s2[0] * along_x + s2[1] * along_y + s2[2])
    square = a0 * a0 + a1 * a1 + a2 * a2
    densest = z
    if square > 0.0:
        densest = max((a0 * (s0[0] * x + s0[1] * y + s0[2] * z) + a1 * (s1[0] * x + s1[1] * y + s1[2] * z)
                       + a2 * (s2[0] * x + s2[1] * y + s2[2] * z)) / square, 0.5 * z)
    return (1.0 - share) / z + share / densest


@inline
def _covariance(u, v, blur):
    """Of the rows u, v of the factor J W R S: blurred covariance s00, s01, s11; determinants before and after the blur."""
    u0, u1, u2 = u
    v0, v1, v2 = v
    s00, s01, s11 = u0 * u0 + u1 * u1 + u2 * u2, u0 * v0 + u1 * v1 + u2 * v2, v0 * v0 + v1 * v1 + v2 * v2
    sharp = (u1 * v2 - u2 * v1) ** 2 + (u2 * v0 - u0 * v2) ** 2 + (u0 * v1 - u1 * v0) ** 2
    return s00 + blur, s01, s11 + blur, sharp, sharp + blur * (s00 + s11) + blur * blur


@inline
def _direction(px, py, pz, eye, orthographic):
    """Unit direction in which a position is seen, and its length before."""
    if orthographic:
        dx, dy, dz = eye[0], eye[1], eye[2]
    else:
        dx, dy, dz = px - eye[0], py - eye[1], pz - eye[2]
    norm = max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-30)
    return dx / norm, dy / norm, dz / norm, norm


@inline
def _project_axis(axis, row0, row1, row2, a02, a12):
    """An axis in model space, in the camera, sheared by the projection: u and v before focal length and depth."""
    x, y, z = axis
    depth = row2[0] * x + row2[1] * y + row2[2] * z
    return row0[0] * x + row0[1] * y + row0[2] * z + a02 * depth, row1[0] * x + row1[1] * y + row1[2] * z + a12 * depth


@inline
def _depths(axis0, axis1, axis2, row2, size0, size1, size2):
    """How far the ends of the axes lie in depth."""
    return ((row2[0] * axis0[0] + row2[1] * axis0[1] + row2[2] * axis0[2]) * size0,
            (row2[0] * axis1[0] + row2[1] * axis1[1] + row2[2] * axis1[2]) * size1,
            (row2[0] * axis2[0] + row2[1] * axis2[1] + row2[2] * axis2[2]) * size2)


@inline
def _slope(d0, d1, d2, u, v, s00, s01, s11, det, z, radius_x, radius_y):
    """Change of a splat's depth by pixel in x and y: oracle.plane."""
    along_u, along_v = d0 * u[0] + d1 * u[1] + d2 * u[2], d0 * v[0] + d1 * v[1] + d2 * v[2]
    x, y = (s11 * along_u - s01 * along_v) / det, (s00 * along_v - s01 * along_u) / det
    change = abs(x) * radius_x + abs(y) * radius_y
    if change > z:
        x, y = x * (z / change), y * (z / change)
    if not (abs(x) < np.inf and abs(y) < np.inf):
        return 0.0, 0.0
    return x, y


@inline
def coarsest(px, py, pz, row):
    """distance.Sampling.coarsest() of one Gaussian; row: Sampling.row."""
    cx, cy, cz, radius, _, coarse, least, _, _ = row
    return max(least, coarse * (radius + math.sqrt((px - cx) ** 2 + (py - cy) ** 2 + (pz - cz) ** 2)))


@inline
def _blurs(px, py, pz, depth, largest, blur, sampling):
    """distance.Sampling.blurs() of one Gaussian."""
    row, cameras = sampling
    _, _, _, _, pixel, _, least, reach, fades = row
    size, found = pixel * depth, coarsest(px, py, pz, row)
    if size > MARGIN * found:
        return blur, blur * (MARGIN * found / size) ** 2 if fades > 0.0 else blur
    for i in range(len(cameras)):
        if not found > MARGIN * size:
            break
        x, y, z = px - cameras[i, 0], py - cameras[i, 1], pz - cameras[i, 2]
        along = x * cameras[i, 4] + y * cameras[i, 5] + z * cameras[i, 6]
        near = abs(along) * cameras[i, 3]
        if near < found:
            r = math.sqrt(max(x * x + y * y + z * z - along * along, 0.0))
            found = min(found, near + STEEP * max((r - reach * largest) * cameras[i, 7] - along, 0.0) * cameras[i, 3])
    finer = max(max(found, least) / (MARGIN * size), 1.0)
    return blur * finer * finer, blur * finer * finer


@kernel
def project(first, last, boxes, look, arrays, times, view, lens, constants, channel_plan, geometry, attributes, depth, source):
    """Project the Gaussians first..last; write those that can be seen from row `first` on and return their number.

    boxes      crops.crop_arrays of what crops the model; ViewedInstance.ball; which are hidden, [N] bool or [0]
    look       [LOOK_NUMBERS] float64, see rendering/looks.py
    arrays     position, rotation, scale, opacity, features, motion, rotation_motion, mu_tau, temporal of the model
    times      (t, temporal code, (index, weights, centred) of the motion, the same of the rotation)
    view       [5, 3] float64: rows 0-2 model to camera, row 3 its translation, row 4 the camera's centre (or, orthographic,
               its direction) in model space
    lens       [14] float64: fx, fy, cx, cy, near, far, limits of x/z and y/z (4), first and last pixel centre in x and in y (4)
    constants  (blur, alpha max, alpha cut, antialiased, orthographic, (Sampling.row, Sampling.cameras), ObjectSettings.bends)
    channel_plan       (appearance code, degree, first channel, weight channel or -1, depth channel or -1, (first of the plane's channels
                       or -1, the middle of the image in x and in y, whether planes are blurred))
    geometry, attributes, depth   of the splats, see raster.py
    source     int32: which Gaussian each row is
    """
    crops, ball, hidden = boxes
    position, rotation, scale, opacity, features, motion, rotation_motion, mu_tau, temporal = arrays
    t, temporal_code, (m_index, m_weights, m_centred), (r_index, r_weights, r_centred) = times
    fx, fy, _, _, near, far, _, _, _, _, left, right, top, bottom = lens
    trained_blur, alpha_max, alpha_cut, antialiased, orthographic, sampling, bends = constants
    appearance, degree, channel, weight_channel, depth_channel, (plane_channel, middle_x, middle_y, blurred) = channel_plan
    terms, colour, (row0, row1, row2, shift, eye) = np.empty(25), np.empty(3), rows_of(view)
    log2_cut, sized, graded, opaqueness = math.log2(alpha_cut), look[SIZED] != 0.0, look[GRADED] != 0.0, look[OPACITY]
    hides, filtered, sampled = len(crops[1]) > 0, len(hidden) > 0, sampling[0][PIXEL] > 0.0
    out = first
    for n in range(np.uintp(first), np.uintp(last)):
        if (filtered and hidden[n]) or not in_ball(position, n, ball):
            continue
        faintness = 1.0 + exp(-opacity[n])
        if faintness > look[FAINTEST]:
            continue
        sigma = temporal_factor(temporal_code, t, np.float64(mu_tau[n]), temporal, n) / faintness * opaqueness
        if not (sigma >= alpha_cut):
            continue
        delta = t - np.float64(mu_tau[n])
        px, py, pz = _moved3(motion, n, m_index, m_weights, m_centred, delta)
        px, py, pz = px + position[n, 0], py + position[n, 1], pz + position[n, 2]
        if hides:
            sigma *= crop_share(px, py, pz, crops)
            if not (sigma >= alpha_cut):
                continue
        x = row0[0] * px + row0[1] * py + row0[2] * pz + shift[0]
        y = row1[0] * px + row1[1] * py + row1[2] * pz + shift[1]
        z = row2[0] * px + row2[1] * py + row2[2] * pz + shift[2]
        if not (z > near and z <= far):
            continue

        qw, qx, qy, qz, _ = _quaternion(rotation, n, _moved4(rotation_motion, n, r_index, r_weights, r_centred, delta))
        mx, my, a02, a12, per_depth = _shear(x, y, z, lens, orthographic)
        # columns of the rotation matrix, turned into the camera, projected and scaled
        axis0, axis1, axis2 = _axes(qw, qx, qy, qz)
        resized = size_factor(exp(max(scale[n, 0], scale[n, 1], scale[n, 2])), look) if sized else 1.0
        if bends and not orthographic and (a02 != -(x / z) or a12 != -(y / z)):
            near_by = _nearness(x, y, z, -a02, -a12, _turned(axis0, row0, row1, row2, exp(scale[n, 0]) * resized),
                                _turned(axis1, row0, row1, row2, exp(scale[n, 1]) * resized),
                                _turned(axis2, row0, row1, row2, exp(scale[n, 2]) * resized))
            if near_by != per_depth:
                per_depth = near_by
                mx, my = fx * ((x + a02 * z) * per_depth - a02) + lens[2], fy * ((y + a12 * z) * per_depth - a12) + lens[3]
        u0, v0 = _project_axis(axis0, row0, row1, row2, a02, a12)
        u1, v1 = _project_axis(axis1, row0, row1, row2, a02, a12)
        u2, v2 = _project_axis(axis2, row0, row1, row2, a02, a12)
        unit = per_depth
        if sized:
            unit *= resized
        size0, size1, size2 = exp(scale[n, 0]) * unit, exp(scale[n, 1]) * unit, exp(scale[n, 2]) * unit
        u, v = (fx * u0 * size0, fx * u1 * size1, fx * u2 * size2), (fy * v0 * size0, fy * v1 * size1, fy * v2 * size2)
        blur, small = trained_blur, trained_blur
        if sampled:
            largest = exp(max(scale[n, 0], scale[n, 1], scale[n, 2])) * resized
            blur, small = _blurs(px, py, pz, 1.0 if orthographic else z, largest, trained_blur, sampling)
        s00, s01, s11, sharp, det = _covariance(u, v, blur)
        if not (det > 0.0 and s00 + s11 < np.inf):
            continue
        if antialiased:
            sigma *= math.sqrt(sharp / det)
            if not (sigma >= alpha_cut):
                continue
        log2_sigma = np.float64(math.log2(np.float32(sigma)))
        reach = 2.0 * math.log(2.0) * (log2_sigma - log2_cut)
        radius_x, radius_y = math.sqrt(reach * s00), math.sqrt(reach * s11)
        if not (mx + radius_x >= left and mx - radius_x <= right and my + radius_y >= top and my - radius_y <= bottom):
            continue

        if appearance == SH:
            dx, dy, dz, _ = _direction(px, py, pz, eye, orthographic)
            sh_colour(features, n, degree, dx, dy, dz, terms, colour)
        elif graded:
            for c in range(3):
                colour[c] = features[n, c]
        if graded:
            grade(colour, look)
        good = True
        for c in range(raster.CHANNEL, attributes.shape[1]):
            attributes[out, c] = float32(0.0)
        for c in range(9 if appearance == FEATURES else 3):
            value = colour[c] if appearance == SH or graded else np.float64(features[n, c])
            if c >= 6:
                value *= delta
            good = good and abs(value) <= LIMIT
            attributes[out, raster.CHANNEL + channel + c] = value
        if not good:
            continue
        if weight_channel >= 0:
            attributes[out, raster.CHANNEL + weight_channel] = float32(1.0)
        if depth_channel >= 0:
            attributes[out, raster.CHANNEL + depth_channel] = z
        if plane_channel >= 0:
            d0, d1, d2 = _depths(axis0, axis1, axis2, row2, size0 / per_depth, size1 / per_depth, size2 / per_depth)
            less, area = (0.0, det) if blurred else (blur, sharp)
            slope_x, slope_y = _slope(d0, d1, d2, u, v, s00 - less, s01, s11 - less, area, z, radius_x, radius_y)
            plane = raster.CHANNEL + plane_channel
            attributes[out, plane] = z - slope_x * (mx - middle_x) - slope_y * (my - middle_y)
            attributes[out, plane + 1] = slope_x
            attributes[out, plane + 2] = slope_y
        faint = 0.0
        if small < blur:
            faint = 0.5 * math.log2((sharp + small * (s00 + s11 - 2.0 * blur) + small * small) / det)
            if not faint > -np.inf:
                continue
        root = math.sqrt(s11)
        l22, whole = SCALE / root, 1.0 / math.sqrt(det)
        geometry[out, raster.MEAN_X] = mx
        geometry[out, raster.MEAN_Y] = my
        geometry[out, raster.L11] = SCALE * root * whole
        geometry[out, raster.L21] = -s01 * l22 * whole
        geometry[out, raster.L22] = l22
        attributes[out, raster.LOG2_OPACITY] = log2_sigma + faint
        attributes[out, raster.ALPHA_MAX] = alpha_max
        attributes[out, raster.LOG2_CUT] = log2_cut + faint
        attributes[out, raster.DEPTH] = z
        attributes[out, raster.RADIUS_X] = radius_x + 1e-3
        attributes[out, raster.RADIUS_Y] = radius_y + 1e-3
        depth[out] = z
        source[out] = n
        out += 1
    return out - first

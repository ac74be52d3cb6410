# SPDX-License-Identifier: GPL-3.0-or-later
"""Slice, cull and project, fused: one pass over a model's arrays at one time, for one camera.

A Gaussian that is not opaque enough at this time or not before the camera is left out first; the rest are computed eight at a time
(lanes.py).  Arithmetic is float64: arrays are float32, but far or long thin splats need the precision.
"""
from __future__ import annotations

import math

import numpy as np

from ...rendering import oracle
from ...rendering.instances import LIMIT
from . import raster
from .appearance import FEATURES, appear, directed
from .crop import crop_share, in_ball
from .jit import inline, kernel
from .lanes import LANES, anywhere, bits, exp, following, four, log2, picked, put, room, take, three, where
from .look import FAINTEST, GRADED, OPACITY, SIZED, grade, size_factor
from .reaching import ROUNDING, before, extent, in_camera, put_boxes, rows_of
from .sampling import PIXEL, blurs, far_squared
from .simd import prefetch
from .temporal import temporal_factor

REACH = oracle.REACH
COLUMNS = 5
"""Columns of a splat's geometry.  What is made of eight Gaussians has a row for each, and then one for each of the attributes."""
AHEAD = 64
"""How many Gaussians ahead their coefficients of motion are asked for: these are most of what is read, and come late."""
SCALE = math.sqrt(0.5 * math.log2(math.e))
"""Turns a Mahalanobis distance into the root of the exponent of 2."""


@inline
def _moved3(c, n, index, weights, centred, delta):
    """Sum of the weighted coefficients c[n] [K, 3]: with powers of delta, or of those listed, with their weights."""
    x, y, z, w = 0.0, 0.0, 0.0, delta
    for m in range(c.shape[1] if centred else len(index)):
        k = m if centred else index[m]
        if not centred:
            w = weights[m]
        a, b, d = three(c, n, k)
        x, y, z = x + w * a, y + w * b, z + w * d
        if centred:
            w *= delta
    return x, y, z


@inline
def _moved4(c, n, index, weights, centred, delta):
    """The same for c[n] [K, 4]."""
    a, x, y, z, w = 0.0, 0.0, 0.0, 0.0, delta
    for m in range(c.shape[1] if centred else len(index)):
        k = m if centred else index[m]
        if not centred:
            w = weights[m]
        d, e, f, g = four(c, n, k)
        a, x, y, z = a + w * d, x + w * e, y + w * f, z + w * g
        if centred:
            w *= delta
    return a, x, y, z


@inline
def _quaternion(constant, n, turn):
    """The unit quaternion of constant[n] + turn, and the length of the sum; the identity and 0 where that vanishes."""
    qw, qx, qy, qz = turn
    cw, cx, cy, cz = four(constant, n)
    qw, qx, qy, qz = qw + cw, qx + cx, qy + cy, qz + cz
    norm = math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
    none = norm <= 1e-12
    unit = where(none, 0.0, 1.0 / norm)
    return where(none, 1.0, qw * unit), qx * unit, qy * unit, qz * unit, where(none, 0.0, norm)


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
    share = min(REACH - z / deep, 1.0)
    s0, s1, s2 = _cross(f1, f2), _cross(f2, f0), _cross(f0, f1)
    a0, a1, a2 = (s0[0] * along_x + s0[1] * along_y + s0[2], s1[0] * along_x + s1[1] * along_y + s1[2],
                  s2[0] * along_x + s2[1] * along_y + s2[2])
    square = a0 * a0 + a1 * a1 + a2 * a2
    densest = max((a0 * (s0[0] * x + s0[1] * y + s0[2] * z) + a1 * (s1[0] * x + s1[1] * y + s1[2] * z)
                   + a2 * (s2[0] * x + s2[1] * y + s2[2] * z)) / square, 0.5 * z)
    return where(z < REACH * deep, (1.0 - share) / z + share / where(square > 0.0, densest, z), 1.0 / z)


@inline
def _covariance(u, v, blur):
    """Of the rows u, v of the factor J W R S: blurred covariance s00, s01, s11; determinants before and after the blur."""
    u0, u1, u2 = u
    v0, v1, v2 = v
    s00, s01, s11 = u0 * u0 + u1 * u1 + u2 * u2, u0 * v0 + u1 * v1 + u2 * v2, v0 * v0 + v1 * v1 + v2 * v2
    normal0, normal1, normal2 = _cross(u, v)
    sharp = normal0 * normal0 + normal1 * normal1 + normal2 * normal2
    return s00 + blur, s01, s11 + blur, sharp, sharp + blur * (s00 + s11) + blur * blur


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
    whole = 1.0 / det
    x, y = (s11 * along_u - s01 * along_v) * whole, (s00 * along_v - s01 * along_u) * whole
    change = abs(x) * radius_x + abs(y) * radius_y
    less = where(change > z, z / change, 1.0)
    x, y = x * less, y * less
    finite = (abs(x) < np.inf) & (abs(y) < np.inf)
    return where(finite, x, 0.0), where(finite, y, 0.0)


@kernel
def opaque(first, last, boxes, look, arrays, times, view, lens, constants, number, found):
    """The Gaussians of first..last that are opaque enough at this time and may be seen; returns how many.

    Writes which they are into number, and their opacity and place into found [4, last - first + LANES].

    boxes      crops.crop_arrays of what crops the model; ViewedInstance.ball; which are hidden, [N] bool or [0]; reaching.cells_of()
    the rest   see project()
    """
    crops, ball, hidden, cells = boxes
    position, _, scale, opacity, _, motion, _, mu_tau, temporal = arrays
    t, temporal_code, (index, weights, centred), _ = times
    blur, _, alpha_cut, _, orthographic, (captured, _), bends = constants
    rows, near, far, (left, right, top, bottom) = rows_of(view), lens[4], lens[5], lens[10:]
    row0, row1, row2, shift, _ = rows
    log2_cut, sized, sampled = math.log2(alpha_cut), look[SIZED] != 0.0, captured[PIXEL] > 0.0
    finer = 1.0 / captured[PIXEL] if sampled else 0.0
    hides, filtered, asked, count, made = len(crops[1]) > 0, len(hidden) > 0, len(cells[0]) > 0, 0, room(5)
    for begin in range(first, last, LANES):
        n = following(begin, last)
        faintness = 1.0 + exp(-opacity[n])
        sigma = temporal_factor(temporal_code, t, mu_tau[n], temporal, n) / faintness * look[OPACITY]
        alive = in_ball(position, n, ball) & (faintness <= look[FAINTEST]) & (sigma >= alpha_cut)
        if not anywhere(alive):
            continue
        px, py, pz = _moved3(motion, n, index, weights, centred, t - mu_tau[n])
        x, y, z = three(position, n)
        px, py, pz = px + x, py + y, pz + z
        x, y, z = in_camera(px, py, pz, row0, row1, row2, shift)
        alive &= (z > near) & (z <= far)
        scale0, scale1, scale2 = three(scale, n)
        largest = exp(max(scale0, scale1, scale2))
        if sized:
            largest *= size_factor(largest, look)
        reach = 2.0 * math.log(2.0) * ROUNDING * (log2(sigma) - log2_cut)
        mx, my, wide, high, nearby = extent(x, y, z, largest, far_squared(px, py, pz, captured), rows, lens,
                                            (reach, blur, finer, orthographic, bends))
        across, down = max(left - mx, mx - right, 0.0), max(top - my, my - bottom, 0.0)
        alive &= ((across * across <= wide) & (down * down <= high)) | nearby
        if asked:
            put_boxes(made, mx, my, wide, high, z, cells)
        put(found, 0, count, sigma)
        put(found, 1, count, px)
        put(found, 2, count, py)
        put(found, 3, count, pz)
        lanes, everywhere, begun = bits(alive), bits(nearby), count
        for lane in range(min(LANES, last - begin)):
            prefetch(motion, min(begin + lane + AHEAD, last - 1))
            if not lanes >> lane & 1 or (filtered and hidden[begin + lane]):
                continue
            if asked and not (everywhere >> lane & 1 or before(made, lane, cells[0])):
                continue
            for row in range(4):
                found[row, count] = found[row, begun + lane]
            if hides:
                found[0, count] *= crop_share(found[1, count], found[2, count], found[3, count], crops)
                if not (found[0, count] >= alpha_cut):
                    continue
            number[count] = begin + lane
            count += 1
    return count


@kernel
def project(row, count, number, found, look, arrays, times, view, lens, constants, channel_plan, geometry, attributes, depth, source):
    """Project the `count` Gaussians that opaque() found; write those that can be seen from `row` on and return their number.

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
    _, rotation, scale, _, features, _, rotation_motion, mu_tau, _ = arrays
    t, _, _, (r_index, r_weights, r_centred) = times
    fx, fy, _, _, _, _, _, _, _, _, left, right, top, bottom = lens
    trained_blur, alpha_max, alpha_cut, antialiased, orthographic, sampling, bends = constants
    appearance, degree, channel, weight_channel, depth_channel, (plane_channel, middle_x, middle_y, blurred) = channel_plan
    terms, shown, (row0, row1, row2, shift, eye) = np.empty(25), np.empty(9), rows_of(view)
    log2_cut, sized, graded, sampled = math.log2(alpha_cut), look[SIZED] != 0.0, look[GRADED] != 0.0, sampling[0][PIXEL] > 0.0
    made, width, out = room(COLUMNS + attributes.shape[1]), np.uintp(attributes.shape[1]), np.uintp(row)
    made[:] = 0.0
    made[COLUMNS + raster.ALPHA_MAX], made[COLUMNS + raster.LOG2_CUT] = alpha_max, log2_cut
    begin = COLUMNS + raster.CHANNEL
    colour, colours = begin + channel, 9 if appearance == FEATURES else 3
    if weight_channel >= 0:
        made[begin + weight_channel] = 1.0
    for k in range(0, count, LANES):
        n = picked(number, k, count)
        sigma, px, py, pz = take(found, 0, k), take(found, 1, k), take(found, 2, k), take(found, 3, k)
        x, y, z = in_camera(px, py, pz, row0, row1, row2, shift)
        delta = t - mu_tau[n]
        qw, qx, qy, qz, _ = _quaternion(rotation, n, _moved4(rotation_motion, n, r_index, r_weights, r_centred, delta))
        mx, my, a02, a12, per_depth = _shear(x, y, z, lens, orthographic)
        # columns of the rotation matrix, turned into the camera, projected and scaled
        axis0, axis1, axis2 = _axes(qw, qx, qy, qz)
        scale0, scale1, scale2 = three(scale, n)
        scale0, scale1, scale2 = exp(scale0), exp(scale1), exp(scale2)
        largest = max(scale0, scale1, scale2)
        resized = size_factor(largest, look) if sized else 1.0
        if bends and not orthographic:
            beside = (a02 != -(x / z)) | (a12 != -(y / z))
            if anywhere(beside):
                near_by = where(beside, _nearness(x, y, z, -a02, -a12, _turned(axis0, row0, row1, row2, scale0 * resized),
                                                  _turned(axis1, row0, row1, row2, scale1 * resized),
                                                  _turned(axis2, row0, row1, row2, scale2 * resized)), per_depth)
                moved = near_by != per_depth
                mx = where(moved, fx * ((x + a02 * z) * near_by - a02) + lens[2], mx)
                my = where(moved, fy * ((y + a12 * z) * near_by - a12) + lens[3], my)
                per_depth = near_by
        u0, v0 = _project_axis(axis0, row0, row1, row2, a02, a12)
        u1, v1 = _project_axis(axis1, row0, row1, row2, a02, a12)
        u2, v2 = _project_axis(axis2, row0, row1, row2, a02, a12)
        unit = per_depth
        if sized:
            unit *= resized
        size0, size1, size2 = scale0 * unit, scale1 * unit, scale2 * unit
        u, v = (fx * u0 * size0, fx * u1 * size1, fx * u2 * size2), (fy * v0 * size0, fy * v1 * size1, fy * v2 * size2)
        blur, small = trained_blur, trained_blur
        if sampled:
            blur, small = blurs(px, py, pz, 1.0 if orthographic else z, largest * resized, trained_blur, sampling)
        s00, s01, s11, sharp, det = _covariance(u, v, blur)
        alive = (det > 0.0) & (s00 + s11 < np.inf)
        if antialiased:
            sigma *= math.sqrt(sharp / det)
            alive &= sigma >= alpha_cut
        log2_sigma = log2(sigma)
        reach = 2.0 * math.log(2.0) * (log2_sigma - log2_cut)
        radius_x, radius_y = math.sqrt(reach * s00), math.sqrt(reach * s11)
        alive &= (mx + radius_x >= left) & (mx - radius_x <= right) & (my + radius_y >= top) & (my - radius_y <= bottom)
        if not anywhere(alive):
            continue
        if sampled:
            faded = small < blur
            area = sharp + small * (s00 + s11 - 2.0 * blur) + small * small
            faint = where(faded, 0.5 * log2(where(faded, area / det, 1.0)), 0.0)
            alive &= (area > 0.0) | (small >= blur)
            put(made, COLUMNS + raster.LOG2_CUT, 0, log2_cut + faint)
            log2_sigma += faint
        root = math.sqrt(s11)
        l22, whole = SCALE / root, 1.0 / math.sqrt(det)
        put(made, raster.MEAN_X, 0, mx)
        put(made, raster.MEAN_Y, 0, my)
        put(made, raster.L11, 0, SCALE * root * whole)
        put(made, raster.L21, 0, -s01 * l22 * whole)
        put(made, raster.L22, 0, l22)
        put(made, COLUMNS + raster.LOG2_OPACITY, 0, log2_sigma)
        put(made, COLUMNS + raster.RADIUS_X, 0, radius_x + 1e-3)
        put(made, COLUMNS + raster.RADIUS_Y, 0, radius_y + 1e-3)
        put(made, COLUMNS + raster.DEPTH, 0, z)
        if depth_channel >= 0:
            put(made, begin + depth_channel, 0, z)
        if plane_channel >= 0:
            d0, d1, d2 = _depths(axis0, axis1, axis2, row2, scale0 * resized, scale1 * resized, scale2 * resized)
            less, area = (0.0, det) if blurred else (blur, sharp)
            slope_x, slope_y = _slope(d0, d1, d2, u, v, s00 - less, s01, s11 - less, area, z, radius_x, radius_y)
            plane = begin + plane_channel
            put(made, plane, 0, z - slope_x * (mx - middle_x) - slope_y * (my - middle_y))
            put(made, plane + 1, 0, slope_x)
            put(made, plane + 2, 0, slope_y)
        if not directed(appearance):
            for c in range(colours):
                put(made, colour + c, 0, features[n, c] * delta if c >= 6 else features[n, c])
        if directed(appearance) or graded:
            for lane in range(LANES):
                i = number[min(k + lane, count - 1)]
                for c in range(colours):
                    shown[c] = made[colour + c, lane]
                if directed(appearance):
                    appear(appearance, features, i, degree, found[1, k + lane], found[2, k + lane], found[3, k + lane], t - mu_tau[i], eye,
                           orthographic, terms, shown)
                if graded:
                    grade(shown, look)
                for c in range(colours):
                    made[colour + c, lane] = shown[c]
        for c in range(colours):
            alive &= abs(take(made, colour + c, 0)) <= LIMIT

        lanes = bits(alive)
        for lane in range(np.uintp(min(LANES, count - k))):
            # written anyway, and kept where it is seen: no branch, which the processor might guess wrong
            for c in range(np.uintp(COLUMNS)):
                geometry[out, c] = made[c, lane]
            for c in range(width):
                attributes[out, c] = made[np.uintp(COLUMNS) + c, lane]
            depth[out] = made[np.uintp(COLUMNS + raster.DEPTH), lane]
            source[out] = number[np.uintp(k) + lane]
            out += np.uintp(lanes) >> lane & np.uintp(1)
    return np.intp(out) - row

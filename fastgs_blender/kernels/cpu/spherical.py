# SPDX-License-Identifier: GPL-3.0-or-later
"""Spherical harmonics for one Gaussian: appearance.sh_basis as scalar code, and its derivative."""
from __future__ import annotations

from .jit import inline


@inline
def sh_terms(degree, x, y, z, terms):
    """terms[:(degree + 1)^2] = Y_b(x, y, z)."""
    terms[0] = 0.28209479177387814
    if degree > 0:
        terms[1], terms[2], terms[3] = -0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x
    xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
    if degree > 1:
        terms[4], terms[5], terms[7] = 1.0925484305920792 * xy, -1.0925484305920792 * yz, -1.0925484305920792 * xz
        terms[6], terms[8] = 0.31539156525252005 * (2 * zz - xx - yy), 0.5462742152960396 * (xx - yy)
    if degree > 2:
        terms[9], terms[15] = -0.5900435899266435 * y * (3 * xx - yy), -0.5900435899266435 * x * (xx - 3 * yy)
        terms[10], terms[14] = 2.890611442640554 * xy * z, 1.445305721320277 * z * (xx - yy)
        terms[11], terms[13] = -0.4570457994644658 * y * (4 * zz - xx - yy), -0.4570457994644658 * x * (4 * zz - xx - yy)
        terms[12] = 0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy)
    if degree > 3:
        terms[16], terms[18] = 2.5033429417967046 * xy * (xx - yy), 0.9461746957575601 * xy * (7 * zz - 1)
        terms[17], terms[23] = -1.7701307697799304 * yz * (3 * xx - yy), -1.7701307697799304 * xz * (xx - 3 * yy)
        terms[19], terms[21] = -0.6690465435572892 * yz * (7 * zz - 3), -0.6690465435572892 * xz * (7 * zz - 3)
        terms[20] = 0.10578554691520431 * (zz * (35 * zz - 30) + 3)
        terms[22] = 0.47308734787878004 * (xx - yy) * (7 * zz - 1)
        terms[24] = 0.6258357354491761 * (xx * (xx - 3 * yy) - yy * (3 * xx - yy))


@inline
def sh_slope(degree, x, y, z, h):
    """Gradient by x, y and z of sum_b h[b] Y_b(x, y, z), the polynomials as sh_terms has them."""
    gx, gy, gz = 0.0, 0.0, 0.0
    xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
    if degree > 0:
        c = 0.4886025119029199
        gx, gy, gz = -c * h[3], -c * h[1], c * h[2]
    if degree > 1:
        a, b, c = 1.0925484305920792, 2 * 0.31539156525252005, 2 * 0.5462742152960396
        gx += a * (y * h[4] - z * h[7]) - b * x * h[6] + c * x * h[8]
        gy += a * (x * h[4] - z * h[5]) - b * y * h[6] - c * y * h[8]
        gz += 2 * b * z * h[6] - a * (y * h[5] + x * h[7])
    if degree > 2:
        a, b, c, d, e = 0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277
        gx += b * yz * h[10] + 2 * e * xz * h[14] - 6 * d * xz * h[12]
        gx -= a * (6 * xy * h[9] + 3 * (xx - yy) * h[15]) - c * (2 * xy * h[11] - (4 * zz - 3 * xx - yy) * h[13])
        gy += b * xz * h[10] - 2 * e * yz * h[14] - 6 * d * yz * h[12]
        gy -= a * (3 * (xx - yy) * h[9] - 6 * xy * h[15]) - c * (2 * xy * h[13] - (4 * zz - xx - 3 * yy) * h[11])
        gz += b * xy * h[10] + e * (xx - yy) * h[14] + 3 * d * (2 * zz - xx - yy) * h[12] - 8 * c * (yz * h[11] + xz * h[13])
    if degree > 3:
        a, b, c, d = 2.5033429417967046, 1.7701307697799304, 0.9461746957575601, 0.6690465435572892
        e, f, g = 0.10578554691520431, 0.47308734787878004, 4 * 0.6258357354491761
        gx += a * y * (3 * xx - yy) * h[16] - b * (6 * xy * z * h[17] + 3 * z * (xx - yy) * h[23])
        gx += c * y * (7 * zz - 1) * h[18] - d * z * (7 * zz - 3) * h[21] + 2 * f * x * (7 * zz - 1) * h[22] + g * x * (xx - 3 * yy) * h[24]
        gy += a * x * (xx - 3 * yy) * h[16] - b * (3 * z * (xx - yy) * h[17] - 6 * xy * z * h[23])
        gy += c * x * (7 * zz - 1) * h[18] - d * z * (7 * zz - 3) * h[19] - 2 * f * y * (7 * zz - 1) * h[22] + g * y * (yy - 3 * xx) * h[24]
        gz -= b * (y * (3 * xx - yy) * h[17] + x * (xx - 3 * yy) * h[23]) + 3 * d * (7 * zz - 1) * (y * h[19] + x * h[21])
        gz += 14 * c * xy * z * h[18] + e * z * (140 * zz - 60) * h[20] + 14 * f * z * (xx - yy) * h[22]
    return gx, gy, gz


@inline
def sh_colour(c, n, degree, x, y, z, terms, colour):
    """colour [3] = max(0, 0.5 + sum_b Y_b(x, y, z) c[3 b + channel]) for a unit direction and coefficients c[n] [3 B].

    terms [25]: room to work; holds the Y_b afterwards.
    """
    sh_terms(degree, x, y, z, terms)
    red, green, blue = 0.5, 0.5, 0.5
    for b in range((degree + 1) * (degree + 1)):
        red, green, blue = red + terms[b] * c[n, 3 * b], green + terms[b] * c[n, 3 * b + 1], blue + terms[b] * c[n, 3 * b + 2]
    colour[0], colour[1], colour[2] = max(red, 0.0), max(green, 0.0), max(blue, 0.0)

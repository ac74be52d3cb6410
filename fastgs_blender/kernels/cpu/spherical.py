# SPDX-License-Identifier: GPL-3.0-or-later
"""Spherical harmonics for one Gaussian: appearance.sh_basis as scalar code, and its derivative."""
from __future__ import annotations

from ...model.appearance import SH_C0, SH_C1, SH_C2, SH_C3, SH_C4
from .jit import inline


@inline
def sh_terms(degree, x, y, z, terms):
    """terms[:(degree + 1)^2] = Y_b(x, y, z)."""
    terms[0] = SH_C0
    if degree > 0:
        terms[1], terms[2], terms[3] = -SH_C1 * y, SH_C1 * z, -SH_C1 * x
    xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
    if degree > 1:
        terms[4], terms[5], terms[7] = SH_C2[0] * xy, -SH_C2[0] * yz, -SH_C2[0] * xz
        terms[6], terms[8] = SH_C2[2] * (2 * zz - xx - yy), SH_C2[4] * (xx - yy)
    if degree > 2:
        terms[9], terms[15] = SH_C3[0] * y * (3 * xx - yy), SH_C3[0] * x * (xx - 3 * yy)
        terms[10], terms[14] = SH_C3[1] * xy * z, SH_C3[5] * z * (xx - yy)
        terms[11], terms[13] = SH_C3[2] * y * (4 * zz - xx - yy), SH_C3[2] * x * (4 * zz - xx - yy)
        terms[12] = SH_C3[3] * z * (2 * zz - 3 * xx - 3 * yy)
    if degree > 3:
        terms[16], terms[18] = SH_C4[0] * xy * (xx - yy), SH_C4[2] * xy * (7 * zz - 1)
        terms[17], terms[23] = SH_C4[1] * yz * (3 * xx - yy), SH_C4[1] * xz * (xx - 3 * yy)
        terms[19], terms[21] = SH_C4[3] * yz * (7 * zz - 3), SH_C4[3] * xz * (7 * zz - 3)
        terms[20] = SH_C4[4] * (zz * (35 * zz - 30) + 3)
        terms[22] = SH_C4[6] * (xx - yy) * (7 * zz - 1)
        terms[24] = SH_C4[8] * (xx * (xx - 3 * yy) - yy * (3 * xx - yy))


@inline
def sh_slope(degree, x, y, z, h):
    """Gradient by x, y and z of sum_b h[b] Y_b(x, y, z), the polynomials as sh_terms has them."""
    gx, gy, gz = 0.0, 0.0, 0.0
    xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
    if degree > 0:
        c = SH_C1
        gx, gy, gz = -c * h[3], -c * h[1], c * h[2]
    if degree > 1:
        a, b, c = SH_C2[0], 2 * SH_C2[2], 2 * SH_C2[4]
        gx += a * (y * h[4] - z * h[7]) - b * x * h[6] + c * x * h[8]
        gy += a * (x * h[4] - z * h[5]) - b * y * h[6] - c * y * h[8]
        gz += 2 * b * z * h[6] - a * (y * h[5] + x * h[7])
    if degree > 2:
        a, b, c, d, e = -SH_C3[0], SH_C3[1], -SH_C3[2], SH_C3[3], SH_C3[5]
        gx += b * yz * h[10] + 2 * e * xz * h[14] - 6 * d * xz * h[12]
        gx -= a * (6 * xy * h[9] + 3 * (xx - yy) * h[15]) - c * (2 * xy * h[11] - (4 * zz - 3 * xx - yy) * h[13])
        gy += b * xz * h[10] - 2 * e * yz * h[14] - 6 * d * yz * h[12]
        gy -= a * (3 * (xx - yy) * h[9] - 6 * xy * h[15]) - c * (2 * xy * h[13] - (4 * zz - xx - 3 * yy) * h[11])
        gz += b * xy * h[10] + e * (xx - yy) * h[14] + 3 * d * (2 * zz - xx - yy) * h[12] - 8 * c * (yz * h[11] + xz * h[13])
    if degree > 3:
        a, b, c, d = SH_C4[0], -SH_C4[1], SH_C4[2], -SH_C4[3]
        e, f, g = SH_C4[4], SH_C4[6], 4 * SH_C4[8]
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

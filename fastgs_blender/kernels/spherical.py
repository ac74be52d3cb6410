# SPDX-License-Identifier: GPL-3.0-or-later
"""Spherical harmonics for one Gaussian: appearance.sh_basis written out for scalars."""
from __future__ import annotations

from .jit import inline


@inline
def sh_colour(c, degree, x, y, z, colour):
    """colour [3] = max(0, 0.5 + sum_b Y_b(x, y, z) c[3 b + channel]) for a unit direction and coefficients c [3 B]."""
    xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
    for i in range(3):
        v = 0.5 + 0.28209479177387814 * c[i]
        if degree > 0:
            v += 0.4886025119029199 * (z * c[6 + i] - y * c[3 + i] - x * c[9 + i])
        if degree > 1:
            v += 1.0925484305920792 * (xy * c[12 + i] - yz * c[15 + i] - xz * c[21 + i])
            v += 0.31539156525252005 * (2 * zz - xx - yy) * c[18 + i] + 0.5462742152960396 * (xx - yy) * c[24 + i]
        if degree > 2:
            v += 2.890611442640554 * xy * z * c[30 + i] + 1.445305721320277 * z * (xx - yy) * c[42 + i]
            v -= 0.5900435899266435 * (y * (3 * xx - yy) * c[27 + i] + x * (xx - 3 * yy) * c[45 + i])
            v -= 0.4570457994644658 * (4 * zz - xx - yy) * (y * c[33 + i] + x * c[39 + i])
            v += 0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy) * c[36 + i]
        if degree > 3:
            v += 2.5033429417967046 * xy * (xx - yy) * c[48 + i] + 0.9461746957575601 * xy * (7 * zz - 1) * c[54 + i]
            v -= 1.7701307697799304 * (yz * (3 * xx - yy) * c[51 + i] + xz * (xx - 3 * yy) * c[69 + i])
            v -= 0.6690465435572892 * (7 * zz - 3) * (yz * c[57 + i] + xz * c[63 + i])
            v += 0.10578554691520431 * (zz * (35 * zz - 30) + 3) * c[60 + i]
            v += 0.47308734787878004 * (xx - yy) * (7 * zz - 1) * c[66 + i]
            v += 0.6258357354491761 * (xx * (xx - 3 * yy) - yy * (3 * xx - yy)) * c[72 + i]
        colour[i] = max(v, 0.0)

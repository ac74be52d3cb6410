# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that finds in which direction the Gaussians around each Gaussian spread least: the normal of their surface.

Gaussians come sorted by cells.  Eight of one row of cells look at all neighbours of these at once.  The sums are of float32, and their
places are told from the corner of a cell, so that rounding is the same whichever eight these are, and whatever happens elsewhere.
"""
from __future__ import annotations

import math

import numpy as np
from llvmlite import ir
from numba import float32
from numba.core import cgutils, types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from ...rendering.normals import LEAST
from ...util.threads import ranges, run
from .. import asserts
from . import simd
from .jit import inline, kernel
from .passing import view_box
from .sort import order_by

SWEEPS = 4
"""Of Jacobi's rotations; a matrix of three rows is then diagonal to rounding."""
SMALL = 1e-8
"""Share of a matrix's trace beside which an element counts as 0."""
ALIKE = 1e-6
"""Share of the squared trace: if no product of two rows is longer, two eigenvalues are about the same."""
CHUNK = 4096
"""Gaussians in one piece of work."""
FARTHEST = 1 << 20
"""Cells from the first one in which neighbours are told apart."""
RUN = 16
"""Cells in a row whose places are told from one corner."""
SUMS = 10
"""Of the weights, the places (3) and the moments (6) around each Gaussian."""


def thinnest(places: np.ndarray, axes: np.ndarray, opacity: np.ndarray, reach: float, towards: np.ndarray, turn: np.ndarray,
             rows: np.ndarray | None = None) -> np.ndarray:
    """PictureBackend.thinnest()."""
    asserts.thinnest(places, axes, opacity, towards, turn)
    out = np.zeros((len(places) if rows is None else len(rows), 3))
    if not len(out):
        return out
    places, key = np.ascontiguousarray(places.T), np.empty(len(places), np.int64)
    low, high = np.floor(view_box(places, np.eye(3, 4), True) / reach)
    across, wide, deep = (int(most) + 3 for most in np.minimum(high - low, FARTHEST))  # an empty cell at either end: all have neighbours
    run(lambda begin, end: _cells(begin, end, places, reach, low, wide, deep, key), ranges(len(key), CHUNK))
    if across * wide * deep < 1 << 32:
        order = order_by(key.astype(np.uint32).view(np.float32), np.arange(len(key), dtype=np.int32))
    else:
        order = np.argsort(key, kind="stable")
    about, sorted_, key = np.empty((len(order), 7), np.float32), np.empty((len(order), 3)), key[order]
    rest = order, places, np.ascontiguousarray(axes), opacity, float(reach), about, sorted_
    run(lambda begin, end: _sorted(begin, end, *rest), ranges(len(order), CHUNK))
    who, into = np.arange(len(order)), order
    if rows is not None:
        number = np.full(len(order), -1)
        number[rows] = np.arange(len(rows))
        who = np.flatnonzero(number[order] >= 0)
        into = number[order[who]]
    beside = (np.arange(-1, 2)[:, None] * wide + np.arange(-1, 2)).ravel() * deep
    args = sorted_, about, key, who, beside, float(reach), towards, np.ascontiguousarray(turn), into, out
    run(lambda begin, end: _thinnest(begin, end, *args), ranges(len(who), CHUNK))
    return out


@kernel
def _cells(begin, end, places, reach, low, wide, deep, key):
    """The numbers of the cells of the Gaussians begin..end, row by row."""
    for n in range(begin, end):
        x, y, z = math.floor(places[0, n] / reach), math.floor(places[1, n] / reach), math.floor(places[2, n] / reach)
        x, y, z = min(x - low[0], FARTHEST), min(y - low[1], FARTHEST), min(z - low[2], FARTHEST)
        key[n] = (np.int64(x) * wide + np.int64(y)) * deep + np.int64(z)


@kernel
def _sorted(begin, end, order, places, axes, opacity, reach, about, sorted_):
    """The Gaussians order[begin:end], one after another: their weights and covariances, in about [N, 7], and their places [N, 3]."""
    size = np.empty(3)
    for k in range(begin, end):
        n = order[k]
        for i in range(3):
            sorted_[k, i], size[i] = places[i, n], math.sqrt(axes[0, i, n] ** 2 + axes[1, i, n] ** 2 + axes[2, i, n] ** 2)
        least, most = min(size[0], size[1], size[2]), max(size[0], size[1], size[2])
        middle = max(min(max(size[0], size[1]), size[2]), min(size[0], size[1]))
        about[k, 0] = max(opacity[n] * (middle - least) * most / (reach * reach), LEAST)
        column = 1
        for i in range(3):
            for j in range(i, 3):
                about[k, column] = axes[i, 0, n] * axes[j, 0, n] + axes[i, 1, n] * axes[j, 1, n] + axes[i, 2, n] * axes[j, 2, n]
                column += 1


@intrinsic
def weigh8(context, state, about, places, first, last, x, y, z, square):
    """Add the Gaussians first..last to the sums of eight others: state [3 + SUMS, 8] is their places, from (x, y, z), and then the sums.

    about [N, 7]: the Gaussians' weights and spreads; places [N, 3]: where they are; square: 1 / reach^2
    """
    def build(context, b, signature, args):
        state, about = (simd.Memory(context, b, signature.args[i], args[i]) for i in (0, 1))
        where, start = make_array(signature.args[2])(context, b, args[2]).data, ir.Constant(args[3].type, 0)
        own, square = [state.floats(start, simd.LANES * axis) for axis in range(3)], simd.broadcast(b, args[8])
        sums = [simd.Sum(b) for _ in range(SUMS)]
        with cgutils.for_range_slice(b, args[3], args[4], ir.Constant(args[3].type, 1)) as (n, _):
            row = b.mul(n, ir.Constant(n.type, 3))
            there = [b.load(b.gep(where, [b.add(row, ir.Constant(n.type, axis))])) for axis in range(3)]
            dx, dy, dz = (simd.broadcast(b, b.fptrunc(b.fsub(at, corner), ir.FloatType())) - mine
                          for at, corner, mine in zip(there, args[5:8], own, strict=True))
            near, row = (simd.constant(b, 1.0) - (dx * dx + dy * dy + dz * dz) * square).max(0.0), b.mul(n, ir.Constant(n.type, 7))
            w, xx, xy, xz, yy, yz, zz = (simd.broadcast(b, about.scalar(row, column)) for column in range(7))
            w = w * near * near
            wx, wy, wz = w * dx, w * dy, w * dz
            moments = w * xx + wx * dx, w * xy + wx * dy, w * xz + wx * dz, w * yy + wy * dy, w * yz + wy * dz, w * zz + wz * dz
            for total, term in zip(sums, (w, wx, wy, wz, *moments), strict=True):
                total.add(term)
        for place, total in enumerate(sums, 3):
            state.store(start, simd.LANES * place, state.floats(start, simd.LANES * place) + total.value())
        return context.get_dummy_value()

    number = types.float64
    return types.void(state, about, places, types.intp, types.intp, number, number, number, types.float32), build


@kernel
def _thinnest(begin, end, places, about, keys, who, beside, reach, towards, turn, into, out):
    """The normals of the Gaussians who[begin:end] of those sorted by keys, in out at their places `into`."""
    state, c, v = np.empty((3 + SUMS, simd.LANES), np.float32), np.empty((3, 3)), np.empty((3, 3))
    first, last = np.empty(9, np.int64), np.empty(9, np.int64)
    for row in range(9):
        first[row] = last[row] = np.searchsorted(keys, keys[who[begin]] + beside[row] - 1)
    square, deep, p = float32(1.0 / (reach * reach)), beside[5] - beside[4], begin
    while p < end:
        x, y = math.floor(places[who[p], 0] / reach) * reach, math.floor(places[who[p], 1] / reach) * reach
        line, z = keys[who[p]] // deep, math.floor(places[who[p], 2] / (RUN * reach)) * (RUN * reach)
        q = p + 1
        while q < end and q < p + simd.LANES and keys[who[q]] // deep == line and z <= places[who[q], 2] < z + RUN * reach:
            q += 1
        for j in range(simd.LANES):
            k = who[min(p + j, q - 1)]
            state[0, j], state[1, j], state[2, j] = places[k, 0] - x, places[k, 1] - y, places[k, 2] - z
            for place in range(3, 3 + SUMS):
                state[place, j] = 0.0
        for row in range(9):  # keys grow with p, so that the cells beside it only move on
            while first[row] < len(keys) and keys[first[row]] < keys[who[p]] + beside[row] - 1:
                first[row] += 1
            last[row] = max(last[row], first[row])
            while last[row] < len(keys) and keys[last[row]] <= keys[who[q - 1]] + beside[row] + 1:
                last[row] += 1
            weigh8(state, about, places, first[row], last[row], x, y, z, square)
        for k in range(p, q):
            j, at = k - p, into[k]
            total = max(np.float64(state[3, j]), 1e-30)
            sx, sy, sz = state[4, j] / total, state[5, j] / total, state[6, j] / total
            xx, xy, xz = state[7, j] / total - sx * sx, state[8, j] / total - sx * sy, state[9, j] / total - sx * sz
            yy, yz, zz = state[10, j] / total - sy * sy, state[11, j] / total - sy * sz, state[12, j] / total - sz * sz
            x0, y0, z0 = _least(xx, xy, xz, yy, yz, zz)
            if x0 == 0.0 and y0 == 0.0 and z0 == 0.0:
                c[0, 0], c[0, 1], c[0, 2], c[1, 1], c[1, 2], c[2, 2] = xx, xy, xz, yy, yz, zz
                c[1, 0], c[2, 0], c[2, 1] = xy, xz, yz
                _diagonalise(c, v)
                i = 1 if c[1, 1] < c[0, 0] else 0
                i = 2 if c[2, 2] < c[i, i] else i
                x0, y0, z0 = v[0, i], v[1, i], v[2, i]
            k = who[k]
            ahead = x0 * (towards[0] - towards[3] * places[k, 0]) + y0 * (towards[1] - towards[3] * places[k, 1])
            sign = math.copysign(1.0, ahead + z0 * (towards[2] - towards[3] * places[k, 2]))
            x = turn[0, 0] * x0 + turn[0, 1] * y0 + turn[0, 2] * z0
            y = turn[1, 0] * x0 + turn[1, 1] * y0 + turn[1, 2] * z0
            z = turn[2, 0] * x0 + turn[2, 1] * y0 + turn[2, 2] * z0
            unit = sign / max(math.sqrt(x * x + y * y + z * z), 1e-30)
            out[at, 0], out[at, 1], out[at, 2] = x * unit, y * unit, z * unit
        p = q


@inline
def _least(xx, xy, xz, yy, yz, zz):
    """The unit eigenvector of the smallest eigenvalue of a symmetric matrix, by the cubic's formula; zeros where two are about the same."""
    third = (xx + yy + zz) / 3
    a, b, c = xx - third, yy - third, zz - third
    spread = math.sqrt(max((a * a + b * b + c * c + 2 * (xy * xy + xz * xz + yz * yz)) / 6, 0.0))
    if not spread > SMALL * third:
        return 0.0, 0.0, 0.0
    half = (a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)) / (2 * spread * spread * spread)
    least = 2 * spread * math.cos((math.acos(min(max(half, -1.0), 1.0)) + 2 * math.pi) / 3)
    a, b, c = a - least, b - least, c - least
    x0, y0, z0 = xy * yz - xz * b, xz * xy - a * yz, a * b - xy * xy
    x1, y1, z1 = xy * c - xz * yz, xz * xz - a * c, a * yz - xy * xz
    x2, y2, z2 = b * c - yz * yz, yz * xz - xy * c, xy * yz - b * xz
    length, length1, length2 = x0 * x0 + y0 * y0 + z0 * z0, x1 * x1 + y1 * y1 + z1 * z1, x2 * x2 + y2 * y2 + z2 * z2
    if length1 > length:
        x0, y0, z0, length = x1, y1, z1, length1
    if length2 > length:
        x0, y0, z0, length = x2, y2, z2, length2
    length = math.sqrt(length)
    if not length > ALIKE * 9 * third * third:
        return 0.0, 0.0, 0.0
    return x0 / length, y0 / length, z0 / length


@inline
def _diagonalise(c, v):
    """Turn a symmetric matrix [3, 3] into its eigenvalues, on its diagonal, and the columns of v into its eigenvectors (Jacobi)."""
    for i in range(3):
        for j in range(3):
            v[i, j] = 1.0 if i == j else 0.0
    small = SMALL * (c[0, 0] + c[1, 1] + c[2, 2])
    for _ in range(SWEEPS):
        for i in range(2):
            for j in range(i + 1, 3):
                if abs(c[i, j]) <= small:
                    continue
                ratio = (c[j, j] - c[i, i]) / (2 * c[i, j])
                t = (1.0 if ratio >= 0 else -1.0) / (abs(ratio) + np.sqrt(ratio * ratio + 1))
                cosine = 1 / np.sqrt(t * t + 1)
                sine = t * cosine
                for k in range(3):
                    a, b = c[k, i], c[k, j]
                    c[k, i], c[k, j] = cosine * a - sine * b, sine * a + cosine * b
                for k in range(3):
                    a, b = c[i, k], c[j, k]
                    c[i, k], c[j, k] = cosine * a - sine * b, sine * a + cosine * b
                for k in range(3):
                    a, b = v[k, i], v[k, j]
                    v[k, i], v[k, j] = cosine * a - sine * b, sine * a + cosine * b

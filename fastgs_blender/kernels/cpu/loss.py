# SPDX-License-Identifier: GPL-3.0-or-later
"""The photometric loss and its gradient in one pass: (1 - d) L1 + d (1 - SSIM).

SSIM as 3DGS has it: means under an 11 x 11 Gaussian of sigma 1.5, zeros beyond the border, each channel by itself.  The window
is separable.  A piece of work goes down its rows: moments down the columns, then along the row, SSIM and its derivatives by
the moments into a ring of eleven rows, and five rows behind, the same two sums over that ring give the gradient.

Pictures are flat [h, stride] float32 with three interleaved channels, so that eight neighbours in memory are eight numbers to
work on and neighbours in the picture lie 3 apart.
"""
from __future__ import annotations

import math

import numpy as np
from numba import float32
from numba.core import cgutils, types
from numba.extending import intrinsic

from ...util.threads import portions, run
from . import simd
from .jit import kernel

REACH = 5
SIZE = 2 * REACH + 1
C1, C2 = 0.01**2, 0.03**2
PAD = 16
"""Zeros at both ends of a row that is summed along: at least 3 * REACH."""
ROWS = 64
"""Rows in one piece of work; each computes ten more."""


def window() -> np.ndarray:
    """The Gaussian's weights [11] float64; they sum to 1."""
    weights = np.exp(-np.arange(-REACH, REACH + 1) ** 2 / (2 * 1.5**2))
    return weights / weights.sum()


TAPS = window().astype(np.float32)


def _eights(b, length):
    """How many vectors cover `length` floats."""
    return b.udiv(b.add(length, length.type(simd.LANES - 1)), length.type(simd.LANES))


def _shifted(b, j, stride):
    """Where the j-th vector of a row lies; the last is moved back so that it ends with the row."""
    i, end = b.mul(j, j.type(simd.LANES)), b.sub(stride, stride.type(simd.LANES))
    return b.select(b.icmp_signed("<", i, end), i, end)


def _number(b, whole):
    """A whole number in every lane."""
    return simd.broadcast(b, b.sitofp(whole, simd.ir.FloatType()))


def _along(b, row, at):
    """The weighted sums along a row of the eight numbers from at + PAD on."""
    total = row.floats(at, PAD - 3 * REACH) * float(TAPS[0])
    for k in range(1, SIZE):
        total = row.floats(at, PAD + 3 * (k - REACH)) * float(TAPS[k]) + total
    return total


@intrinsic(prefer_literal=True)
def moments(context, x, y, weight, offsets, taps, stride, width, out, weighted):
    """Sums down the columns of x, y, x^2, y^2, x y into the rows of out [5, width]; offsets and taps [11] say where and how much."""
    if not isinstance(weighted, types.IntegerLiteral):
        return None
    signature = types.void(x, y, weight, offsets, taps, types.intp, types.intp, out, weighted)

    def build(context, b, signature, args):
        x, y, weight, taps, out = (simd.Memory(context, b, signature.args[i], args[i]) for i in (0, 1, 2, 4, 7))
        places = simd.make_array(signature.args[3])(context, b, args[3]).data
        stride, width = args[5], args[6]
        with cgutils.for_range(b, _eights(b, stride)) as loop:
            i = _shifted(b, loop.index, stride)
            sums = [simd.Sum(b) for _ in range(5)]
            with cgutils.for_range(b, stride.type(SIZE)) as rows:
                at = b.add(b.load(b.gep(places, [rows.index])), i)
                tap = simd.broadcast(b, taps.scalar(rows.index, 0))
                p, q = x.floats(at, 0), y.floats(at, 0)
                if weighted.literal_value:
                    p = q + (p - q) * weight.floats(at, 0).min(1.0)
                tp, tq = tap * p, tap * q
                for s, term in zip(sums, (tp, tq)):
                    s.add(term)
                for s, (f, g) in zip(sums[2:], ((tp, p), (tq, q), (tp, q))):
                    s.add(f * g)
            for plane, s in enumerate(sums):
                out.store(b.add(b.mul(width, width.type(plane)), i), PAD, s.value())
        return context.get_dummy_value()

    return signature, build


@intrinsic(prefer_literal=True)
def similarity(context, rows, weight, at, length, width, ring, slot, sums, row, weighted):
    """SSIM of one row: its derivatives by mean, mean square and mean product into ring [slot:], the sums of it into sums[row, :8]."""
    if not isinstance(weighted, types.IntegerLiteral):
        return None
    whole = types.intp
    signature = types.void(rows, weight, whole, whole, whole, ring, whole, sums, whole, weighted)

    def build(context, b, signature, args):
        rows, weight, ring, sums = (simd.Memory(context, b, signature.args[i], args[i]) for i in (0, 1, 5, 7))
        at, length, width, slot, row = args[2], args[3], args[4], args[6], args[8]
        total = simd.Sum(b)
        end = _number(b, length)
        with cgutils.for_range(b, _eights(b, length)) as loop:
            i = b.mul(loop.index, length.type(simd.LANES))
            m1, m2, xx, yy, xy = (_along(b, rows, b.add(b.mul(width, width.type(plane)), i)) for plane in range(5))
            inside = end > simd.ramp(b) + _number(b, i)
            a, c = m1 * m2 * 2.0 + C1, m1 * m1 + m2 * m2 + C1
            e, d = (xy - m1 * m2) * 2.0 + C2, xx - m1 * m1 + (yy - m2 * m2) + C2
            inverse = simd.constant(b, 1.0) / (c * d)
            ssim = a * e * inverse
            counts = weight.floats(b.add(at, i), 0) if weighted.literal_value else simd.constant(b, 1.0)
            total.add(((simd.constant(b, 1.0) - ssim) * counts).where(inside, 0.0))
            by_product = a * inverse * 2.0
            by_square = ssim * c * inverse * -1.0
            by_mean = (m2 * e - m1 * ssim * d) * inverse * 2.0 - m2 * by_product - m1 * by_square * 2.0
            for plane, value in enumerate((by_mean, by_square, by_product)):
                ring.store(b.add(slot, b.add(b.mul(width, width.type(plane)), i)), 0, (value * counts).where(inside, 0.0))
        sums.store(b.mul(row, row.type(2 * simd.LANES)), 0, total.value())
        return context.get_dummy_value()

    return signature, build


@intrinsic
def down(context, ring, offsets, length, width, out):
    """Sums down the columns of the ring's three planes into the rows of out [3, width]."""
    signature = types.void(ring, offsets, types.intp, types.intp, out)

    def build(context, b, signature, args):
        ring, out = (simd.Memory(context, b, signature.args[i], args[i]) for i in (0, 4))
        places = simd.make_array(signature.args[1])(context, b, args[1]).data
        length, width = args[2], args[3]
        starts = [b.load(b.gep(places, [length.type(k)])) for k in range(SIZE)]
        with cgutils.for_range(b, _eights(b, length)) as loop:
            i = b.mul(loop.index, length.type(simd.LANES))
            for plane in range(3):
                place = b.add(b.mul(width, width.type(plane)), i)
                total = ring.floats(b.add(starts[0], place), 0) * float(TAPS[0])
                for k in range(1, SIZE):
                    total = ring.floats(b.add(starts[k], place), 0) * float(TAPS[k]) + total
                out.store(place, PAD, total)
        return context.get_dummy_value()

    return signature, build


@intrinsic(prefer_literal=True)
def combine(context, x, y, weight, at, length, stride, width, rows, l1_scale, ssim_scale, grad, sums, row, weighted):
    """One row of the gradient, and the sums of |x - y| into sums[row, 8:]."""
    if not isinstance(weighted, types.IntegerLiteral):
        return None
    whole, number = types.intp, types.float32
    signature = types.void(x, y, weight, whole, whole, whole, whole, rows, number, number, grad, sums, whole, weighted)

    def build(context, b, signature, args):
        x, y, weight, rows, grad, sums = (simd.Memory(context, b, signature.args[i], args[i]) for i in (0, 1, 2, 7, 10, 11))
        at, length, stride, width, row = args[3], args[4], args[5], args[6], args[12]
        l1_scale, ssim_scale = simd.broadcast(b, args[8]), simd.broadcast(b, args[9])
        total = simd.Sum(b)
        end = _number(b, length)
        with cgutils.for_range(b, _eights(b, stride)) as loop:
            i = _shifted(b, loop.index, stride)
            place, lanes = b.add(at, i), simd.ramp(b) + _number(b, i)
            fresh = b.and_(end > lanes, lanes >= _number(b, b.mul(loop.index, i.type(simd.LANES))))
            p, q = x.floats(place, 0), y.floats(place, 0)
            difference = p - q
            share = counts = simd.constant(b, 1.0)
            if weighted.literal_value:
                counts = weight.floats(place, 0)
                share = counts.min(1.0)
                p = q + difference * share
            total.add((difference.magnitude() * counts).where(fresh, 0.0))
            by_mean, by_square, by_product = (_along(b, rows, b.add(b.mul(width, width.type(plane)), i)) for plane in range(3))
            sign = simd.constant(b, 1.0).where(difference > 0.0, simd.constant(b, -1.0).where(simd.constant(b, 0.0) > difference, 0.0))
            value = (by_mean + by_square * p * 2.0 + by_product * q) * share * ssim_scale + sign * counts * l1_scale
            grad.store(place, 0, value)
        sums.store(b.mul(row, row.type(2 * simd.LANES)), simd.LANES, total.value())
        return context.get_dummy_value()

    return signature, build


@kernel
def compare(first, last, x, y, weight, height, length, stride, l1_scale, ssim_scale, grad, sums, weighted):
    """The rows first..last of two pictures: the gradient, and what the loss is summed from.

    x, y     [height * stride], of which `length` floats a row count; at least eight a row
    weight   the same and eight more floats, or anything if not weighted
    grad     [height * stride]: l1_scale d sum |x - y| + ssim_scale d sum SSIM
    sums     [height + 1, 16]: each row's sums of 1 - SSIM in eight parts, and of |x - y|; the last row is nobody's
    """
    width = PAD + stride + simd.LANES + PAD
    rows, ring, back = np.zeros((5, width), np.float32), np.zeros((SIZE, 3, width), np.float32), np.zeros((3, width), np.float32)
    offsets, taps = np.empty(SIZE, np.intp), np.empty(SIZE, np.float32)
    for r in range(first - REACH, last + REACH):
        slot = r % SIZE
        if r < 0 or r >= height:
            ring[slot] = np.float32(0.0)
        else:
            for k in range(SIZE):
                q = r + k - REACH
                offsets[k] = min(max(q, 0), height - 1) * stride
                taps[k] = TAPS[k] if q >= 0 and q < height else np.float32(0.0)
            own = r if r >= first and r < last else height
            if weighted:
                moments(x, y, weight, offsets, taps, stride, width, rows, 1)
                similarity(rows, weight, r * stride, length, width, ring, slot * 3 * width, sums, own, 1)
            else:
                moments(x, y, weight, offsets, taps, stride, width, rows, 0)
                similarity(rows, weight, r * stride, length, width, ring, slot * 3 * width, sums, own, 0)
        r -= REACH
        if r >= first:
            for k in range(SIZE):
                offsets[k] = (r + k - REACH) % SIZE * 3 * width
            down(ring, offsets, length, width, back)
            if weighted:
                combine(x, y, weight, r * stride, length, stride, width, back, l1_scale, ssim_scale, grad, sums, r, 1)
            else:
                combine(x, y, weight, r * stride, length, stride, width, back, l1_scale, ssim_scale, grad, sums, r, 0)


def photometric(image, target, weight=None, dssim: float = 0.2):
    """The loss of an image against its target, float32 [h, w, 3]: (loss, gradient [h, w, 3] float32, l1, ssim).

    weight [h, w] float32 >= 0 or None: how much each pixel counts.  Where it is below 1 the image is first moved that far
    towards the target, so that a pixel that does not count does not disturb its neighbours' SSIM either.  Then

        l1 = mean(weight |image - target|)    ssim = 1 - mean(weight (1 - SSIM))    loss = (1 - dssim) l1 + dssim (1 - ssim)

    with means over all h * w * 3 numbers, so that a pixel's share does not depend on how many others count.  The same bytes for
    any number of threads.
    """
    height, columns, _ = image.shape
    length = 3 * columns
    stride = max(length, simd.LANES)

    def flat(array):
        rows = np.ascontiguousarray(array, np.float32).reshape(height, length)
        return (rows if stride == length else np.pad(rows, ((0, 0), (0, stride - length)))).reshape(-1)

    weighted = weight is not None
    counts = np.append(flat(np.repeat(weight, 3)), np.zeros(simd.LANES, np.float32)) if weighted else np.empty(0, np.float32)
    grad, sums = np.empty(height * stride, np.float32), np.zeros((height + 1, 2 * simd.LANES), np.float32)
    total = max(height * length, 1)
    rest = (flat(image), flat(target), counts, height, length, stride, np.float32((1 - dssim) / total), np.float32(-dssim / total),
            grad, sums, weighted)
    run(lambda first, last: compare(first, last, *rest), portions(height, ROWS, ROWS // 2))
    dissimilar, l1 = (float(part) / total for part in sums[:-1].reshape(height, 2, -1).sum((0, 2), dtype=np.float64))
    return (1 - dssim) * l1 + dssim * dissimilar, grad.reshape(height, stride)[:, :length].reshape(height, columns, 3), l1, 1 - dissimilar


@kernel
def roots(first, last, x, y, weight, weighted, scale, out, squares):
    """errors() of the rows first..last: squares [h] are the sums of (x - y)^2."""
    for i in range(first, last):
        total = float32(0)
        for j in range(x.shape[1]):
            red, green, blue = x[i, j, 0] - y[i, j, 0], x[i, j, 1] - y[i, j, 1], x[i, j, 2] - y[i, j, 2]
            total += red * red + green * green + blue * blue
            counts = weight[i, j] if weighted else float32(1)
            out[i, j] = math.sqrt(scale * counts * (abs(red) + abs(green) + abs(blue)))
        squares[i] = total


def errors(image, target, weight, scale: float) -> tuple[float, np.ndarray]:
    """The mean square of the difference of two pictures [h, w, 3], and the root [h, w] of scale * weight * its mean magnitude; weight as in
    photometric()."""
    height, columns, _ = image.shape
    out, squares, weighted = np.empty((height, columns), np.float32), np.empty(height, np.float32), weight is not None
    counts = np.ascontiguousarray(weight, np.float32) if weighted else out
    rest = (*(np.ascontiguousarray(a, np.float32) for a in (image, target)), counts, weighted, np.float32(scale / 3), out, squares)
    run(lambda first, last: roots(first, last, *rest), portions(height, ROWS, ROWS // 8))
    return float(squares.sum(dtype=np.float64)) / max(image.size, 1), out

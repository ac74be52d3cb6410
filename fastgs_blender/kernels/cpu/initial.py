# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels for starting points: projected points, and the plane sweep."""
from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import float32
from numba.core import types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from .. import asserts
from . import simd
from .jit import kernel


def project_points(xyz: np.ndarray, camera) -> tuple[np.ndarray, np.ndarray]:
    """TrainingBackend.project_points()."""
    asserts.project_points(xyz)
    places, depths = np.empty((len(xyz), 2)), np.empty(len(xyz))
    lens = float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy)
    projected(np.asarray(xyz, np.float64), np.asarray(camera.world_to_camera, np.float64), *lens, places, depths)
    return places, depths


@kernel
def projected(xyz, matrix, fx, fy, cx, cy, places, depths):
    """Project points [n, 3] by a world-to-camera matrix, into places [n, 2] and depths [n]."""
    for i in range(len(xyz)):
        x = matrix[0, 0] * xyz[i, 0] + matrix[0, 1] * xyz[i, 1] + matrix[0, 2] * xyz[i, 2] + matrix[0, 3]
        y = matrix[1, 0] * xyz[i, 0] + matrix[1, 1] * xyz[i, 1] + matrix[1, 2] * xyz[i, 2] + matrix[1, 3]
        z = matrix[2, 0] * xyz[i, 0] + matrix[2, 1] * xyz[i, 1] + matrix[2, 2] * xyz[i, 2] + matrix[2, 3]
        depths[i] = z
        if abs(z) < 1e-9:
            z = 1e-9
        places[i, 0] = fx * x / z + cx
        places[i, 1] = fy * y / z + cy


def vote(xyz: np.ndarray, rgb: np.ndarray, camera, image: np.ndarray, depth: np.ndarray, cost: np.ndarray, near: float, alike: float,
         sure: float, agree: np.ndarray, against: np.ndarray) -> None:
    """TrainingBackend.vote()."""
    asserts.vote(xyz, rgb, image, depth, cost, agree, against)
    lens = float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy)
    places, depths = np.empty((BLOCK, 2)), np.empty(BLOCK)
    voted(np.asarray(xyz, np.float64), np.asarray(rgb, np.float64), np.asarray(camera.world_to_camera, np.float64), lens, image,
          np.asarray(depth, np.float64), cost, near, 3 * alike, sure, agree, against, places, depths)


@kernel
def voted(xyz, rgb, matrix, lens, image, depth, cost, near, alike, sure, agree, against, places, depths):
    """vote(), by blocks of points whose places [B, 2] and depths [B] are scratch; alike: the sum of three differences."""
    height, width = depth.shape
    for first in range(0, len(xyz), len(places)):
        points = xyz[first:first + len(places)]
        projected(points, matrix, lens[0], lens[1], lens[2], lens[3], places, depths)
        for i in range(len(points)):
            x, y, z = places[i, 0], places[i, 1], depths[i]
            if not (z > 0 and x > 0 and y > 0 and x < width and y < height):
                continue
            row, column = int(y), int(x)
            ratio, apart = depth[row, column] / max(z, 1e-12), 0.0
            for k in range(3):
                apart += abs(image[row, column, k] - rgb[first + i, k])
            if abs(ratio - 1) < near:
                if apart < alike:
                    agree[first + i] += 1
                else:
                    against[first + i] += 1
            elif ratio > 1 + 2 * near and cost[row, column] < sure:
                against[first + i] += 1


def sweep(image: np.ndarray, others, planes: np.ndarray, outside: float, reach: int) -> np.ndarray:
    """TrainingBackend.sweep()."""
    asserts.sweep(image, others, planes)
    high, wide = (max(other.shape[k] for other, _, _ in others) for k in (0, 1))
    pictures = np.zeros((len(others), high, wide, 4), np.float32)
    for picture, (other, _, _) in zip(pictures, others):
        picture[:other.shape[0], :other.shape[1], :3] = other
    sizes = np.array([other.shape[:2] for other, _, _ in others])
    turns, shifts = (np.array([other[k] for other in others], np.float32) for k in (1, 2))
    out = np.empty((len(planes), *image.shape[:2]), np.float32)
    image, planes = np.pad(image, ((0, 0), (0, 0), (0, 1))), np.asarray(planes, np.float32)
    swept(image, pictures, sizes, turns, shifts, planes, np.float32(outside), reach, out)
    return out


@kernel
def swept(image, pictures, sizes, turns, shifts, planes, outside, reach, out):
    """sweep() into out [D, h, w], plane by plane, so that a plane's differences stay in the processor's cache.

    image [h, w, 4];  pictures [O, ., ., 4], of which sizes [O, 2] are the others' heights and widths;  turns [O, 3, 3];  shifts [O, 3]
    """
    height, width = image.shape[:2]
    costs, scratch = np.empty((len(pictures), height, width), np.float32), np.empty((height, width), np.float32)
    for d in range(len(planes)):
        for k in range(len(pictures)):
            differences(image, pictures[k], sizes[k], turns[k], shifts[k], planes[d:d + 1], outside, costs[k:k + 1])
            averaged(costs[k:k + 1], reach, scratch)
        better_half(costs.reshape(len(pictures), height * width), outside / float32(2), out[d].reshape(height * width))


@intrinsic
def colour_difference(context, pixels, at, row, across, down, image, place):
    """Sum over the first three channels of the absolute differences between the pixel of image [., 4] at `place`, and a place between four
    pixels [., 4]: that at `at`, the next one, and those a row later.  across, down: where it lies between them, 0..1.

    Two pixels side by side are one vector.
    """
    def build(context, b, given, args):
        four, number = ir.VectorType(ir.FloatType(), 4), ir.IntType(32)
        at, row, place = (b.mul(args[k], args[k].type(4)) for k in (1, 2, 6))
        source = simd.Memory(context, b, given.args[0], args[0])
        upper, lower = source.floats(at, 0), source.floats(b.add(at, row), 0)
        mixed = upper + (lower - upper) * simd.broadcast(b, args[4])
        shares = b.shuffle_vector(simd.broadcast(b, b.fsub(ir.FloatType()(1), args[3])).value, simd.broadcast(b, args[3]).value,
                                  ir.Constant(simd.INTS, [0] * 4 + [8] * 4))
        mixed *= simd.Floats(b, shares)
        left, right = (b.shuffle_vector(mixed.value, mixed.value, ir.Constant(ir.VectorType(number, 4), [*range(first, first + 4)]))
                       for first in (0, 4))
        mine = make_array(given.args[5])(context, b, args[5]).data
        mine = b.load(b.bitcast(b.gep(mine, [place]), four.as_pointer()), align=4)
        apart = b.fsub(b.fadd(left, right), mine)
        apart = b.select(b.fcmp_ordered("<", apart, ir.Constant(four, [0.0] * 4)), b.fneg(apart), apart)
        first, second, third = (b.extract_element(apart, number(k)) for k in range(3))
        return b.fadd(b.fadd(first, second), third)
    return types.float32(pixels, types.intp, types.intp, types.float32, types.float32, image, types.intp), build


@kernel
def differences(image, other, size, turn, shift, planes, outside, out):
    """out [D, h, w]: mean absolute difference of the colours of image [h, w, 4] and other [., ., 4], whose height and width are `size`,
    were its surface on each plane [D, 3].

    The pixel (u, v) has the inverse depth plane @ (u, v, 1); turn [3, 3], shift [3]: at depth z it is seen by the other camera at
    turn @ (u, v, 1) z + shift (homogeneous).  outside: the difference where the other picture ends, or the plane lies behind a camera.
    """
    height, width = image.shape[:2]
    right, bottom, row = float32(size[1] - 1), float32(size[0] - 1), np.int32(other.shape[1])
    half, third = float32(0.5), float32(1 / 3)
    pixels, mine = other.reshape(-1, 4), image.reshape(-1, 4)
    at, across, down = np.empty(width, np.int32), np.empty(width, np.float32), np.empty(width, np.float32)
    for d in range(len(planes)):
        for i in range(height):
            v = float32(i) + half
            for j in range(width):  # places in the other picture first, as this loop becomes vectors
                u = float32(j) + half
                near = planes[d, 0] * u + planes[d, 1] * v + planes[d, 2]
                w = turn[2, 0] * u + turn[2, 1] * v + turn[2, 2] + shift[2] * near
                x = (turn[0, 0] * u + turn[0, 1] * v + turn[0, 2] + shift[0] * near) / w - half
                y = (turn[1, 0] * u + turn[1, 1] * v + turn[1, 2] + shift[1] * near) / w - half
                seen = (w > 0) & (near > 0) & (x >= 0) & (y >= 0) & (x < right) & (y < bottom)
                a, b = np.int32(x if seen else float32(0)), np.int32(y if seen else float32(0))
                across[j], down[j] = x - float32(a), y - float32(b)
                at[j] = b * row + a if seen else np.int32(-1)
            for j in range(width):
                k = at[j]
                if k < 0:
                    out[d, i, j] = outside
                    continue
                out[d, i, j] = colour_difference(pixels, k, row, across[j], down[j], mine, i * width + j) * third


@kernel
def averaged(cost, reach, row):
    """Means of cost [D, h, w] over (2 reach + 1)^2 pixels, in place; row [h, w] is scratch."""
    planes, height, width = cost.shape
    line, across = np.zeros(width + 2 * reach, np.float32), np.empty(width, np.float32)
    for j in range(width):
        across[j] = min(j + reach, width - 1) - max(j - reach, 0) + 1
    for d in range(planes):
        for i in range(height):
            sums, mine = row[i], cost[d, i]
            inner = line[reach:reach + width]
            for j in range(width):
                inner[j] = mine[j]
            for j in range(width):
                sums[j] = line[j]
            for k in range(1, 2 * reach, 2):  # slices have no negative indices, so that LLVM uses vectors
                one, two = line[k:k + width], line[k + 1:k + 1 + width]
                for j in range(width):
                    sums[j] += one[j] + two[j]
        for i in range(height):
            low, high = max(i - reach, 0), min(i + reach, height - 1)
            means, down, first = cost[d, i], float32(high - low + 1), row[low]
            for j in range(width):
                means[j] = first[j]
            for k in range(low + 1, high, 2):
                one, two = row[k], row[k + 1]
                for j in range(width):
                    means[j] += one[j] + two[j]
            if (high - low) % 2:
                one = row[high]
                for j in range(width):
                    means[j] += one[j]
            for j in range(width):
                means[j] /= down * across[j]


BLOCK = 256


@kernel
def better_half(costs, outside, out):
    """The means [P] of the lower half of the costs [O, P] below `outside`, the middle one included; of two at least, if there are three."""
    number = len(costs)
    least = min((number + 1) // 2, 2)
    ordered, half = np.empty((number, BLOCK), np.float32), np.empty(BLOCK, np.int32)
    for first in range(0, len(out), BLOCK):
        mean = out[first:first + BLOCK]
        block = len(mean)
        half[:] = 1
        for k in range(number):
            line, cost = ordered[k], costs[k, first:first + block]
            for p in range(block):
                line[p] = cost[p]
                half[p] += cost[p] < outside
        # neighbours are put in order, even and odd pairs in turn, in all places of the block at once
        for turn in range(number):
            for k in range(turn % 2, number - 1, 2):
                low, high = ordered[k], ordered[k + 1]
                for p in range(block):
                    low[p], high[p] = min(low[p], high[p]), max(low[p], high[p])
        for p in range(block):
            half[p] = max(half[p] // 2, least)
            mean[p] = ordered[0, p]
        for k in range(1, number):
            line = ordered[k]
            for p in range(block):
                mean[p] += line[p] if k < half[p] else float32(0)
        for p in range(block):
            mean[p] /= float32(half[p])
    return out

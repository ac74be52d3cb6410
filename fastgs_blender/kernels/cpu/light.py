# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that each Gaussian gives to a picture: the sums of its blending weights over pixels, and the largest of these weights.

Blending is linear in the channels, so that the sums are the picture's gradients by them (raster_backward.py).
"""
from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from ...rendering.layout import Layout
from ...rendering.oracle import T_STOP
from ...rendering.ways import without_colours
from ...util.threads import ranges, run
from . import groups, raster, simd
from .jit import announce, kernel
from .rasterise import ENTRIES, RasterState, rasterise_backward, rasterise_forward
from .splats import ProjectedSplats, project_instances
from .tile_lists import TileLists, list_tiles

SMALL, COARSE = 400, 4
"""Pictures with a longer side than this are looked at through one pixel for each COARSE x COARSE to see what contributes to them."""
WIDER = 12.0
"""Factor to the blur of splats there: with 8 some fall between the pixels, of which a picture shows 0.09 pixels (0.016 with 12); with more
of it those smaller than a pixel hide too much."""
BESIDE = 4
"""Pixels to each side of the picture in which Gaussians are seen, too: they are neighbours of those in it."""
LANES, EVERY = simd.WIDE, groups.every(simd.WIDE)
"""Pixels of a group (groups.py), and all groups of a tile."""
TILES = 8
"""Tiles in one piece of work: such pictures have few."""


@dataclass(frozen=True, eq=False)
class Light:
    """SelectingBackend.light()."""

    splats: ProjectedSplats
    state: RasterState
    sizes: tuple[int, ...]

    def over(self, masks: np.ndarray) -> list[np.ndarray]:
        """protocol.Light.over()."""
        channels = self.splats.channels
        wanted = np.zeros((*masks.shape[:2], channels), np.float32)
        wanted[..., :masks.shape[2]] = masks
        sums = rasterise_backward(self.state, wanted, np.zeros(masks.shape[:2], np.float32)).channels
        return self._by_instance(lambda rows: sums[rows, :masks.shape[2]], (masks.shape[2],))

    def alone(self) -> list[np.ndarray]:
        """protocol.Light.alone()."""
        def area(rows):
            geometry, attributes = self.splats.geometry[rows], self.splats.attributes[rows]
            opacity, cut = (np.exp2(attributes[:, k].astype(np.float64)) for k in (raster.LOG2_OPACITY, raster.LOG2_CUT))
            spread = math.pi / math.log(2) / np.abs(geometry[:, raster.L11] * geometry[:, raster.L22])
            return np.maximum(np.minimum(opacity, attributes[:, raster.ALPHA_MAX]) - cut, 0) * spread

        return self._by_instance(area, ())

    def _by_instance(self, values, shape: tuple[int, ...]) -> list[np.ndarray]:
        """Numbers of rows of splats as those of each instance's Gaussians; 0 for those that are not drawn."""
        found = []
        for size, pieces in zip(self.sizes, self.splats.runs, strict=True):
            out = np.zeros((size, *shape), np.float32)
            for first, number in pieces:
                rows = slice(first, first + number)
                out[self.splats.source[rows]] = values(rows)
            found.append(out)
        return found


def light(instances, camera) -> Light:
    """SelectingBackend.light()."""
    announce()
    splats = project_instances(instances, camera, Layout(instances, False))
    _, state = rasterise_forward(splats.order(), splats.geometry, splats.attributes, splats.channels, camera)
    return Light(splats, state, tuple(len(instance.model) for instance in instances))


def contributing(instances, camera) -> list[tuple[np.ndarray, np.ndarray]]:
    """PictureBackend.contributing(): where pictures are large, looked at through fewer pixels, in which splats are a little wider."""
    by, wider = (COARSE, WIDER) if max(camera.width, camera.height) > SMALL else (1, 1.0)
    coarse = camera.stretched(*(-(-side // by) for side in (camera.width, camera.height)))
    shown = BESIDE - 1, BESIDE - 1, coarse.width + 2, coarse.height + 2  # one more to each side: splats reach in
    width, height = coarse.width + 2 * BESIDE, coarse.height + 2 * BESIDE
    coarse = replace(coarse, width=width, height=height, cx=coarse.cx + BESIDE, cy=coarse.cy + BESIDE, window=(0, 0, width, height))
    drawn = []
    for each in instances:
        model, own = without_colours(each.model), each.model.raster
        drawn.append(replace(each, camera=coarse, model=replace(model, raster=replace(own, blur=own.blur * wider / by**2))))
    splats = project_instances(drawn, coarse, Layout(drawn, False))
    listing = TileLists.of(splats.order(), splats.geometry, splats.attributes, replace(coarse, window=shown))
    shares = np.zeros(len(splats.source), np.float32)
    for first, last in listing.bands(ENTRIES):
        rest = (*listing.frame, *list_tiles(listing.segments, listing.counts, first, last), splats.geometry, splats.attributes, shares)
        run(lambda a, b, first=first, rest=rest: weigh(first + a, first + b, *rest), ranges(last - first, TILES))
    found = []
    for pieces in splats.runs:
        rows = np.concatenate([np.arange(first, first + number) for first, number in pieces] or [np.zeros(0, int)])
        found.append((splats.source[rows].astype(np.int64), shares[rows]))
    return found


@kernel
def weigh(first, last, columns, x0, y0, right, bottom, tile_x, tile_y, starts, ids, geometry, attributes, shares):
    """The largest share that each splat of the tiles first..last has of a pixel there, in shares, unless it has a larger one already."""
    lines, left_over = groups.scratch(1)
    for tile in range(first, last):
        left, top = (tile_x + tile % columns) * raster.TILE, (tile_y + tile // columns) * raster.TILE
        raster.begin(left_over, left, top, x0, y0, right, bottom)
        live = np.uint32(EVERY)
        for k in range(starts[tile], starts[tile + 1]):
            i, ahead = np.intp(ids[k]), np.intp(ids[min(k + raster.AHEAD, starts[tile + 1] - 1)])
            simd.prefetch(geometry, ahead)
            simd.prefetch(attributes, ahead)
            u, v, slopes = raster.line(geometry, i, left, top)
            reached = groups.reached(lines, u, v, slopes, attributes[i, raster.LOG2_OPACITY], attributes[i, raster.LOG2_CUT], LANES)
            finished, share = take_light(left_over, reached & live, lines, slopes[0], attributes, i)
            if share > shares[i]:
                raise_to(shares, i, share)
            live &= ~finished
            if live == 0:
                break


@intrinsic
def take_light(context, left_over, visited, lines, du, attributes, splat):
    """Take a splat's share from the light that is left in its groups of pixels (groups.reached, which wrote lines).  Returns the groups
    whose pixels are all finished, and the largest share."""
    def build(context, b, signature, args):
        light, lines, attributes = (simd.Memory(context, b, signature.args[i], args[i]) for i in (0, 2, 4))
        du, width = simd.broadcast(b, args[3], LANES), make_array(signature.args[4])(context, b, args[4]).shape
        row = b.mul(args[5], b.extract_value(width, 1))
        kept = {i: simd.broadcast(b, attributes.scalar(row, i), LANES) for i in (raster.ALPHA_MAX, raster.LOG2_CUT)}
        finished, most = cgutils.alloca_once_value(b, groups.BITS(0)), cgutils.alloca_once_value(b, simd.constant(b, 0.0, LANES).value)
        with groups.each(b, args[1]) as (group, bit):
            pixel = b.mul(group, args[5].type(LANES))
            u, line = (simd.broadcast(b, lines.scalar(group, begin), LANES) for begin in (0, groups.ROW))
            before = light.floats(pixel, 0, LANES)
            share = before * raster.covering(b, kept.__getitem__, u, du, line)
            after = before - share
            live = after > T_STOP
            b.store(simd.Floats(b, b.load(most)).max(share.where(live, 0.0)).value, most)
            light.store(pixel, 0, after.where(live, before.negative_magnitude()))
            over = b.zext(b.not_(simd.any_of(b, live)), groups.BITS)
            b.store(b.or_(b.load(finished), b.shl(over, bit)), finished)
        return context.make_tuple(b, signature.return_type, (b.load(finished), simd.largest(b, simd.Floats(b, b.load(most)))))

    number = types.float32
    return types.Tuple((types.uint32, number))(left_over, types.uint32, lines, number, attributes, types.intp), build


@intrinsic
def raise_to(context, array, index, number):
    """Make an element of a float32 array at least so large, for a number from 0 on: what threads write side by side is not lost."""
    def build(context, b, signature, args):
        whole = ir.IntType(32)  # the bits of such numbers are in the numbers' order
        place = b.gep(make_array(signature.args[0])(context, b, args[0]).data, [args[1]])
        b.atomic_rmw("max", b.bitcast(place, whole.as_pointer()), b.bitcast(args[2], whole), "monotonic")
        return context.get_dummy_value()

    return types.void(array, types.intp, types.float32), build

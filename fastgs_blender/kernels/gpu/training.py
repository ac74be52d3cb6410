# SPDX-License-Identifier: GPL-3.0-or-later
"""A view in training on a GPU: its picture, its loss, and the backward pass to the model's parameters.

A step reads nothing back to the CPU: how long lists become is guessed from earlier steps (guesses.py).  In whatever bands a picture is
drawn, gradients have the same bytes, so it does not matter which bands earlier steps have led to.
"""
import math
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from ...cameras.camera import Camera
from ...model.appearance import Features
from ...model.gaussians import GaussianModel
from ...rendering.instances import AS_TRAINED, Instance, ViewedInstance
from ...rendering.layout import Layout
from .. import asserts
from ..parameters import DECODER
from ..protocol import Comparison, ForwardPass
from .blend import Band, How, blend_all
from .device import Array, Device, Failure
from .picture import Bands, decoder
from .rows import add_in, copy_in, empty_rows, rows_of
from .scene import DETACHED, ORDER, Pack, View, packs
from .splats import Splats, front_to_back, project

WINDOW = np.exp(-np.arange(-5, 6) ** 2 / (2 * 1.5**2))
"""SSIM's Gaussian window, as kernels/cpu/loss.py has it."""
REACH = len(WINDOW) // 2
LANES = 64
"""Threads of a workgroup of raster_backward.wgsl: fewer leave a GPU half empty, more wait for each other longer."""
PIXELS = 128
"""Pixels of a workgroup of colour_backward.wgsl and agreement.wgsl."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What forward() stores for backward(); matrices: the decoder's, or None; smooth: constants of the shaders; shapes: of all
    parameters."""

    instance: ViewedInstance
    camera: Camera
    layout: Layout
    packs: list[Pack]
    matrices: Array | None
    splats: Splats
    bands: list[Band]
    smooth: dict
    shapes: dict[str, tuple[int, ...]]

    def splats_of(self, pack: Pack) -> list[Array]:
        """The depths, a and b of a pack's splats."""
        piece = self.splats.piece_of(pack.first)
        first = pack.first - piece.first
        every = (Array(piece.depths, (piece.rows,), np.dtype(np.uint32)),
                 *(Array(buffer, (piece.rows, 4), np.dtype(np.float32)) for buffer in (piece.a, piece.b)))
        return [rows_of(each, first, first + pack.count) for each in every]


def forward(device: Device, parameters: dict[str, Array], template: GaussianModel, camera: Camera, t: float,
          depth: bool = False, band: float = 0.0) -> ForwardPass:
    """TrainingBackend.forward()."""
    asserts.forward(parameters, template)
    instance = Instance(template, np.eye(4), t, AS_TRAINED).viewed(camera)
    layout, found = Layout([instance], depth, opaque=True), packs(device, parameters, parameters["position"].shape[0])
    splats = project(device, [instance], camera, layout, [found])
    order = front_to_back(device, splats)
    how = How(trace=True, band=band)
    bands = blend_all(device, order, splats, camera, how, lambda share: None)
    alpha = _bands([_columns(band.flat, 0) for band in bands])
    if isinstance(template.appearance, Features):
        matrices = device.empty((90,))
        device.copy(parameters["w1"].buffer, matrices.buffer, 72)
        device.copy(parameters["w2"].buffer, matrices.buffer, 18, 0, 72)
        rgb = _bands([_decoded(device, band, layout, camera, matrices) for band in bands])
        features = _bands([_columns(band.channels, 0, 9) for band in bands])
    else:
        matrices, rgb, features = None, _bands([_columns(band.channels, 0, 3) for band in bands]), None
    deep = _bands([_columns(band.channels, layout.depth) for band in bands]) if layout.depth is not None else None
    shapes = {name: array.shape for name, array in parameters.items() if name in (*ORDER, *DECODER)}
    seen = Seen(instance, camera, layout, found, matrices, splats, bands, how.smooth, shapes)
    return ForwardPass(rgb, alpha, deep, seen, features)


def _bands(parts: list[Array]) -> Bands:
    return Bands(parts, _nothing_instead)


def _nothing_instead() -> NoReturn:
    raise Failure("it has failed before")


def _columns(array: Array, first: int, last: int | None = None) -> Array:
    """Some columns of [h, w, C]; without `last` one of them, as [h, w]."""
    shape = array.shape[:2] if last is None else (*array.shape[:2], last - first)
    return Array(array.buffer, shape, array.dtype, (first, first + 1 if last is None else last, array.shape[2]))


def _decoder_of(band: Band, layout: Layout, camera: Camera) -> list:
    return decoder(layout.groups[0], _columns(band.channels, 0, 9), _columns(band.flat, 0), camera, band.top)


def _decoded(device: Device, band: Band, layout: Layout, camera: Camera, matrices: Array) -> Array:
    """The colour [h, w, 3] of a band's features."""
    rgb = device.zeros((*band.channels.shape[:2], 3))
    device.run("colour", math.prod(rgb.shape[:2]), _decoder_of(band, layout, camera), band.channels, band.flat, matrices, rgb)
    return rgb


def picture(device: Device, stored: np.ndarray) -> Array:
    """TrainingBackend.picture() of bytes."""
    words = np.pad(stored.ravel(), (0, -stored.size % 4)).view(np.uint32)
    packed, out = device.buffer(len(words)), device.empty(stored.shape)
    device.write(packed, words)
    device.run("bytes", stored.size, [[stored.size, 0, 0, 0]], packed, out)
    return out


def _behind(background: np.ndarray | None) -> list[float]:
    """A background as shaders take it: its colour, and whether there is one."""
    return [0.0, 0.0, 0.0, 0.0] if background is None else [*map(float, background), 1.0]


def _over(device: Device, picture: ForwardPass, background: np.ndarray | None, shape: tuple[int, ...]) -> tuple[Array, Array]:
    """The picture [h, w, 3], its shape, over its background, and its alpha [h, w]."""
    whole, cover, done = device.empty(shape), device.empty(shape[:2]), 0
    for rgb, alpha in zip(picture.rgb.parts, picture.alpha.parts):
        count = math.prod(alpha.shape)
        strides = [3 if rgb.columns is None else rgb.columns[2], alpha.columns[2]]
        device.run("loss_over", count, [[count, done, *strides], _behind(background)], rgb, alpha, whole, cover)
        done += count
    return whole, cover


def over(device: Device, picture: ForwardPass, background: np.ndarray | None) -> tuple[Array, Array]:
    """TrainingBackend.over()."""
    asserts.over(picture, background)
    return _over(device, picture, background, picture.rgb.shape)


def agreement(device: Device, picture: ForwardPass, target: Array, weight: Array | None, least: Array | None, background: np.ndarray | None,
              gain: np.ndarray, bias: np.ndarray, sides: tuple[ForwardPass, ForwardPass] | None, apart: float, solid: float,
              outlier: float) -> Array:
    """TrainingBackend.agreement()."""
    asserts.agreement(picture, target, weight, least, background, gain, bias, sides)
    whole, cover = _over(device, picture, background, target.shape)
    late, early = (whole, whole) if sides is None else (_over(device, side, background, target.shape)[0] for side in sides)
    pixels, nothing = math.prod(target.shape[:2]), device.buffer(1)
    sums = device.empty((-(-pixels // PIXELS), 19))
    job = [[pixels, weight is not None, least is not None, sides is not None], [solid, outlier, apart, 0.0], [*map(float, gain)],
           [*map(float, bias)]]
    device.run("agreement", sums.shape[0], job, whole, cover, target, nothing if weight is None else weight,
               nothing if least is None else least, late, early, sums, groups=True)
    return Array(total(device, sums).buffer, (19,), np.dtype(np.float64))


def compare(device: Device, picture: ForwardPass, target: Array, weight: Array | None, background: np.ndarray | None, dssim: float,
            opaque_weight: float, share: float, least: Array | None = None) -> Comparison:
    """TrainingBackend.compare()."""
    asserts.compare(picture, target, weight, background, least)
    height, width = target.shape[:2]
    numbers = 3 * height * width
    behind, (whole, cover) = _behind(background), _over(device, picture, background, target.shape)
    if least is not None:
        bound, target = target, device.empty(target.shape)
        device.run("loss_least", numbers, [[numbers, 0, 0, 0]], whole, bound, least, target)
    values, by_rgb, by_alpha = device.empty((4,), np.float64), device.empty(target.shape), device.empty((height, width))
    weights = device.buffer(1) if weight is None else weight
    scales = [(1 - dssim) / numbers, -dssim / numbers, float(share), float(opaque_weight)]
    sums, taps, row = device.zeros((4,)), WINDOW / WINDOW.sum(), 3 * width

    def job(first: int, last: int, held: tuple[int, int], counted: tuple[int, int]) -> list:  # rows of the picture
        runs = [[number for begin, end in runs for number in (begin * row, (end - begin) * row)]
                for runs in (((first, last), held), (counted, (0, 0)))]
        return [[width, height, weight is not None, numbers], scales, behind, [*taps, 0.0], *runs]

    for first, last in strips(device, width, height):
        near, far = ((max(first - reach, 0), min(last + reach, height)) for reach in (REACH, 2 * REACH))
        moments, slopes = (device.buffer(planes * (far[1] - far[0]) * row) for planes in (5, 3))
        found = device.empty((-(-(near[1] - near[0]) * row // 256), 4))
        here = job(*near, far, (first, last))
        device.run("loss_moments", (far[1] - far[0]) * row, job(*far, far, far), whole, target, weights, moments)
        device.run("loss_similarity", (near[1] - near[0]) * row, here, whole, target, weights, cover, moments, slopes, found)
        device.run("loss_across", (near[1] - near[0]) * row, here, slopes, moments)
        device.run("loss_slope", (last - first) * width, job(first, last, far, far), whole, target, weights, moments, by_rgb, by_alpha)
        device.run("add", 4, [[4, 0, 0, 0]], total(device, found), sums)
    device.run("loss_values", 1, [[float(numbers), dssim, opaque_weight, 0.0]], sums, values, groups=True)
    emphasis = device.empty((height, width))
    device.run("emphasis", height * width, [[height * width, weight is not None, 0, 0]], whole, target, weights, sums, emphasis)
    return Comparison(values, by_rgb, None if background is None and not opaque_weight else by_alpha, emphasis)


def strips(device: Device, width: int, height: int) -> list[tuple[int, int]]:
    """The rows of a picture in strips (first, last), of which the moments fit into a buffer; raises TooLarge."""
    device.fits(5 * 3 * width * (4 * REACH + 1))
    most = device.binding // (4 * 5 * 3 * width)
    if most >= height:
        return [(0, height)]
    return [(first, min(first + most - 4 * REACH, height)) for first in range(0, height, most - 4 * REACH)]


def total(device: Device, values: Array) -> Array:
    """Sums [C] down the columns of values [R, C], always in the same order."""
    rows, columns = values.shape
    while rows > 1:
        blocks = -(-rows // 64)
        sums = device.empty((blocks, columns))
        device.run("sum_rows", blocks * columns, [[rows, columns, 0, 0]], values, sums)
        rows, values = blocks, sums
    return Array(values.buffer, (columns,), values.dtype) if rows else device.zeros((columns,))


def backward(device: Device, picture: ForwardPass, rgb: Array | None, alpha: Array | None = None, depth: Array | None = None, *,
             into: dict[str, Array] | None = None, statistics: Any = None, emphasis: Array | None = None,
             seen: Array | None = None, detach_time: bool = False) -> dict[str, Array]:
    """TrainingBackend.backward()."""
    asserts.backward(picture, rgb, alpha, depth, into, statistics, emphasis, seen)
    view: Seen = picture.state
    quads, channels, found = view.splats.quads, 3, {}
    height, width = view.camera.window[3], view.camera.window[2]
    by_alpha = device.zeros((height, width)) if alpha is None else alpha
    slopes = [device.zeros((height, width, 3)) if rgb is None else rgb] * len(view.bands)
    if view.matrices is not None:
        w1, w2 = device.zeros((6, 12)), device.zeros((3, 6))
        found = {"w1": w1, "w2": w2}
        if rgb is not None:
            by_alpha, channels = device.zeros((height, width)), 9
            if alpha is not None:
                device.copy(alpha.buffer, by_alpha.buffer, height * width)
            slopes = _decoder_backward(device, view, rgb, by_alpha, w1, w2)
    deep = 0 if depth is None or view.layout.depth is None else view.layout.depth + 1
    sums, done = [device.zeros((pack.count, 4 * (quads + 2))) for pack in view.packs], 0
    for band, its_slopes in zip(view.bands, slopes, strict=True):
        pixels = math.prod(band.flat.shape[:2])
        start, rows = device.buffer(4 * (quads + 1) * pixels), device.buffer(4 * (quads + 2) * band.lists.entries)
        job = [[pixels, done, channels, deep], [0 if channels == 9 else done, emphasis is not None, 0, 0]]
        device.run("raster_seed", pixels, job, band.flat, its_slopes, by_alpha, depth if deep else by_alpha,
                   by_alpha if emphasis is None else emphasis, start, QUADS=quads)
        x0 = view.camera.window[0]
        device.run("raster_backward", band.lists.grid[2] * band.lists.grid[3], [[x0, band.top, x0 + width, band.bottom], band.lists.grid],
                   band.lists.lists, band.lists.values, band.splats.a, band.splats.b, band.splats.channels, start, rows, groups=True,
                   QUADS=quads, LANES=LANES, **view.smooth)
        for pack, its in zip(view.packs, sums, strict=True):
            job = [[band.splats.rows, pack.first, pack.count, 0]]
            device.run("collect", band.splats.rows, job, band.rows, band.lists.runs, rows, its, QUADS=quads)
        done += pixels
    if statistics is not None:
        _observe(device, view, sums, statistics)
    if seen is not None:
        for pack in view.packs:
            drawn = rows_of(seen, pack.first, pack.first + pack.count)
            device.run("mark", pack.count, [[pack.count, 0, 0, 0]], view.splats_of(pack)[0], drawn)
    return _to_parameters(device, view, sums, found, into, detach_time)


def _decoder_backward(device: Device, view: Seen, rgb: Array, by_alpha: Array, w1: Array, w2: Array) -> list[Array]:
    """Gradients of the features [h, w, 9] of each band; that of alpha and of the decoder's matrices are added to by_alpha, w1 and w2."""
    blocks, found = -(-view.camera.window[2] // PIXELS), []
    sums = device.empty((view.camera.window[3] * blocks, 90))
    for band in view.bands:
        slopes = device.empty((*band.flat.shape[:2], 9))
        device.run("colour_backward", slopes.shape[0] * blocks, _decoder_of(band, view.layout, view.camera), band.channels, band.flat,
                   view.matrices, rgb, slopes, by_alpha, sums, groups=True)
        found.append(slopes)
    both = total(device, sums)
    device.run("add", 72, [[72, 0, 0, 0]], both, w1)
    device.run("add", 18, [[18, 72, 0, 0]], both, w2)
    return found


def _observe(device: Device, view: Seen, sums: list[Array], statistics: Any) -> None:
    """Add the view to the statistics of density control."""
    camera = view.camera
    for pack, its in zip(view.packs, sums, strict=True):
        found, size = view.splats_of(pack), [pack.count, 0, 0, 0]
        gradient, absolute, seen, radius = (rows_of(each, pack.first, pack.first + pack.count) for each in (
            statistics.gradient, statistics.absolute, statistics.seen, statistics.radius))
        device.run("observe", pack.count, [size, [camera.width / 2, camera.height / 2, 0.0, 0.0]], *found, its, gradient, absolute,
                   device.spilled, QUADS=view.splats.quads)
        device.run("notice", pack.count, [size, [float(max(camera.width, camera.height)), 0.0, 0.0, 0.0]], *found, seen, radius,
                   device.spilled)


def _to_parameters(device: Device, view: Seen, sums: list[Array], found: dict[str, Array], into: dict[str, Array] | None,
                   detach_time: bool) -> dict[str, Array]:
    """Compute the gradients of the parameters from those of the splats; they are added to `into`, if given."""
    out: dict[str, Any] = {name: empty_rows(device, view.shapes[name]) for name in ORDER} if into is None else into
    project_view = View(device, view.instance, view.camera, view.layout)
    project_view.flags |= DETACHED * detach_time
    bring = copy_in if into is None else add_in
    for pack, its in zip(view.packs, sums, strict=True):
        gradient = device.buffer(pack.buffer.size // 4)
        device.clear(gradient)
        device.run("project_backward", pack.count, project_view.parameters(pack, 0, 4 * view.splats.quads), pack.buffer,
                   project_view.extra, *view.splats_of(pack), its, gradient, QUADS=view.splats.quads)
        at = 0
        for name in ORDER:
            bring(device, gradient, at, out[name], pack.first, pack.count)
            at += pack.count * math.prod(view.shapes[name][1:])
    for name, slope in found.items():
        if into is None:
            out[name] = slope
        else:
            count = math.prod(slope.shape)
            device.run("add", count, [[count, 0, 0, 0]], slope, out[name])
    return out

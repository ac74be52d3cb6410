# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws instances on a GPU: projects them, sorts and lists the splats, blends them, and decodes features.

A picture that does not fit into the GPU's memory is drawn in bands of rows of tiles; its buffers are then several Arrays (Bands).
"""
from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...cameras.camera import Camera
from ...model.appearance import ACTIVATIONS, Features
from ...model.gaussians import GaussianModel
from ...rendering.instances import ViewedInstance
from ...rendering.layout import PROBES, Buffers, ChannelGroup, Layout
from ...rendering.quantities import Shown
from .device import Array, Buffer, Device, TooLarge
from .lists import ENTRIES, TileLists, grid_of, list_tiles, scan
from .scene import Pack, View, packs
from .shaders import TILE

NOWHERE = 0xFFFFFFFF
"""The depth of what is not drawn."""
PLAIN = len(ACTIVATIONS)
KEPT = 8
"""Models that stay on the device."""


@dataclass(frozen=True, eq=False)
class Bands:
    """An array of a picture [h, ...] in bands, from the top down; instead: gives the same by the CPU, should the device fail."""

    parts: list[Array]
    instead: Callable[[], np.ndarray]

    def numpy(self) -> np.ndarray:
        """The whole of it."""
        found = [part.numpy() for part in self.parts]
        return found[0] if len(found) == 1 else np.concatenate(found)


@dataclass(frozen=True, eq=False)
class Splats:
    """Splats of instances, in rows (wgsl/project.wgsl).

    rows     their number
    quads    4 channels each, of a splat
    """

    a: Buffer
    b: Buffer
    channels: Buffer
    depths: Buffer
    rows: int
    quads: int

    @property
    def arrays(self) -> tuple[Buffer, ...]:
        """The buffers."""
        return self.a, self.b, self.channels, self.depths

    @property
    def numbers(self) -> tuple[int, ...]:
        """The numbers of a row in each of them."""
        return 4, 4, 4 * self.quads, 1


class Models:
    """The models that stay on a device, because nothing can change their arrays: those read from files, as long as few others are drawn."""

    def __init__(self, device: Device):
        self.device, self.kept = device, OrderedDict()

    def packs(self, model: GaussianModel) -> list[Pack]:
        """The model's arrays on the device."""
        if id(model) in self.kept:
            self.kept.move_to_end(id(model))
            return self.kept[id(model)][1]
        found = packs(self.device, model.arrays, len(model))
        if not any(array.flags.writeable for array in model.arrays.values() if array.size):
            self.kept[id(model)] = model, found
            if len(self.kept) > KEPT:
                self.kept.popitem(last=False)
        return found


def project(device: Device, instances: list[ViewedInstance], camera: Camera, layout: Layout, found: list[list[Pack]],
            every: bool = False) -> Splats:
    """The splats of all instances, in the order of their Gaussians; found: the packs of each one's model.

    There is a row for each Gaussian; where these would be more than the device can use at once, for each that is drawn.
    every  a row for each Gaussian in any case, as the backward pass needs
    """
    quads, views = -(-layout.channels // 4), [View(device, instance, camera, layout) for instance in instances]
    parts = [(view, pack) for view, packs_ in zip(views, found, strict=True) for pack in packs_]
    rows = sum(pack.count for _, pack in parts)
    if every or 16 * quads * rows <= device.binding:
        return _projected(device, parts, layout, quads)
    return _joined(device, [_squeezed(device, _projected(device, [part], layout, quads)) for part in parts], quads)


def _projected(device: Device, parts: list[tuple[View, Pack]], layout: Layout, quads: int) -> Splats:
    """The splats of packs, each before its view: a row for each Gaussian."""
    splats, done = _room(device, sum(pack.count for _, pack in parts), quads), 0
    for view, pack in parts:
        device.run("project", pack.count, view.parameters(pack, done, 4 * quads), pack.buffer, view.extra, view.hidden,
                   splats.a, splats.b, splats.channels, splats.depths, BENDS=bool(view.instance.settings.bends))
        done += pack.count
    if layout.quantities:
        _fill(device, splats, parts, layout)
    return splats


def _room(device: Device, rows: int, quads: int) -> Splats:
    """Splats that are not initialised."""
    return Splats(device.buffer(4 * rows), device.buffer(4 * rows), device.buffer(4 * quads * rows), device.buffer(rows), rows, quads)


def _squeezed(device: Device, splats: Splats) -> Splats:
    """Those of the splats that are drawn."""
    places = device.buffer(splats.rows + 1)
    device.clear(places)
    device.run("present", splats.rows, [[splats.rows, 0, 0, 0]], splats.depths, places)
    scan(device, places, splats.rows + 1)
    drawn = _room(device, int(device.read(places, np.uint32, 1, splats.rows)[0]), splats.quads)
    for values, copies, numbers in zip(splats.arrays, drawn.arrays, splats.numbers):
        device.run("squeeze", splats.rows, [[splats.rows, numbers, 0, 0]], splats.depths, places, values, copies)
    return drawn


def _joined(device: Device, parts: list[Splats], quads: int) -> Splats:
    """Splats of several packs one after the other."""
    splats, done = _room(device, sum(part.rows for part in parts), quads), 0
    for part in parts:
        for values, copies, numbers in zip(part.arrays, splats.arrays, splats.numbers):
            device.copy(values, copies, numbers * part.rows, 0, numbers * done)
        done += part.rows
    return splats


def _fill(device: Device, splats: Splats, parts: list[tuple[View, Pack]], layout: Layout) -> None:
    """Write the layout's quantities into the channels: they are computed in array code, for every backend."""
    seen = device.read(splats.depths, np.uint32, splats.rows) != NOWHERE
    channels = device.read(splats.channels, np.float32, 4 * splats.quads * splats.rows).reshape(splats.rows, -1).copy()
    done = 0
    for view, pack in parts:
        index = np.flatnonzero(seen[done:done + pack.count])
        shown = Shown(view.instance, pack.first + index)
        for name, quantity in layout.quantities.items():
            channels[done + index, layout.places[name]] = quantity.of(shown)
        done += pack.count
    device.write(splats.channels, channels)


@dataclass(frozen=True, eq=False)
class Band:
    """A part of a picture: rows top..bottom of the image.

    channels  [h, w, 4 quads]
    flat      [h, w, P]: alpha, then the probes that were asked for; with a trace: alpha, transmittance, and the place of the last splat
    """

    top: int
    bottom: int
    channels: Array
    flat: Array
    lists: TileLists


def blend(device: Device, order: Buffer, splats: Splats, camera: Camera, rows: tuple[int, int], probes: list[str], trace: bool,
          band: float) -> Band:
    """Blend the splats into the rows of tiles first..last of the camera's window; raises TooLarge."""
    x0, y0, width, height = camera.window
    left, top, columns, _ = grid_of(camera.window)
    first, last = max(y0, (top + rows[0]) * TILE), min(y0 + height, (top + rows[1]) * TILE)
    entry = 16 * (splats.quads + 2) if trace else 4  # bytes: the backward pass has a row of sums for each
    most = min(ENTRIES, device.binding // entry)
    lists = list_tiles(device, order, splats, (left, top + rows[0], columns, rows[1] - rows[0]), most, trace and device.guessing)
    shape, numbers = (last - first, width), 3 if trace else 1 + len(probes)
    channels, flat = device.empty((*shape, 4 * splats.quads)), device.empty((*shape, numbers))
    places = {name.upper(): 1 + probes.index(name) if name in probes else 0 for name in PROBES}
    device.run("raster", columns * (rows[1] - rows[0]), [[x0, first, x0 + width, last], list(lists.grid), [first, numbers, 0, 0]],
               lists.starts, lists.ids, splats.a, splats.b, splats.channels, splats.depths, channels, flat, groups=True,
               QUADS=splats.quads, TRACE=trace, **places, **smooth(band))
    return Band(first, last, channels, flat, lists)


def smooth(band: float) -> dict:
    """The constants of shaders that let alpha fade in over a band above the cut (protocol.TrainingBackend.splat)."""
    return {"SMOOTH": band > 0, "PER_BAND": 1 / band if band > 0 else 0.0}


def blend_all(device: Device, order: Buffer, splats: Splats, camera: Camera, probes: list[str], progress, trace: bool = False,
              band: float = 0.0) -> list[Band]:
    """Blend the splats into the camera's window: in one go, or in as many bands as it takes.  A row of tiles that does not fit fails.

    trace  keep what the backward pass needs instead of probes
    """
    rows = grid_of(camera.window)[3]
    waiting, bands = [(0, rows)], []
    while waiting:
        first, last = waiting.pop()
        try:
            bands.append(blend(device, order, splats, camera, (first, last), probes, trace, band))
            progress(last / rows)
        except TooLarge:
            if last - first == 1:
                raise
            middle = (first + last) // 2
            waiting += [(middle, last), (first, middle)]
    return bands


@dataclass(frozen=True, eq=False)
class DeviceBuffers(Buffers):
    """The Buffers of a picture on a device; again: gives those that the CPU draws."""

    again: Callable[[], Buffers] = Buffers  # always given

    @classmethod
    def of(cls, bands: list[Band], layout: Layout, probes: list[str], again: Callable[[], Buffers]) -> DeviceBuffers:
        """The bands by what their numbers mean."""
        def columns(array: Array, first: int, last: int, squeeze: bool) -> Array:
            shape = array.shape[:2] if squeeze else (*array.shape[:2], last - first)
            return Array(array.buffer, shape, array.dtype, (first, last, array.shape[2]))

        def channels(where: slice, instead) -> Bands:
            return Bands([columns(band.channels, where.start, where.stop, False) for band in bands], instead)

        def flat(place: int, instead) -> Bands:
            return Bands([columns(band.flat, place, place + 1, True) for band in bands], instead)

        return cls(channels(slice(0, layout.channels), lambda: again().channels), flat(0, lambda: again().alpha),
                   {name: channels(where, lambda name=name: again().sums[name]) for name, where in layout.places.items()},
                   {name: flat(1 + i, lambda name=name: again().probes[name]) for i, name in enumerate(probes)}, again=again)


def colour(device: Device, buffers: DeviceBuffers, layout: Layout, camera: Camera, instead: Callable[[], np.ndarray]) -> Bands:
    """Premultiplied colour [h, w, 3]: the sum over the layout's groups."""
    bands, top = [], camera.window[1]
    for channels, alpha in zip(buffers.channels.parts, buffers.alpha.parts):
        height, width = channels.shape[:2]
        rgb = device.zeros((height, width, 3))
        for group in layout.groups:
            weights = alpha if group.weight is None else channels
            device.run("colour", height * width, decoder(group, channels, alpha, camera, top), channels, weights,
                       matrices_of(device, group), rgb)
        bands.append(rgb)
        top += height
    return Bands(bands, instead)


def decoder(group: ChannelGroup, channels: Array, alpha: Array, camera: Camera, top: int) -> list:
    """The numbers of wgsl/decoder.wgsl for a group of channels in a band whose first row is `top` of the image."""
    (height, width), numbers = channels.shape[:2], channels.columns[2]
    weight = [0, alpha.columns[2]] if group.weight is None else [group.weight, numbers]
    to_model, look, activation = np.zeros((3, 4)), np.zeros(20), PLAIN
    if group.instance is not None:
        to_model, look = group.instance.camera_to_model[:3], group.instance.look
        activation = ACTIVATIONS.index(group.instance.model.appearance.activation)
    lens = [float(value) for value in (camera.fx, camera.fy, camera.cx, camera.cy)]
    return [*to_model, lens, [float(camera.window[0]), float(top), float(camera.orthographic), 0.0],
            look, [height * width, width, numbers, (top - camera.window[1]) * width], [group.offset, *weight, activation]]


def matrices_of(device: Device, group: ChannelGroup) -> Array:
    """The matrices of a group's decoder, w1 and then w2; zeros where it has none."""
    if group.instance is None:
        return device.zeros((90,))
    look: Features = group.instance.model.appearance
    return device.array(np.concatenate([look.w1.ravel(), look.w2.ravel()]))

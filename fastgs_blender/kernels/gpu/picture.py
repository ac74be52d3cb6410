# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of instances on a GPU: projects them, and decodes features.

A picture that does not fit into the GPU's memory is drawn in bands of rows of tiles; its buffers are then several Arrays (Bands).
"""
from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from ...cameras.camera import Camera
from ...model.appearance import ACTIVATIONS, Features
from ...model.gaussians import GaussianModel, unchanging
from ...rendering.instances import ViewedInstance
from ...rendering.layout import Buffers, ChannelGroup, Layout
from ...rendering.quantities import Shown
from .blend import Band, How, blend_all
from .device import Array, Buffer, Device
from .holdout import Occluder
from .lists import front_to_back, scan
from .scene import Pack, View, packs

NOWHERE = 0xFFFFFFFF
"""The depth of what is not drawn."""
PLAIN = len(ACTIVATIONS)
FILLED = 16
"""Numbers that wgsl/fill.wgsl writes at most."""
KEPT = 2 << 30
"""Bytes of models that stay on the device."""


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
    """The models that stay on a device from one picture to the next: those whose arrays nothing changes (model.gaussians.unchanging).

    They are kept up to KEPT bytes, those that were drawn last, and until nothing else refers to them or the device's memory is full.
    """

    def __init__(self, device: Device):
        self.device = device
        self.kept: WeakKeyDictionary[GaussianModel, list[Pack]] = WeakKeyDictionary()
        device.when_full.append(self.kept.clear)

    def packs(self, model: GaussianModel) -> list[Pack]:
        """The model's arrays on the device."""
        found = self.kept.pop(model, None) or packs(self.device, model.arrays, len(model))
        if unchanging(model):
            for pack in found:
                pack.buffer.reused = False
            self.kept[model] = found  # the last one, so that it goes last
            sizes = {other: sum(pack.buffer.size for pack in its) for other, its in list(self.kept.items())}
            for other in list(sizes)[:-1]:
                if sum(sizes.values()) > KEPT:
                    del sizes[other], self.kept[other]
        return found


def project(device: Device, instances: list[ViewedInstance], camera: Camera, layout: Layout, found: list[list[Pack]],
            every: bool = False, then: Callable[[Splats, int], None] | None = None) -> Splats:
    """The splats of all instances, in the order of their Gaussians; found: the packs of each one's model.

    There is a row for each Gaussian; where these would be more than the device can use at once, for each that is drawn.
    every  a row for each Gaussian in any case, as the backward pass needs
    then   called with splats that have a row for each Gaussian, and the number of the first one, counted through all instances
    """
    quads, views = -(-layout.channels // 4), [View(device, instance, camera, layout) for instance in instances]
    parts = [(view, pack) for view, packs_ in zip(views, found, strict=True) for pack in packs_]
    rows = sum(pack.count for _, pack in parts)
    if every or 16 * quads * rows <= device.binding:
        return _projected(device, parts, layout, quads, then)
    squeezed, done = [], 0
    for view, pack in parts:
        found = _projected(device, [(view, pack)], layout, quads, then and (lambda splats, first, done=done: then(splats, done + first)))
        squeezed.append(_squeezed(device, found))
        done += pack.count
    return _joined(device, squeezed, quads)


def draw(device: Device, models: Models, instances: list[ViewedInstance], camera: Camera, layout: Layout, probes: Collection[str],
         progress: Callable[[float], None], holdout: np.ndarray | None, again: Callable[[], Buffers]) -> DeviceBuffers:
    """PictureBackend.draw()."""
    occluder = None if holdout is None else Occluder(device, holdout, camera)
    splats = project(device, instances, camera, layout, [models.packs(instance.model) for instance in instances])
    progress(0.3)
    how = How(tuple(probes), occluder=occluder, by_pixel=layout.by_pixel, plane=layout.plane or 0)
    bands = blend_all(device, front_to_back(device, splats.depths, splats.rows), splats, camera, how, lambda f: progress(0.3 + 0.6 * f))
    return DeviceBuffers.of(bands, layout, how, again)


def _projected(device: Device, parts: list[tuple[View, Pack]], layout: Layout, quads: int, then=None) -> Splats:
    """The splats of packs, each before its view: a row for each Gaussian."""
    splats, done = _room(device, sum(pack.count for _, pack in parts), quads), 0
    for view, pack in parts:
        device.run("project", pack.count, view.parameters(pack, done, 4 * quads), pack.buffer, view.extra, view.hidden,
                   splats.a, splats.b, splats.channels, splats.depths, BENDS=bool(view.instance.settings.bends))
        done += pack.count
    if layout.quantities:
        _fill(device, splats, parts, layout)
    if then is not None:
        then(splats, 0)
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
    """Write the layout's quantities into the channels: what all Gaussians of an instance have in common on the device, and what each has
    for itself, with a read-back, by array code that serves every backend."""
    own = {name: quantity for name, quantity in layout.quantities.items() if quantity.same is None or quantity.width > FILLED}
    done = 0
    for view, pack in parts:
        for name, quantity in layout.quantities.items():
            if name not in own:
                values = np.zeros(FILLED, np.float32)
                values[:quantity.width] = quantity.same(view.instance)
                job = [[pack.count, done, 4 * splats.quads, layout.places[name].start], [quantity.width, 0, 0, 0], values]
                device.run("fill", pack.count, job, splats.channels)
        done += pack.count
    if not own:
        return
    seen = device.read(splats.depths, np.uint32, splats.rows) != NOWHERE
    channels = device.read(splats.channels, np.float32, 4 * splats.quads * splats.rows).reshape(splats.rows, -1).copy()
    done = 0
    for view, pack in parts:
        index = np.flatnonzero(seen[done:done + pack.count])
        shown = Shown(view.instance, pack.first + index)
        for name, quantity in own.items():
            channels[done + index, layout.places[name]] = quantity.of(shown)
        done += pack.count
    device.write(splats.channels, channels)


@dataclass(frozen=True, eq=False)
class DeviceBuffers(Buffers):
    """The Buffers of a picture on a device; again: gives those that the CPU draws."""

    again: Callable[[], Buffers] = Buffers  # always given

    @classmethod
    def of(cls, bands: list[Band], layout: Layout, how: How, again: Callable[[], Buffers]) -> DeviceBuffers:
        """The bands by what their numbers mean."""
        def columns(array: Array, first: int, last: int, squeeze: bool) -> Array:
            shape = array.shape[:2] if squeeze else (*array.shape[:2], last - first)
            return Array(array.buffer, shape, array.dtype, (first, last, array.shape[2]))

        def channels(where: slice, instead) -> Bands:
            return Bands([columns(band.channels, where.start, where.stop, False) for band in bands], instead)

        def flat(place: int, instead) -> Bands:
            return Bands([columns(band.flat, place, place + 1, True) for band in bands], instead)

        held = {name: flat(how.places[name], lambda name=name: getattr(again(), name)) for name in ("held", "covered") if how.occluder}
        return cls(channels(slice(0, layout.channels), lambda: again().channels), flat(0, lambda: again().alpha),
                   {name: channels(where, lambda name=name: again().sums[name]) for name, where in layout.places.items()},
                   {name: flat(place, lambda name=name: again().probes[name]) for name, place in how.places.items() if name not in held},
                   **held, again=again)


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

# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of instances on a GPU: draws them, and decodes features.

A picture that does not fit into the GPU's memory is drawn in bands of rows of tiles; its buffers are then several Arrays (Bands).
"""
from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ...cameras.camera import Camera
from ...model.appearance import ACTIVATIONS, DECODES, Features
from ...model.gaussians import GaussianModel, unchanging
from ...rendering.instances import ViewedInstance
from ...rendering.layout import Buffers, ChannelGroup, Layout
from .blend import Band, How, blend_all
from .device import Array, Device
from .holdout import Occluder
from .scene import Pack, packs
from .splats import front_to_back, project

PLAIN = len(ACTIVATIONS)
WAYS = (*DECODES, "lifted")
"""ChannelGroup.decode by its code in wgsl/decoder.wgsl."""
KEPT = 2 << 30
"""Bytes of models that stay on the device."""


@dataclass(frozen=True, eq=False)
class Bands:
    """An array of a picture [h, ...] in bands, from the top down; instead: gives the same by the CPU, should the device fail."""

    parts: list[Array]
    instead: Callable[[], np.ndarray]

    @property
    def shape(self) -> tuple[int, ...]:
        """As NumPy would have it."""
        return (sum(part.shape[0] for part in self.parts), *self.parts[0].shape[1:])

    def numpy(self) -> np.ndarray:
        """The whole of it."""
        found = [part.numpy() for part in self.parts]
        return found[0] if len(found) == 1 else np.concatenate(found)


class Models:
    """The models that stay on a device from one picture to the next: those whose arrays nothing changes (model.gaussians.unchanging).

    They are kept up to KEPT bytes, those that were drawn last, and until nothing else refers to them or the device's memory is full.
    """

    def __init__(self, device: Device) -> None:
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
                    del sizes[other]
                    self.kept.pop(other, None)  # another thread may have it in its hands
        return found


def draw(device: Device, models: Models, instances: list[ViewedInstance], camera: Camera, layout: Layout, probes: Collection[str],
         progress: Callable[[float], None], holdout: np.ndarray | None, again: Callable[[], Buffers]) -> DeviceBuffers:
    """PictureBackend.draw()."""
    occluder = None if holdout is None else Occluder(device, holdout, camera)
    splats = project(device, instances, camera, layout, [models.packs(instance.model) for instance in instances])
    progress(0.3)
    how = How(tuple(probes), occluder=occluder, by_pixel=layout.by_pixel, plane=layout.plane or 0, core=layout.core)
    bands = blend_all(device, front_to_back(device, splats), splats, camera, how, lambda f: progress(0.3 + 0.6 * f))
    return DeviceBuffers.of(bands, layout, how, again)


@dataclass(frozen=True, eq=False)
class DeviceBuffers(Buffers):
    """The Buffers of a picture on a device; again: gives those that the CPU draws."""

    again: Callable[[], Buffers] = field(kw_only=True)

    @classmethod
    def of(cls, bands: list[Band], layout: Layout, how: How, again: Callable[[], Buffers]) -> DeviceBuffers:
        """The bands by what their numbers mean."""
        def columns(array: Array, first: int, last: int, squeeze: bool) -> Array:
            shape = array.shape[:2] if squeeze else (*array.shape[:2], last - first)
            return Array(array.buffer, shape, array.dtype, (first, last, array.shape[2]))

        def channels(where: slice, instead: Any) -> Bands:
            return Bands([columns(band.channels, where.start, where.stop, False) for band in bands], instead)

        def flat(place: int, instead: Any) -> Bands:
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
    assert channels.columns is not None and alpha.columns is not None
    (height, width), numbers = channels.shape[:2], channels.columns[2]
    weight = [0, alpha.columns[2]] if group.weight is None else [group.weight, numbers]
    to_model, look, activation, way = np.zeros((3, 4)), np.zeros(20), PLAIN, 0
    if group.instance is not None:
        to_model, look = group.instance.camera_to_model[:3], group.instance.look
        activation, way = ACTIVATIONS.index(_decoder_of(group.instance).activation), WAYS.index(group.decode)
    lens = [float(value) for value in (camera.fx, camera.fy, camera.cx, camera.cy)]
    return [*to_model, lens, [float(camera.window[0]), float(top), float(camera.orthographic), float(way)],
            look, [height * width, width, numbers, (top - camera.window[1]) * width], [group.offset, *weight, activation]]


def matrices_of(device: Device, group: ChannelGroup) -> Array:
    """The matrices of a group's decoder, w1 and then w2; zeros where it has none."""
    if group.instance is None:
        return device.zeros((90,))
    look = _decoder_of(group.instance)
    return device.array(np.concatenate([look.w1.ravel(), look.w2.ravel()]))


def _decoder_of(instance: ViewedInstance) -> Features:
    look = instance.model.appearance
    assert isinstance(look, Features)
    return look

# SPDX-License-Identifier: GPL-3.0-or-later
"""Packs a model and a camera for the shaders: the model's arrays in one buffer (wgsl/slice.wgsl), and the uniforms of wgsl/view.wgsl."""
import math
from dataclasses import dataclass

import numpy as np

from ...cameras.camera import Camera
from ...model.appearance import Changing, Features, momentary
from ...model.motion import Basis
from ...rendering.crops import crop_arrays
from ...rendering.instances import ViewedInstance
from ...rendering.layout import Layout
from ...rendering.looks import Look
from .device import Array, Buffer, Device, TooLarge
from .rows import ROWS, Split, copy_out
from .shaders import FARTHEST

ORDER = ("position", "rotation", "scale", "opacity", "mu_tau", "temporal", "motion", "rotation_motion", "features")
"""The arrays of a model as they follow each other in its buffer."""
MOTION_CENTRED, ROTATION_CENTRED, COLOUR_CENTRED, ANTIALIASED, ORTHOGRAPHIC, HIDDEN, DETACHED, BLURRED = (1 << bit for bit in range(8))


@dataclass(frozen=True, eq=False)
class Pack:
    """The arrays of the Gaussians first .. first + count of a model, one after the other, in ORDER; but for the last pack, count is a
    multiple of ROWS."""

    first: int
    count: int
    buffer: Buffer


def packs(device: Device, arrays: dict, count: int) -> list[Pack]:
    """A model's arrays by name, NumPy's or the device's, in as many buffers as they need."""
    widths = {name: math.prod(arrays[name].shape[1:]) for name in ORDER}
    most = device.binding // (4 * sum(widths.values())) // ROWS * ROWS
    if not most:
        raise TooLarge(f"a Gaussian of {sum(widths.values())} numbers is more than it can use")
    found = []
    for first in range(0, count, most):
        number = min(most, count - first)
        pack, at = Pack(first, number, device.buffer(number * sum(widths.values()))), 0
        for name, width in widths.items():
            array = arrays[name]
            if isinstance(array, Array | Split):
                copy_out(device, array, first, number, pack.buffer, at)
            else:
                device.write(pack.buffer, np.ascontiguousarray(array[first:first + number], np.float32), at)
            at += number * width
        found.append(pack)
    return found


class View:
    """An instance before a camera, for the packs of its model: parameters(), and the arrays `extra` and `hidden`."""

    def __init__(self, device: Device, instance: ViewedInstance, camera: Camera, layout: Layout) -> None:
        self.instance, self.camera, self.layout = instance, camera, layout
        model = instance.model
        look = model.appearance
        basis = look.basis if isinstance(look, Changing) else None
        pairs = [_pairs(model.basis, instance.t), _pairs(model.rotation_basis, instance.t),
                 np.zeros((0, 2)) if basis is None else _pairs(basis, instance.t)]
        rows, remove, kinds, soft, volumes = crop_arrays(instance.settings.crops)
        crops = np.zeros((len(remove), 16))
        crops[:, :12], crops[:, 12], crops[:, 13], crops[:, 14] = rows.reshape(-1, 12), remove, kinds, soft
        parts = [*(each.ravel() for each in pairs), crops.ravel()]
        self.cameras = sum(map(len, parts))
        parts.append(instance.sampling.cameras.ravel())
        self.volumes = sum(map(len, parts)), volumes.shape[1]
        self.terms = [*map(len, pairs), len(crops)]
        self.extra = device.array(np.concatenate([*parts, volumes.ravel()]).astype(np.float32))
        bits = np.packbits(instance.hidden, bitorder="little")
        self.hidden = device.array(np.pad(bits, (0, -len(bits) % 4)).view(np.uint32))
        self.flags = sum(flag for flag, on in (
            (MOTION_CENTRED, model.basis.centred), (ROTATION_CENTRED, model.rotation_basis.centred),
            (COLOUR_CENTRED, basis is not None and basis.centred), (ANTIALIASED, model.raster.antialiased),
            (ORTHOGRAPHIC, camera.orthographic), (HIDDEN, len(instance.hidden) > 0), (BLURRED, layout.by_pixel)) if on)

    def parameters(self, pack: Pack, row: int, channels: int) -> list:
        """The numbers of View for a pack whose first splat is in a row, with so many channels to a splat."""
        instance, camera, layout, model = self.instance, self.camera, self.layout, self.instance.model
        raster, group, momentarily = model.raster, layout.group_of(instance), momentary(model.appearance)
        to_camera, to_model = instance.model_to_camera, instance.camera_to_model
        x0, y0, width, height = camera.window
        look = instance.look.copy()
        look[Look.GRADED] *= not isinstance(model.appearance, Features)  # a decoder's colours are changed when it has made them
        ball, sampling = np.minimum(instance.ball, FARTHEST), instance.sampling

        def plus_one(place: int | None) -> int:
            return 0 if place is None else place + 1

        return [
            *to_camera[:3], [*to_model[:3, 2 if camera.orthographic else 3], 0.0],
            [float(v) for v in (camera.fx, camera.fy, camera.cx, camera.cy)], [*camera.tangent_limits()],
            [x0 + 0.5, x0 + width - 0.5, y0 + 0.5, y0 + height - 0.5],
            [float(instance.near), instance.far, camera.width / 2, camera.height / 2],
            [raster.blur, raster.alpha_max, raster.alpha_cut, math.log2(raster.alpha_cut)], ball,
            [instance.t, sampling.zoom], sampling.ball, [sampling.pixel, sampling.coarse, sampling.least, sampling.reach],
            [int(sampling.fades), len(sampling.cameras), self.cameras], look,
            [pack.count, row, channels, pack.first],
            [model.basis.terms, model.rotation_basis.terms, model.temporal.shape[1], model.features.shape[1]],
            [model.temporal_kind.code, momentarily.code, getattr(momentarily, "degree", 0), momentarily.width],
            [group.offset, plus_one(group.weight), plus_one(layout.depth), plus_one(layout.plane)],
            self.terms,
            [self.flags, self.volumes[1], self.volumes[0], model.appearance.basis.terms if isinstance(model.appearance, Changing) else 0],
        ]


def _pairs(basis: Basis, t: float) -> np.ndarray:
    """(coefficient, weight) [M, 2] of a basis at a time, of those that count; none of a centred one."""
    if basis.centred:
        return np.zeros((0, 2))
    weights = basis.weights(t)
    index = np.flatnonzero(weights)
    return np.stack([index, weights[index]], 1).astype(np.float64)

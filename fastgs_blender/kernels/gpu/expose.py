# SPDX-License-Identifier: GPL-3.0-or-later
"""Exposures (rendering/exposure.py) on a GPU: motion blur and depth of field.

The same samples as the CPU's, in the same tiles (kernels/cpu/expose.py).  A few snapshots of the splats are read back at first, from which
array code finds how many samples each tile needs.  Then the samples are drawn one after the other and added up on the device, on a film
that is read back when it is done.
"""
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NoReturn

import numpy as np

from ...cameras.camera import Camera
from ...rendering.exposure import Exposure, Film
from ...rendering.instances import ViewedInstance
from ...rendering.layout import Exposed, Layout
from ...rendering.quantities import shares
from ..cpu.paths import Paths, Snapshot, levels_of, measure
from ..cpu.project import SCALE
from .blend import How, blend_all
from .device import Array, Device
from .holdout import Occluder
from .lists import grid_of
from .picture import DeviceBuffers, Models, colour
from .scene import Pack
from .shaders import FARTHEST, TILE
from .splats import NOWHERE, Piece, front_to_back, project

LIGHT = 4
"""Numbers of a pixel on the film: red, green, blue, alpha."""


def expose(device: Device, models: Models, exposure: Exposure, instances: list[ViewedInstance], camera: Camera, colours: bool,
           progress: Callable[[float], None], holdout: np.ndarray | None, objects: Sequence[tuple[str, int]], by_pixel: bool) -> Exposed:
    """PictureBackend.expose(); pictures whose film is too large for one buffer are exposed in strips of rows of tiles."""
    x0, y0, width, height = camera.window
    _, top, columns, rows = grid_of(camera.window)
    at_once = rows_at_once(device, width, max(LIGHT, len(objects)))
    taken = Taken(device, models, exposure, instances, camera, holdout, objects, by_pixel)
    strips = []
    for row in range(0, rows, at_once):
        first, last = max(y0, (top + row) * TILE), min(y0 + height, (top + row + at_once) * TILE)
        strip = x0, first, width, last - first
        levels = taken.levels[row * columns:(row + at_once) * columns]
        strips.append(taken.picture(strip, levels, colours, partial(lambda row, f: progress(min((row + f * at_once) / rows, 1.0)), row)))
    rgb, alpha, held, covered = (np.concatenate(parts) for parts in zip(*strips, strict=True))
    return Exposed(rgb if colours else None, alpha, None if holdout is None else held, covered if objects else None)


def rows_at_once(device: Device, width: int, numbers: int) -> int:
    """Rows of tiles of which a film with so many numbers of a pixel has room; raises TooLarge."""
    device.fits(numbers * TILE * width)
    return device.binding // (4 * numbers * TILE * width)


class DeviceFilm:
    """The sums over an exposure's samples, on a device: light [h, w, LIGHT], and columns [h, w, .] of what a holdout stops and of the
    objects' shares."""

    def __init__(self, device: Device, window: tuple[int, int, int, int], held: int, objects: int) -> None:
        x0, y0, width, height = window
        self.window, self.size, self.corner = window, (height, width), [x0 % TILE, y0 % TILE]
        self.light, self.held, self.shares = (device.zeros((*self.size, number)) for number in (LIGHT, held, objects))


class Taken:
    """An exposure of instances on a device: the samples that it takes, and how they are drawn."""

    def __init__(self, device: Device, models: Models, exposure: Exposure, instances: list[ViewedInstance], camera: Camera,
                 holdout: np.ndarray | None, objects: Sequence[tuple[str, int]], by_pixel: bool) -> None:
        self.device, self.models, self.exposure, self.instances, self.camera = device, models, exposure, instances, camera
        self.holdout, self.objects, self.by_pixel = holdout, objects, by_pixel
        self.packs = {id(instance.model): models.packs(instance.model) for instance in instances}
        paths = measure(exposure, instances, camera, self._snapshot)
        self.levels = levels_of(exposure, paths, camera, holdout, grid_of(camera.window))
        self.samples = exposure.samples(int(self.levels.max()))
        self.stretched = stretching(device, paths, len(self.samples) - 1)
        self.encoded = {instance.model.colour_space for instance in instances} == {"srgb"}

    def picture(self, window: tuple[int, int, int, int], levels: np.ndarray, colours: bool,
                progress: Callable[[float], None]) -> tuple[np.ndarray, ...]:
        """Of a part of the window whose film fits on the device, and whose tiles use the samples up to these levels: colour [h, w, 3],
        alpha [h, w], the light that the holdout stops [h, w], and the objects' shares [h, w, K]."""
        film = DeviceFilm(self.device, window, int(self.holdout is not None), len(self.objects))
        for i, sample in enumerate(self.samples):
            weights = np.array(sample.weights, np.float32)[levels]
            if weights.any():
                moved, eye = self.exposure.scene(self.instances, self.camera, sample.time, sample.point)
                triangles = self.exposure.holdout(self.holdout, sample.time)
                self._add(film, moved, eye, self.device.array(weights), triangles, colours and bool(moved))
            progress((i + 1) / len(self.samples))
        values, developed = film.light.numpy(), Film(*film.size, {"srgb"} if self.encoded else set())
        developed.rgb, developed.alpha = np.ascontiguousarray(values[..., :3]), np.ascontiguousarray(values[..., 3])
        return *developed.picture(), film.held.numpy().sum(-1), film.shares.numpy()

    def _add(self, film: DeviceFilm, moved: list[ViewedInstance], eye: Camera, weights: Array, triangles: np.ndarray | None,
             colours: bool) -> None:
        """Draw a sample, and add it to the film, each tile's with its weight."""
        device = self.device
        layout = Layout(moved, False, {"shares": shares(moved, self.objects)} if self.objects else None, self.holdout is not None,
                        self.by_pixel)
        splats = project(device, moved, eye, layout, self._packs(moved), self.stretched)  # as the whole window sees them
        eye = replace(eye, window=film.window)
        occluder = None if triangles is None else Occluder(device, triangles, eye)
        wanted = Array(weights.buffer, weights.shape, np.dtype(np.uint32))  # 0.0 has the bits of 0
        how = How(tiles=wanted, occluder=occluder, by_pixel=self.by_pixel, plane=layout.plane or 0)
        bands = blend_all(device, front_to_back(device, splats), splats, eye, how, lambda share: None)
        buffers = DeviceBuffers.of(bands, layout, how, _nothing_instead)
        rgb = colour(device, buffers, layout, eye, _nothing_instead).parts if colours else [band.flat for band in bands]
        corner, done = [*film.corner, grid_of(eye.window)[2]], 0
        for band, light in zip(bands, rgb, strict=True):
            height, width, numbers = band.flat.shape
            job = [[height * width, done, width, numbers], [*corner, colours + 2 * self.encoded]]
            device.run("film", height * width, job, weights, light, band.flat, film.light)
            sums = [] if occluder is None else [(band.flat, how.places["held"], film.held)]
            sums += [(band.channels, layout.places["shares"].start, film.shares)] if self.objects else []
            for values, first, out in sums:
                job = [[height * width * out.shape[2], done, width, out.shape[2]], [*corner, 0], [first, values.shape[2], 0, 0]]
                device.run("film_sums", height * width * out.shape[2], job, weights, values, out)
            done += height * width

    def _packs(self, moved: list[ViewedInstance]) -> list[list[Pack]]:
        """Each instance's model on the device; those of the picture itself are uploaded once, mixtures of two moments for their sample."""
        return [self.packs[id(instance.model)] if id(instance.model) in self.packs else self.models.packs(instance.model)
                for instance in moved]

    def _snapshot(self, moved: list[ViewedInstance], eye: Camera, total: int) -> Snapshot:
        """The Snapshot of all Gaussians of a scene."""
        look, done, layout, device = Snapshot.nothing(total), 0, Layout(moved, False), self.device
        for instance, packs in zip(moved, self._packs(moved), strict=True):
            for pack in packs:
                splats = project(device, [instance], eye, layout, [[pack]]).pieces[0]
                seen = device.read(splats.depths, np.uint32, pack.count) != NOWHERE
                a, b = (device.read(each, np.float32, 4 * pack.count).reshape(-1, 4)[seen] for each in (splats.a, splats.b))
                at = done + np.flatnonzero(seen)
                look.seen[at], look.mean[at] = True, a[:, :2]
                look.root[at] = np.stack([a[:, 2], a[:, 3], b[:, 0]], 1) / SCALE
                reach = np.sqrt(np.maximum(b[:, 1] - b[:, 3], 0)) / b[:, 0]
                look.size[at] = np.stack([reach * np.hypot(b[:, 0], a[:, 3]) / a[:, 2], reach], 1) + 1e-3
                look.opacity[at] = np.exp2(b[:, 1])
                done += pack.count
        return look


def stretching(device: Device, paths: Paths, steps: int) -> Callable[[Piece], None]:
    """What widens splats where so many steps are not enough."""
    if not steps or not (paths.needed > 1.5 * steps).any():
        return lambda splats: None
    table = np.column_stack([paths.shift, paths.blur, np.minimum(paths.needed, FARTHEST)]).astype(np.float32)
    uploaded: dict[tuple[int, int], Array] = {}

    def widen(splats: Piece) -> None:
        key = splats.first, splats.rows
        if key not in uploaded:
            uploaded[key] = device.array(table[splats.first:splats.first + splats.rows])
        device.run("draw_out", splats.rows, [[splats.rows, 0, 0, 0], [float(steps), 0.0, 0.0, 0.0]], uploaded[key], splats.depths,
                   splats.a, splats.b)

    return widen


def _nothing_instead() -> NoReturn:
    raise AssertionError("the film alone is read")

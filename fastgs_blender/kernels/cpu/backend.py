# SPDX-License-Identifier: GPL-3.0-or-later
"""The CPU backend: numba kernels on all threads, behind the interface of kernels/protocol.py.  Its arrays are NumPy's."""
from __future__ import annotations

import statistics
import time
from functools import reduce

import numpy as np

from ...rendering.layout import Buffers, Layout
from . import carrying, carving, initial, light, nearest, painting, passing, posing, resample, spots, steps, thinnest, training, visible
from .decoder import decode_features, decoder_of
from .expose import expose
from .holdout import surface
from .jit import announce
from .rasterise import rasterise
from .splats import project_instances
from .tile_lists import tiles_of


class CPU:
    """The backend "cpu"; the methods' contracts are those of protocol.TrainingBackend."""

    def array(self, values):
        return np.asarray(values)

    def zeros(self, shape, dtype=np.float32):
        return np.zeros(shape, dtype)

    def numpy(self, array):
        return array

    def read(self, *arrays):
        return list(arrays)

    def begin_step(self):
        return 0

    def end_step(self, *arrays):
        return lambda: list(arrays)

    def picture(self, rgb, stored):
        return rgb

    def draw(self, instances, camera, layout, probes, progress, holdout=None, wanted=None) -> Buffers:
        decode = decoder_of(layout, camera)
        announce("features" if decode else "picture")
        splats = project_instances(instances, camera, layout, lambda f: progress(0.3 * f))
        order, channels, rows = splats.order(), splats.channels, (splats.geometry, splats.attributes)
        del splats  # the rest of which is memory
        picture = rasterise(order, *rows, channels, camera, probes, lambda f: progress(0.35 + 0.6 * f), tiles_of(wanted, camera), holdout,
                            plane=layout.plane, by_pixel=layout.by_pixel, core=layout.core, decode=decode)
        return picture.buffers(layout)

    def expose(self, exposure, instances, camera, colours, progress, holdout=None, objects=(), by_pixel=False):
        announce()
        return expose(exposure, instances, camera, colours, self.colour, progress, holdout, objects, by_pixel)

    def colour(self, buffers, layout, camera):
        return reduce(np.add, (self._group_colour(buffers, group, camera) for group in layout.groups))

    def _group_colour(self, buffers, group, camera):
        if group.instance is None or buffers.channels.shape[2] == 3:
            return buffers.channels[..., group.offset:group.offset + 3]
        weight = buffers.alpha if group.weight is None else buffers.channels[..., group.weight]
        return decode_features(buffers.channels[..., group.offset:group.offset + 9], weight, group.instance, camera, group.decode)

    surface = staticmethod(surface)
    posed, thinnest = staticmethod(posing.posed), staticmethod(thinnest.thinnest)
    view_box = staticmethod(passing.view_box)
    past_splats, past_triangles = staticmethod(passing.past_splats), staticmethod(passing.past_triangles)
    contributing, spread = staticmethod(light.contributing), staticmethod(spots.spread)
    painted = staticmethod(painting.painted)
    front_to_back = staticmethod(visible.front_to_back)

    def forward(self, parameters, template, camera, t, depth=False, band=0.0):
        announce("step")
        return training.forward(parameters, template, camera, t, depth, band)

    compare = staticmethod(training.compare)
    agreement = staticmethod(training.agreement)
    over = staticmethod(training.over)
    backward = staticmethod(training.backward)

    def rows(self, seen, frozen=0):
        return frozen + np.flatnonzero(seen[frozen:])

    def count(self, rows):
        return np.array([len(rows)], np.float64)

    steps_since = staticmethod(steps.steps_since)
    motion_penalty = staticmethod(steps.motion_penalty)
    anchor = staticmethod(steps.anchor)
    mcmc_penalty = staticmethod(steps.mcmc_penalty)
    mcmc_noise = staticmethod(steps.mcmc_noise)
    adam = staticmethod(steps.adam)
    nearest = staticmethod(nearest.nearest)
    light = staticmethod(light.light)
    carve, around = staticmethod(carving.carve), staticmethod(carving.around)
    affine_weights, weighted_sums = staticmethod(carrying.affine_weights), staticmethod(carrying.weighted_sums)
    places, support, smoothed = staticmethod(carrying.places), staticmethod(carrying.support), staticmethod(carrying.smoothed)
    project_points = staticmethod(initial.project_points)
    sweep, vote = staticmethod(initial.sweep), staticmethod(initial.vote)
    resample = staticmethod(resample.resample)

    def measure_stages(self, instance, camera, repeat):
        layout = Layout([instance], depth=False)
        times, splats = timed(
            repeat, lambda: None, lambda: project_instances([instance], camera, layout), lambda splats: splats.order(),
            lambda splats, order: rasterise(order, splats.geometry, splats.attributes, splats.channels, camera))
        return times, 0 if splats is None else len(splats.index)


def timed(repeat: int, wait, project, sort, blend):
    """TrainingBackend.measure_stages() of a backend's three stages, project(), sort(splats) and blend(splats, order), and the splats;
    wait() waits for its device."""
    times: dict[str, list[float]] = {"slice and project": [], "sort": [], "tiles and rasterise": []}
    splats = None
    for _ in range(repeat):
        clock = [time.perf_counter()]

        def done(made, clock=clock):
            wait()
            clock.append(time.perf_counter())
            return made

        splats = done(project())
        order = done(sort(splats))
        done(blend(splats, order))
        for values, span in zip(times.values(), np.diff(clock), strict=True):
            values.append(1000 * span)
    return {name: statistics.median(values) for name, values in times.items()}, splats


BACKEND = CPU()

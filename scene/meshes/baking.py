# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes animated objects into a model of 4D Gaussians, step by step: surfaces, colours and light first, then the fit of their motion."""
import warnings
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ...fastgs_blender.surfaces.bake import bake, followed, surface_colours, surface_samples
from ..background import in_steps, relayed
from ..frame_range import frame_kept, go_to
from . import baked_light
from .material_colour import MaterialColours
from .surface import Recorder, whole_frames_only

PER_FRAME = 2, 4, 8
"""Numbers of times per frame at which surfaces are sampled by default: the next one where one does not suffice to follow the motion."""


def frame_times(first: int, last: int, per_frame: int) -> list[float]:
    """The frames first .. last (both included) and per_frame - 1 evenly spaced sub-frames between any two."""
    return [first + i / per_frame for i in range((last - first) * per_frame + 1)]


@dataclass(frozen=True)
class Stage:
    """A part of the work: what it does in words, and which shares of the whole it lasts from and to."""

    doing: str
    begin: float
    end: float

    def at(self, done: float) -> tuple[float, str]:
        """The share of the whole, and the words, when this share of the stage is done."""
        return self.begin + (self.end - self.begin) * done, self.doing


RECORD, LOOK, AGAIN, LOOK_AGAIN, ONCE_MORE, SPREAD, COLOUR, LIGHT, FIT = (Stage(*values) for values in (
    ("recording the surface", 0.0, 0.2), ("recording the surface", 0.2, 0.21), ("recording fast motion", 0.21, 0.24),
    ("recording fast motion", 0.24, 0.25), ("recording fast motion", 0.25, 0.3),
    ("spreading the Gaussians", 0.3, 0.45), ("reading the colours", 0.45, 0.5), ("measuring the light", 0.5, 0.6),
    ("fitting the motion", 0.6, 1.0)))


def bake_steps(context, objects, options, apart: bool):
    """A generator that bakes objects: it yields (share that is done, what is being done), and returns (model, report, notes).

    options  BakeOptions, or those of bake_options()
    While it runs the scene is on other frames; its frame is restored at the end, also when the generator is closed early or an
    error ends it.  With `apart` the long pieces of work that need no Blender run in a thread.
    Raises FastGSError where the objects cannot be baked.
    """
    scene = context.scene
    with frame_kept(scene):
        recorder = Recorder(context, objects)
        simulated = any(whole_frames_only(obj) for obj in objects)
        first, *more = (1,) if simulated else (options.samples_per_frame,) if options.samples_per_frame else PER_FRAME
        times = frame_times(options.frame_start, options.frame_end, first)
        if simulated:  # a simulation has no frame to which it was not played
            for frame in range(scene.frame_start, options.frame_start):
                go_to(scene, frame)
                yield RECORD.at(0.0)
        yield from _record(recorder, times, RECORD)
        positions, triangles, part = np.stack(recorder.positions), recorder.triangles(), recorder.parts()
        fitting = dict(frame_count=options.frame_end - options.frame_start + 1, tolerance=options.tolerance / 100,
                       tail_tolerance=options.tail_tolerance / 100, max_order=options.max_order, basis=options.basis.lower(), part=part)
        for per_frame, look, again in zip(more, (LOOK, LOOK_AGAIN), (AGAIN, ONCE_MORE), strict=False):
            relative = np.array(times) - options.frame_start
            if (yield from _run(partial(_followed, positions, triangles, relative, fitting), apart, look)):
                break
            known, times = times, frame_times(options.frame_start, options.frame_end, per_frame)
            yield from _record(recorder, sorted(set(times) - set(known)), again)
            recorder.sort()
            positions = np.stack(recorder.positions)
        samples = yield from _run(lambda _: surface_samples(positions, triangles, options.count), apart, SPREAD)
        yield COLOUR.at(0.0)
        materials = MaterialColours(recorder.pieces)
        painted = surface_colours(materials, positions, triangles, samples)
        if options.lighting == 'CYCLES':
            lit = yield from relayed(baked_light.apply(context, recorder, times, painted.rgba, samples, options.light_samples,
                                                       options.light_frames), LIGHT.at)
            painted = replace(painted, rgba=lit)
    patch, fps = recorder.patches(), scene.render.fps / scene.render.fps_base
    provenance = {"objects": ", ".join(obj.name for obj in objects)[:1000]}

    def fit(progress):
        with warnings.catch_warnings():  # what they say stands in the report too, and Blender's user reads that
            warnings.simplefilter("ignore", UserWarning)
            return bake(
                positions, triangles, painted, frames=np.array(times) - options.frame_start, fps=fps,
                start_frame=options.frame_start, count=options.count, patch=patch, samples=samples, provenance=provenance,
                progress=progress, **fitting)

    model, report = yield from _run(fit, apart, FIT)
    return model, replace(report, worst_place=recorder.place(report.worst_triangle)), materials.notes


def _followed(positions, triangles, frames, fitting, progress) -> bool:
    """Whether these samples suffice to follow the motion."""
    return followed(positions, triangles, frames=frames, **fitting)


def _record(recorder, times, stage):
    """Yields progress while the surface is recorded at these times."""
    for number, frame in enumerate(times):
        recorder.record(frame)
        yield stage.at((number + 1) / len(times))


def _run(work, apart, stage):
    """Yields progress while work(progress) runs, apart from Blender where that is wanted, and returns its result."""
    return (yield from relayed(in_steps(work, apart), stage.at))

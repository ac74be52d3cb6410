# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes animated objects into a model of 4D Gaussians, step by step: surfaces, colours and light first, then the fit of their motion."""
from __future__ import annotations

import threading
import warnings
from dataclasses import dataclass

import numpy as np

from ...fastgs_blender.surfaces.bake import bake, surface_colours, surface_samples
from . import baked_light
from .material_colour import MaterialColours
from .surface import Recorder, frame_kept, go_to, whole_frames_only

WAIT = 0.1
"""Seconds between two looks at the thread that works."""


@dataclass(frozen=True)
class Settings:
    """The frames to bake, and how they are sampled and fitted; the defaults are the operator's.

    tolerance  mean distance from the true motion that is allowed, as a share of the objects' size
    max_order  most terms of motion; 0: as many as the number of frames safely carries
    """

    frame_start: int
    frame_end: int
    count: int = 100_000
    tolerance: float = 0.005
    max_order: int = 0
    basis: str = "auto"
    samples_per_frame: int = 2
    lighting: str = 'NONE'
    light_samples: int = 64
    light_frames: int = 8


def frame_times(first: int, last: int, per_frame: int) -> list[float]:
    """The frames first .. last (both included) and per_frame - 1 evenly spaced sub-frames between any two."""
    return [first + i / per_frame for i in range((last - first) * per_frame + 1)]


def bake_steps(context, objects, settings: Settings, in_background: bool):
    """A generator that bakes objects: it yields the share that is done, and returns (model, report, notes).

    While it runs the scene is on other frames; its frame is restored at the end, also when the generator is closed early or an
    error ends it.  With in_background the long pieces of work that need no Blender run in a thread.
    Raises FastGSError where the objects cannot be baked.
    """
    scene = context.scene
    with frame_kept(scene):
        recorder = Recorder(context, objects)
        simulated = any(whole_frames_only(obj) for obj in objects)
        times = frame_times(settings.frame_start, settings.frame_end, 1 if simulated else settings.samples_per_frame)
        if simulated:  # a simulation has no frame to which it was not played
            for frame in range(scene.frame_start, settings.frame_start):
                go_to(scene, frame)
                yield 0.0
        for number, frame in enumerate(times):
            recorder.record(frame)
            yield 0.4 * (number + 1) / len(times)
        positions, triangles = np.stack(recorder.positions), recorder.triangles()
        samples = yield from _run(lambda _: surface_samples(positions, triangles, settings.count), in_background, 0.4, 0.5)
        materials = MaterialColours(recorder.pieces)
        colours = surface_colours(materials, positions, triangles, samples)
        if settings.lighting == 'CYCLES':
            colours = yield from _scaled(
                baked_light.apply(context, recorder, times, colours, samples, settings.light_samples, settings.light_frames), 0.5, 0.6)
    part, patch, fps = recorder.parts(), recorder.patches(), scene.render.fps / scene.render.fps_base
    provenance = {"objects": ", ".join(obj.name for obj in objects)[:1000]}

    def fit(progress):
        with warnings.catch_warnings():  # what they say stands in the report too, and Blender's user reads that
            warnings.simplefilter("ignore", UserWarning)
            return bake(
                positions, triangles, colours, frames=np.array(times) - settings.frame_start,
                frame_count=settings.frame_end - settings.frame_start + 1, fps=fps,
                start_frame=settings.frame_start, count=settings.count, tolerance=settings.tolerance, max_order=settings.max_order,
                basis=settings.basis, part=part, patch=patch, samples=samples, provenance=provenance, progress=progress)

    model, report = yield from _run(fit, in_background, 0.6, 1.0)
    return model, report, materials.notes


def _scaled(steps, begin, end):
    """Yields the shares 0..1 of one part of the work as begin..end of the whole; returns its result."""
    while True:
        try:
            yield begin + (end - begin) * next(steps)
        except StopIteration as stop:
            return stop.value


def _run(work, in_background, begin, end):
    """Yields progress while work(progress) runs, and returns its result; closing the generator cancels the work."""
    if not in_background:
        yield begin
        return work(None)
    state = {"done": 0.0}
    cancelled = threading.Event()

    def progress(fraction):
        state["done"] = fraction
        if cancelled.is_set():
            raise InterruptedError

    def target():
        try:
            state["result"] = work(progress)
        except BaseException as error:
            state["error"] = error

    thread = threading.Thread(target=target, name="FAST-GS bake", daemon=True)
    thread.start()
    try:
        while thread.is_alive():
            thread.join(WAIT)
            yield begin + (end - begin) * state["done"]
    finally:
        cancelled.set()
        thread.join()
    if "error" in state:
        raise state["error"]
    return state["result"]

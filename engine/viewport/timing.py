# SPDX-License-Identifier: GPL-3.0-or-later
"""Times the stages of a viewport's picture on this machine, for reports of problems and for the benchmark.

Nothing that draws for users waits for the GPU; this does, after each stage, to know how long it took.
"""
import statistics
import time
from collections import defaultdict

import gpu
import numpy as np

from ... import fastgs_blender as fg
from ...fastgs_blender.kernels.gl.frame_table import Depths
from ...scene.snapshot import Snapshot
from . import sorting
from .atlas import Atlas
from .picture import Order, Picture

STAGES = ("reading files", "culling and sorting", "models to the GPU", "order to the GPU", "submitting splats", "blending splats",
          "submitting colours", "colours", "reading the depth back")


def measure(snapshot: Snapshot, camera: fg.Camera, runs: int = 5) -> dict[str, float]:
    """Milliseconds of each of STAGES, in the median of some runs; a picture of its own is drawn, with the camera's size."""
    atlas, times = Atlas(), defaultdict(list)
    offscreen = gpu.types.GPUOffScreen(camera.width, camera.height, format='RGBA16F')
    with offscreen.bind():
        framebuffer = gpu.state.active_framebuffer_get()
        for _ in range(runs):
            picture, clock = Picture(), _Clock(times, framebuffer)
            snapshot.load()
            clock.lap("reading files")
            answer = sorting.sort(snapshot, camera, 1.0, atlas)
            clock.lap("culling and sorting")
            atlas.clear()
            atlas.upload([instance.model for instance in answer.instances])
            clock.lap("models to the GPU", finish=True)
            order = Order(answer.order, answer.count)
            clock.lap("order to the GPU", finish=True)
            viewed = [instance.viewed(camera) for instance in answer.instances]
            picture.draw(camera, viewed, atlas, order, deep=True)
            clock.lap("submitting splats")
            clock.lap("blending splats", finish=True)
            picture.resolve(np.eye(3), depths=Depths(0.5, 0.0))
            clock.lap("submitting colours")
            clock.lap("colours", finish=True)
            framebuffer.read_depth(0, 0, camera.width, camera.height)
            clock.lap("reading the depth back")
            picture.free()
    atlas.clear()
    offscreen.free()
    return {stage: statistics.median(times[stage]) for stage in STAGES}


class _Clock:
    """Notes how long each stage takes."""

    def __init__(self, times, framebuffer):
        self.times, self.framebuffer = times, framebuffer
        wait_for_gpu(framebuffer)
        self.began = time.perf_counter()

    def lap(self, stage, finish=False):
        if finish:
            wait_for_gpu(self.framebuffer)
        now = time.perf_counter()
        self.times[stage].append(1e3 * (now - self.began))
        self.began = now


def wait_for_gpu(framebuffer) -> None:
    """Wait until the GPU has finished its work.  Blender offers no other way than to read a pixel back."""
    framebuffer.read_color(0, 0, 1, 1, 4, 0, 'FLOAT')

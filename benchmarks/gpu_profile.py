# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the time of a frame and of a training step goes on a GPU: stage by stage, by its own clock.

    python benchmarks/gpu_profile.py [--device NAME] [--gaussians 300000] [--size 1352x1014] [--runs 9] [--json FILE]

For a 4D frame that stays on the GPU and for a training step, as gpu.py has them:

* each stage       how often it is dispatched, and its milliseconds by the GPU's clock (timestamp queries), the most expensive first
* bytes bound      of all buffers that the dispatches are given; what they read and write is at most that
* GPU busy         the sum of the stages; every dispatch waits for those before it, so that there is a barrier for each
* recording        milliseconds in which Python hands over that work; the GPU runs behind it

The dispatches are timed in passes of their own, so the sum is a little more than the same work takes otherwise (gpu.py).
"""
from __future__ import annotations

import argparse
import json
import statistics
import time
from collections import defaultdict
from itertools import count
from pathlib import Path

import numpy as np
from gpu import frozen
from raster_cpu import scene
from train_step import Step

from fastgs_blender.kernels.gpu.adapters import find
from fastgs_blender.kernels.gpu.backend import GPU
from fastgs_blender.kernels.gpu.device import Array, Device
from fastgs_blender.rendering.instances import Instance
from fastgs_blender.rendering.layout import Layout
from fastgs_blender.util import backends

MOST = 2048
"""Timestamps of one query set: two for each dispatch."""


class Profiled(Device):
    """A device that measures each of its dispatches; stages: of each that has been measured (name, ns), and bytes: those that it bound."""

    def __init__(self, adapter):
        super().__init__(adapter)
        self.measuring, self.begun, self.names, self.stages, self.bytes = False, 0, [], [], 0

    @property
    def native(self):
        if "opened" not in self.__dict__:
            limits = {name: self.adapter.limits[name] for name in ("max-storage-buffer-binding-size", "max-buffer-size")}
            features = [name for name in self.adapter.features if name in ("subgroup", "timestamp-query")]
            self.opened = self.adapter.request_device_sync(required_limits=limits, required_features=features)
            self.queries = self.opened.create_query_set(type="timestamp", count=MOST)
        return self.opened

    def _pipeline(self, stage, constants):
        self.stage = stage
        return super()._pipeline(stage, constants)

    def _dispatch(self, pipeline, parameters, buffers, size):
        if not self.measuring:
            super()._dispatch(pipeline, parameters, buffers, size)
            return
        if 2 * len(self.names) + 2 > MOST:
            self.collect()
        self.bytes += sum((each.buffer if isinstance(each, Array) else each).size for each in buffers)
        first = 2 * len(self.names)
        self._pass = self._commands().begin_compute_pass(timestamp_writes={
            "query_set": self.queries, "beginning_of_pass_write_index": first, "end_of_pass_write_index": first + 1})
        super()._dispatch(pipeline, parameters, buffers, size)
        self.names.append(self.stage)

    def collect(self):
        """Read the clock of what has been measured."""
        import wgpu

        if self.names:
            usage = wgpu.BufferUsage
            resolved = self.native.create_buffer(size=8 * MOST, usage=usage.QUERY_RESOLVE | usage.COPY_SRC)
            self._commands().resolve_query_set(self.queries, 0, 2 * len(self.names), resolved, 0)
            self.submit()
            ticks = np.frombuffer(self.native.queue.read_buffer(resolved, 0, 16 * len(self.names)), np.uint64).reshape(-1, 2)
            self.stages += zip(self.names, (ticks[:, 1] - ticks[:, 0]).tolist())
            self.names = []


def profile(device: Profiled, work, runs: int) -> dict:
    """The figures of one run of work(), from `runs` of them."""
    recording = []
    for _ in range(max(runs, 3)):
        begin = time.perf_counter()
        work()
        recording.append(1e3 * (time.perf_counter() - begin))
        device.wait()
    device.stages, device.bytes, device.measuring = [], 0, True
    for _ in range(runs):
        work()
    device.collect()
    device.measuring = False
    sums, times = defaultdict(float), defaultdict(int)
    for name, ns in device.stages:
        sums[name] += ns / 1e6 / runs
        times[name] += 1
    found = {f"{name} x {times[name] / runs:g}, ms": sums[name] for name in sorted(sums, key=sums.get, reverse=True)}
    return {"GPU busy, ms": sum(sums.values()), "dispatches": len(device.stages) / runs, "bytes bound, MB": device.bytes / runs / 1e6,
            "recording, ms": statistics.median(recording), **found}


def main(given: list[str] | None = None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="", metavar="NAME", help="a part of the adapter's name (default: the best GPU)")
    parser.add_argument("--gaussians", type=int, default=300_000)
    parser.add_argument("--size", default="1352x1014")
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--json", help="write the figures here as well")
    args = parser.parse_args(given)
    width, height = (int(value) for value in args.size.split("x"))
    device = Profiled(find(args.device).native)
    gpu = backends.loaded["gpu:profiled"] = GPU(lambda: device)
    model, camera = scene(args.gaussians, width, height, "features")
    model, times = frozen(model), (0.01 * k % 1 for k in count())

    def frame():
        instances = [Instance(model, np.eye(4), next(times)).viewed(camera)]
        layout = Layout(instances, False)
        return gpu.colour(gpu.draw(instances, camera, layout, (), lambda share: None), layout, camera)

    step = Step(args.gaussians, width, height, "gpu:profiled")
    results = {"frame": profile(device, frame, args.runs), "training step": profile(device, step, args.runs)}
    for title, figures in results.items():
        print(title)
        for label, value in figures.items():
            print(f"    {label:40}{value:14.4f}")
    if args.json:
        Path(args.json).write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()

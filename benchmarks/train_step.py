# SPDX-License-Identifier: GPL-3.0-or-later
"""What a step of training takes on the CPU, from one run.

    python benchmarks/train_step.py [--gaussians 100000] [--size 676x507] [--runs 9] [--json FILE]
    python benchmarks/train_step.py --train CAPTURE [any option of fastgs train]

The first measures one step on a made scene:

* rasterise stage  forward and backward: from sorted splats to blended features with alpha, and from the gradient of those to
                   that of the splats; with what is needed to list the tiles and to add up the splats' shares
* training step    Fourier L = 5, temporal opacity, rotation, features with decoder: slice, project, sort, rasterise, decode,
                   L1 + D-SSIM, all the way back, motion penalty, statistics for density control, Adam

All functions run in turn, so that the ratios hold when the machine's speed drifts; the figures are medians.

The second trains on a capture and prints the processor's minutes by phase: before the first step, each fifth of the steps, density
control, and what comes after. Where kernels are compiled anew, the first fifth has that time too.
"""
from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections import defaultdict, deque
from pathlib import Path

import numpy as np
from raster_cpu import fg, scene, threads, timed

from fastgs_blender import cli
from fastgs_blender.kernels.cpu import decoder, rasterise, splats, training
from fastgs_blender.kernels.cpu.loss import photometric
from fastgs_blender.rendering.instances import Instance
from fastgs_blender.rendering.layout import Layout
from fastgs_blender.training.core.losses import motion_norm
from fastgs_blender.training.core.optimiser import Optimiser
from fastgs_blender.training.core.statistics import Statistics
from fastgs_blender.training.core.trainer import Trainer
from fastgs_blender.training.run import checkpoint, session
from fastgs_blender.training.run.progress import Reporter
from fastgs_blender.util.backends import load_backend

TIME = 0.4
EXTENT = 6.0


class Step:
    """A step of training on a backend, again and again on the same view."""

    def __init__(self, gaussians: int, width: int, height: int, backend: str = "cpu"):
        self.model, self.camera = scene(gaussians, width, height, "features")
        look = self.model.appearance
        arrays = {name: array.copy() for name, array in self.model.arrays.items()}
        self.backend = load_backend(backend)
        self.optimiser = Optimiser({**arrays, "w1": look.w1.copy(), "w2": look.w2.copy()}, backend=self.backend)
        self.rates = dict.fromkeys(self.optimiser.arrays, 1e-5)
        self.rates["motion"] = 1e-5 / np.repeat(np.arange(1.0, 6), 6)
        self.statistics, self.norm = Statistics.empty(self.backend, gaussians), motion_norm(self.model.basis, EXTENT)
        target = fg.render(self.model, self.camera, TIME + 0.01, backend="cpu")["rgb"]
        self.target, self.begun = self.backend.array(np.ascontiguousarray(target, np.float32)), deque()

    def __call__(self):
        backend, arrays, seen = self.backend, self.optimiser.arrays, self.backend.zeros((len(self.model),))
        ahead = backend.begin_step()
        picture = backend.forward(arrays, self.model, self.camera, TIME)
        difference = backend.compare(picture, self.target, None, None, 0.2, 0.0, 1.0)
        gradients = backend.backward(picture, difference.rgb, difference.alpha, statistics=self.statistics,
                                          emphasis=difference.emphasis, seen=seen)
        rows = backend.rows(seen)
        since = self.optimiser.steps_since_update(rows)
        backend.motion_penalty(self.norm, arrays["motion"], gradients["motion"], 0.1, since)
        self.optimiser.step(gradients, rows, self.rates, since)
        self.begun.append(backend.end_step())
        if len(self.begun) > ahead:
            self.begun.popleft()()


class Parts(Step):
    """A step on the processor, and its parts on what it began with."""

    def __init__(self, gaussians: int, width: int, height: int):
        super().__init__(gaussians, width, height)
        self.instance = Instance(self.model, np.eye(4), TIME).viewed(self.camera)
        self.layout = Layout([self.instance], False)
        self.projected = self.project()
        self.order = self.projected.order()
        self.picture, self.state = self.forward()
        numbers = np.random.default_rng(1)
        self.grad = [numbers.normal(0, 1e-6, array.shape).astype(np.float32) for array in (self.picture.channels, self.picture.alpha)]
        self.gradients = {name: numbers.normal(0, 1e-6, array.shape).astype(np.float32) for name, array in self.optimiser.arrays.items()}
        self.gradient = self.backward()

    def project(self):
        return splats.project_instances([self.instance], self.camera, self.layout)

    def forward(self):
        projected = self.projected
        return rasterise.rasterise_forward(self.order, projected.geometry, projected.attributes, projected.channels, self.camera)

    def backward(self):
        return rasterise.rasterise_backward(self.state, *self.grad)

    def decode(self):
        return decoder.decode_features(self.picture.channels, self.picture.alpha, self.instance, self.camera, "normalised")

    def parts(self) -> dict:
        """The parts of a step by name, each a function to time."""
        motion, every, picture = self.optimiser.arrays["motion"], np.ones(len(self.model), np.float32), self.picture
        return {
            "project": self.project, "sort": self.projected.order, "decode": self.decode,
            "loss with gradient": lambda: photometric(self.target, self.picture.channels[..., :3]),
            "decode backward": lambda: decoder.decode_backward(
                picture.channels, picture.alpha, self.instance, self.camera, self.target, "normalised"),
            "project backward": lambda: splats.project_backward(self.instance, self.camera, self.layout, self.projected, self.gradient),
            "statistics": lambda: training.add_view(self.statistics, self.projected, self.gradient, self.camera),
            "motion penalty": lambda: self.backend.motion_penalty(self.norm, motion, self.gradients["motion"], 0.1, every),
            "Adam": lambda: self.optimiser.step(self.gradients, np.sort(self.order), self.rates),
        }


def measure(gaussians: int, width: int, height: int, runs: int) -> dict:
    """The two sections of figures."""
    step = Parts(gaussians, width, height)
    parts = step.parts()
    forward, backward, whole, *rest = timed(step.forward, step.backward, step, *parts.values(), runs=runs)
    middle = statistics.median
    return {
        "rasterise stage": {
            "Gaussians": gaussians, "visible": len(step.order), "tile entries": int(step.state.listing.counts.sum()),
            "threads": threads.thread_count(), "forward ms": middle(forward), "backward ms": middle(backward),
            "backward / forward (at most 3)": middle(b / a for a, b in zip(forward, backward)),
        },
        "training step": {
            **{f"{name} ms": middle(times) for name, times in zip(parts, rest)}, "whole step ms": middle(whole),
            "step / rasterise (at most 1.6)": middle(c / (a + b) for a, b, c in zip(forward, backward, whole)),
        },
    }


class Phases:
    """The processor's seconds of a run by phase; what is called within a phase and is one itself counts there alone."""

    def __init__(self):
        self.seconds: dict[str, float] = defaultdict(float)
        self.stack, self.since = ["reading and checking"], time.process_time()

    def _spent(self):
        now = time.process_time()
        self.seconds[self.stack[-1]] += now - self.since
        self.since = now

    def watch(self, owner, name: str, phase):
        """Count what a function of a module or class takes as a phase; phase(*args) gives its name, if it depends on the arguments."""
        inner = getattr(owner, name)

        def timed_call(*args, **more):
            self._spent()
            self.stack.append(phase(*args) if callable(phase) else phase)
            try:
                return inner(*args, **more)
            finally:
                self._spent()
                self.stack.pop()

        setattr(owner, name, timed_call)

    def ended(self) -> dict[str, float]:
        """Minutes of all phases."""
        self._spent()
        return {name: seconds / 60 for name, seconds in self.seconds.items()}


def fifth(trainer) -> str:
    """The phase of a trainer's next step."""
    begin = 20 * (5 * trainer.iteration // trainer.settings.iterations)
    return f"steps, {begin} to {begin + 20} %"


def train(arguments: list[str]) -> dict[str, float]:
    """Minutes by phase of `fastgs train` with these arguments, and in all."""
    phases = Phases()
    phases.watch(session, "refinement", "refining cameras")
    phases.watch(Reporter, "fill", "decoding")
    phases.watch(session, "start", "starting points")
    phases.watch(Trainer, "advance", fifth)
    phases.watch(Trainer, "_densify", "density control")
    phases.watch(Trainer, "measure", "previews")
    phases.watch(checkpoint, "save", "checkpoints")
    phases.watch(session._Session, "_finish", "writing and measuring")
    with tempfile.TemporaryDirectory() as folder:
        cli.main(["train", *arguments, "--out", folder + "/run"])
    found = phases.ended()
    found |= {"all": sum(found.values())}
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--train", nargs=argparse.REMAINDER, help="fastgs train with these arguments; prints minutes by phase")
    parser.add_argument("--gaussians", type=int, default=100_000)
    parser.add_argument("--size", default="676x507")
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--json", help="write the figures here as well")
    args = parser.parse_args()
    width, height = (int(v) for v in args.size.split("x"))
    results = ({"minutes of processor": train(args.train)} if args.train
               else measure(args.gaussians, width, height, args.runs))
    for title, figures in results.items():
        print(title)
        for name, value in figures.items():
            print(f"    {name:34}{value:12.3f}" if isinstance(value, float) else f"    {name:34}{value:12}")
    if args.json:
        Path(args.json).write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()

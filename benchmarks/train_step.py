# SPDX-License-Identifier: GPL-3.0-or-later
"""What a step of training takes on the CPU, from one run.

    python benchmarks/train_step.py [--gaussians 100000] [--size 676x507] [--runs 9] [--json FILE]

* rasterise stage  forward and backward: from sorted splats to blended features with alpha, and from the gradient of those to
                   that of the splats; with what is needed to list the tiles and to add up the splats' shares
* training step    Fourier L = 5, temporal opacity, rotation, features with decoder: slice, project, sort, rasterise, decode,
                   L1 + D-SSIM, all the way back, motion penalty, statistics for density control, Adam

All functions run in turn, so that the ratios hold when the machine's speed drifts; the figures are medians.
"""
from __future__ import annotations

import argparse
import json
import statistics
from pathlib import Path

import numpy as np
import torch
from raster_cpu import fg, scene, threads, timed

from fastgs_blender.kernels.cpu import backend as cpu
from fastgs_blender.kernels.cpu.loss import photometric as compare
from fastgs_blender.rendering.instances import Instance
from fastgs_blender.rendering.layout import Layout
from fastgs_blender.training.core.differentiable import Statistics, render
from fastgs_blender.training.core.losses import MotionPenalty, photometric
from fastgs_blender.training.core.optimiser import Optimiser

TIME = 0.4
EXTENT = 6.0


class Step:
    """A step of training, again and again on the same view, and its parts on what it began with."""

    def __init__(self, gaussians: int, width: int, height: int):
        self.model, self.camera = scene(gaussians, width, height, "features")
        look = self.model.appearance
        arrays = {name: array.copy() for name, array in self.model.arrays.items()}
        self.optimiser = Optimiser({**arrays, "w1": look.w1.copy(), "w2": look.w2.copy()})
        self.rates = dict.fromkeys(self.optimiser.arrays, 1e-5)
        self.rates["motion"] = 1e-5 / np.repeat(np.arange(1.0, 6), 6)
        self.statistics, self.penalty = Statistics(gaussians), MotionPenalty(self.model.basis, EXTENT)
        target = fg.render(self.model, self.camera, TIME + 0.01, backend="cpu")["rgb"]
        self.target = np.ascontiguousarray(target, np.float32)
        self.part = Instance(self.model, np.eye(4), TIME).viewed(self.camera)
        self.layout = Layout([self.part], False)
        self.cloud = self.project()
        self.order = self.cloud.order()
        self.buffers, self.drawn = self.forward()
        numbers = np.random.default_rng(1)
        self.grad = [numbers.normal(0, 1e-6, array.shape).astype(np.float32) for array in (self.buffers.channels, self.buffers.alpha)]
        self.gradients = {name: numbers.normal(0, 1e-6, array.shape).astype(np.float32) for name, array in self.optimiser.arrays.items()}
        self.splats = self.backward()

    def __call__(self):
        tensors = {name: torch.from_numpy(array).requires_grad_() for name, array in self.optimiser.arrays.items()}
        picture = render(tensors, self.model, self.camera, TIME, statistics=self.statistics)
        loss, _, _ = photometric(picture.rgb, self.target)
        loss.backward()
        gradients = {name: tensor.grad.numpy() for name, tensor in tensors.items()}
        rows = np.sort(picture.seen)
        times = np.zeros(len(self.model), np.float32)
        times[rows] = self.optimiser.waited(rows)
        self.penalty.add(self.optimiser.arrays["motion"], gradients["motion"], 0.1, times)
        self.optimiser.step(gradients, rows, self.rates)

    def project(self):
        return cpu.project_parts([self.part], self.camera, self.layout)

    def forward(self):
        return cpu.rasterise_forward(self.order, self.cloud.geometry, self.cloud.shade, self.cloud.channels, self.camera)

    def backward(self):
        return cpu.rasterise_backward(self.drawn, *self.grad)

    def decode(self):
        return cpu.decode_features(self.buffers.channels, self.buffers.alpha, self.part, self.camera)

    def parts(self) -> dict:
        """The parts of a step by name, each a function to time."""
        motion = self.optimiser.arrays["motion"]
        return {
            "project": self.project, "sort": self.cloud.order, "decode": self.decode,
            "loss with gradient": lambda: compare(self.target, self.buffers.channels[..., :3]),
            "decode backward": lambda: cpu.decode_backward(self.buffers.channels, self.buffers.alpha, self.part, self.camera, self.target),
            "project backward": lambda: cpu.project_backward(self.part, self.camera, self.layout, self.cloud, self.splats),
            "statistics": lambda: self.statistics.observe(self.cloud, self.splats, self.camera),
            "motion penalty": lambda: self.penalty.add(motion, self.gradients["motion"], 0.1),
            "Adam": lambda: self.optimiser.step(self.gradients, np.sort(self.order), self.rates),
        }


def measure(gaussians: int, width: int, height: int, runs: int) -> dict:
    """The two sections of figures."""
    step = Step(gaussians, width, height)
    parts = step.parts()
    forward, backward, whole, *rest = timed(step.forward, step.backward, step, *parts.values(), runs=runs)
    middle = statistics.median
    return {
        "rasterise stage": {
            "Gaussians": gaussians, "visible": len(step.order), "tile entries": int(step.drawn.listing.counts.sum()),
            "threads": threads.thread_count(), "forward ms": middle(forward), "backward ms": middle(backward),
            "backward / forward (at most 3)": middle(b / a for a, b in zip(forward, backward)),
        },
        "training step": {
            **{f"{name} ms": middle(times) for name, times in zip(parts, rest)}, "whole step ms": middle(whole),
            "step / rasterise (at most 1.6)": middle(c / (a + b) for a, b, c in zip(forward, backward, whole)),
        },
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gaussians", type=int, default=100_000)
    parser.add_argument("--size", default="676x507")
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--json", help="write the figures here as well")
    args = parser.parse_args()
    width, height = (int(v) for v in args.size.split("x"))
    results = measure(args.gaussians, width, height, args.runs)
    for title, figures in results.items():
        print(title)
        for name, value in figures.items():
            print(f"    {name:34}{value:12.3f}" if isinstance(value, float) else f"    {name:34}{value:12}")
    if args.json:
        Path(args.json).write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()

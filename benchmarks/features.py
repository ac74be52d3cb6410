# SPDX-License-Identifier: GPL-3.0-or-later
"""What features cost: the processor time of a frame with each, divided by that of the plain frame; both in turn, in one run.

    python benchmarks/features.py [--gaussians 60000] [--size 960x540] [--runs 3]

A motion-blurred frame of 32 steps must not cost more than 0.6 x 32 plain frames, depth of field of 64 lens samples no more than
0.7 x 64: the last column says how much of that they need.  Everything in the scene moves, and most of it lies outside the focus.
"""
from __future__ import annotations

import argparse
import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

from raster_cpu import scene  # noqa: E402

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.rendering.exposure import Aperture, Exposure  # noqa: E402
from fastgs_blender.rendering.passes import PASSES  # noqa: E402


def features() -> dict[str, tuple[dict, float | None]]:
    """By name: the options of render(), and how many plain frames may pass for one with the feature (None: no bound)."""
    found = {f"pass {name}": ({"passes": ("rgb", "alpha", name)}, None) for name, entry in PASSES.items()
             if name not in ("rgb", "alpha") and not entry.level}
    found["all passes"] = {"passes": tuple(PASSES)}, None
    found["motion blur, 32 steps"] = {"exposure": Exposure(-0.25, 0.25, steps=32)}, 0.6 * 32
    found["depth of field, 64 samples"] = {"exposure": Exposure(aperture=Aperture(0.02, 5.0, samples=64))}, 0.7 * 64
    return found


def cost(model, camera, options: dict, runs: int) -> float:
    """Processor time of a frame with these options by that of a plain one: the median of the ratios of neighbouring runs."""
    def spent(**given):
        begin = time.process_time()
        fg.render(model, camera, 0.4, **given)
        return time.process_time() - begin

    spent(**options)
    return statistics.median(spent(**options) / np.mean([spent(), spent()]) for _ in range(runs))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gaussians", type=int, default=60_000)
    parser.add_argument("--size", default="960x540")
    parser.add_argument("--runs", type=int, default=3)
    args = parser.parse_args()
    width, height = (int(side) for side in args.size.split("x"))
    model, camera = scene(args.gaussians, width, height)
    model = replace(model, clip=fg.Clip(60))
    fg.render(model, camera, 0.4)
    print(f"{args.gaussians:,} Gaussians, {width} x {height}: cost in plain frames")
    for name, (options, bound) in features().items():
        ratio = cost(model, camera, options, args.runs)
        print(f"{name:32} {ratio:6.2f}" + (f"   {ratio / bound:.0%} of what it may cost" if bound else ""), flush=True)


if __name__ == "__main__":
    main()

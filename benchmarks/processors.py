# SPDX-License-Identifier: GPL-3.0-or-later
"""What more processors bring: frames and a training step on one, and what they would take on several, from one run.

    python benchmarks/processors.py [--processors 2,8,16] [--runs 5] [--detail]

All pieces of work are done one after the other, in one thread, and timed.  Then they are dealt to so many imagined processors, each to
the one that is free first; what is not cut into pieces takes as long as before.  So this is what the program's structure allows.  Waking
threads, memory that processors share and Python's lock are not in it.

--detail: for the most processors, which calls take how long, all their pieces together and dealt out
"""
from __future__ import annotations

import argparse
import heapq
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

from fastgs_blender.util import threads  # noqa: E402


class Dealt:
    """Stands in for threads.run(): works in one thread, and knows how much shorter that would be on `processors`."""

    def __init__(self) -> None:
        self.processors, self.busy, self.saved = 1, False, 0.0
        self.calls: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0])

    def run(self, work: Callable, pieces, progress=None) -> list:
        pieces = list(pieces)
        if self.busy or len(pieces) < 2:
            return [work(*piece) for piece in pieces]
        found, times, before, begun = [], [], self.saved, time.perf_counter()
        self.busy = len(pieces) >= self.processors
        try:
            for piece in pieces:
                self.saved, start = 0.0, time.perf_counter()
                found.append(work(*piece))
                times.append(time.perf_counter() - start - self.saved)
        finally:
            self.busy = False
        free = [0.0] * self.processors
        for each in times:
            heapq.heapreplace(free, free[0] + each)
        spent = time.perf_counter() - begun
        self.saved = before + spent - max(free)
        caller = sys._getframe(1).f_code
        call = self.calls[f"{Path(caller.co_filename).stem}.{caller.co_name}"]
        call[0], call[1] = call[0] + spent, call[1] + max(free)
        return found

    def beside(self, work: Callable, other: Callable) -> tuple:
        """Stands in for threads.beside()."""
        first, second = self.run(lambda call: call(), [(work,), (other,)])
        return first, second


DEALT = Dealt()
threads.run, threads.beside, threads.thread_count = DEALT.run, DEALT.beside, lambda: DEALT.processors

import scene_light as lit  # noqa: E402  (all that follow take run() from threads)
import train_step  # noqa: E402
from raster_cpu import scene  # noqa: E402

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.rendering.instances import Instance  # noqa: E402
from fastgs_blender.rendering.lamps import Lamp  # noqa: E402
from fastgs_blender.rendering.passes import PassSettings  # noqa: E402
from fastgs_blender.rendering.relight import SceneLight  # noqa: E402
from fastgs_blender.rendering.shadow import Light  # noqa: E402

PASSES = ("rgb", "alpha", "depth", "normal", "vector", "position", "median_depth", "cryptomatte_00")


def cases() -> dict[str, Callable[[], object]]:
    """What is measured."""
    cloud, window = scene(300_000, 1352, 1014)
    model, camera, meshes, middle, up, towards = lit.example(960, 540)
    sun, above = Lamp(Light.sun(towards, samples=1), np.full(3, 3.0)), lit.area(middle, up, 8.0)

    def under(lamp: Lamp) -> Callable[[], object]:
        light = PassSettings(light=SceneLight((lamp,), meshes))
        return lambda: fg.render([Instance(model, np.eye(4), lit.T, lit.LIT)], camera, settings=light)

    return {
        "a frame of 300 000 Gaussians": lambda: fg.render(cloud, window, 0.4, backend="cpu"),
        "a frame of the example": lambda: fg.render(model, camera, lit.T, backend="cpu"),
        "the same, eight passes": lambda: fg.render(model, camera, lit.T, PASSES, backend="cpu"),
        "the same, motion blur of 32 steps": lambda: fg.render(model, camera, lit.T, exposure=fg.Exposure(-0.5, 0.5), backend="cpu"),
        "the same, depth of field of 64 samples": lambda: fg.render(
            model, camera, lit.T, exposure=fg.Exposure(aperture=fg.Aperture(0.05, 3.0, samples=64)), backend="cpu"),
        "the same, lit by a sun": under(sun), "the same, lit by an area lamp of 16 samples": under(above),
        "a training step, 100 000 Gaussians, 676 x 507": train_step.Step(100_000, 676, 507),
        "a training step, 20 000 Gaussians, 400 x 300": train_step.Step(20_000, 400, 300),
    }


def measure(work: Callable[[], object], processors: int, runs: int) -> tuple[float, float, dict[str, list[float]]]:
    """Seconds of the quickest run in one thread, dealt to so many processors, and the calls with pieces."""
    DEALT.processors, found = processors, []
    for run in range(runs + 1):
        DEALT.saved, begun = 0.0, time.perf_counter()
        DEALT.calls.clear()
        work()
        spent = time.perf_counter() - begun
        if run:
            found.append((spent - DEALT.saved, spent, dict(DEALT.calls)))
    dealt, whole, calls = min(found, key=lambda each: each[0])
    return whole, dealt, calls


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--processors", default="2,8,16")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--detail", action="store_true")
    args = parser.parse_args()
    counts = [int(each) for each in args.processors.split(",")]
    print(f"{'milliseconds on processors':48}" + "".join(f"{count:10}" for count in (1, *counts)))
    for name, work in cases().items():
        times = [measure(work, count, args.runs) for count in counts]
        print(f"{name:48}" + "".join(f"{1e3 * each:10.1f}" for each in (min(whole for whole, _, _ in times), *(each[1] for each in times))),
              flush=True)
        if args.detail:
            for call, (spent, dealt) in sorted(times[-1][2].items(), key=lambda each: -each[1][1]):
                print(f"    {call:44}{1e3 * spent:10.1f}{1e3 * dealt:10.1f}")


if __name__ == "__main__":
    main()

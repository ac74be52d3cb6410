# SPDX-License-Identifier: GPL-3.0-or-later
"""Loading a large model: python benchmarks/loading.py [--gaussians 1000000] [--repeat 5]

Random Gaussians of the paper's kind (Fourier motion of order 5, 59 numbers each) in our own file and compressed, and static ones with
spherical harmonics of degree 3 in INRIA's PLY.  Each is read once before it is timed, so that the disk counts for nothing; what a file
takes is compared with reading its bytes into memory (Path.read_bytes).  The best of the repetitions counts.

On a machine that has other work too, seconds of the clock say little: the seconds of its processors that the process takes, all cores
together, stand beside them.  A file that takes less than a second of one core takes less than a second on two.
"""
from __future__ import annotations

import argparse
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "library")]

from random_models import random_model  # noqa: E402

import fastgs_blender as fg  # noqa: E402


def main() -> None:
    """Prints the table."""
    warnings.simplefilter("ignore", fg.LossWarning)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gaussians", type=int, default=1_000_000)
    parser.add_argument("--repeat", type=int, default=5)
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        own, ply, small = (Path(folder) / name for name in ("own.safetensors", "inria.ply", "compressed.safetensors"))
        moving = random_model(rng, arguments.gaussians, "paper", "line", "radial", "sigmoid", extent=5.0)
        fg.save(moving, own)
        fg.save(random_model(rng, arguments.gaussians, appearance="sh3", extent=5.0), ply)
        fg.save(moving, small, compress="fine")
        del moving
        print(f"{arguments.gaussians:,} Gaussians{'':12} {'MB':>7} {'bytes':>8} {'load':>8} {'ratio':>6}   processors: bytes, load, ratio")
        for path, what, bound in ((own, "our own file", "1.3 x"), (ply, "INRIA PLY", "3 x"), (small, "compressed", "1 s")):
            (plain, own_plain), (whole, own_whole) = (best(work, arguments.repeat) for work in (path.read_bytes, partial(fg.load, path)))
            print(f"{what:30} {path.stat().st_size / 1e6:7.1f} {plain:7.3f}s {whole:7.3f}s {whole / plain:6.2f}   "
                  f"{own_plain:.3f}s {own_whole:.3f}s {own_whole / own_plain:.2f}  (bound {bound})")


def best(work: Callable[[], object], repeat: int) -> tuple[float, float]:
    """Seconds of the clock and of the processors, each the least of so many runs."""
    found = []
    for _ in range(repeat):
        start = time.perf_counter(), time.process_time()
        work()
        found.append((time.perf_counter() - start[0], time.process_time() - start[1]))
    clock, processors = zip(*found, strict=True)
    return min(clock), min(processors)


if __name__ == "__main__":
    main()

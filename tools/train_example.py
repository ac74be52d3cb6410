# SPDX-License-Identifier: GPL-3.0-or-later
"""The model in examples/: a procedural scene rendered with Cycles from 14 cameras, and trained on these pictures.

    python tools/train_example.py [--work build/example]

Takes about a quarter of an hour on two cores; files that exist already are kept.
"""
from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.formats.rate import HELD_OUT  # noqa: E402

MODEL = ROOT / "examples" / "playground.safetensors"
VIEW = ROOT / "examples" / "cameras.json", "orbit04"
"""How the example is looked at first: a camera of a file."""
LARGEST = 6_000_000
"""Bytes."""
GAUSSIANS, POINTS = 22_000, 9_000
"""At most, and of them to begin with."""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "example", help="where the pictures and the run go")
    work = parser.parse_args().work.resolve()
    capture, run = work / "capture", work / "run"
    steps = [[ROOT / "benchmarks" / "make_capture.py", "--scene", "procedural", "--out", capture],
             ["-m", "fastgs_blender", "train", capture, "--out", run, "--max-gaussians", GAUSSIANS, "--set", f"points={POINTS}",
              "--motion", "fourier+linear", "--resume"],  # things spin and fly
             ["-m", "fastgs_blender", "annotate", run / "model.safetensors", "--view", *VIEW]]
    for step in steps:
        subprocess.run([sys.executable, *map(str, step)], check=True, cwd=ROOT)
    made = run / "model.safetensors"
    model = fg.load(made)
    truth = fg.evaluate(model, fg.open_capture(capture), lpips=False)["average"]["psnr"]  # compressing wants to know it
    fg.save(replace(model, provenance=model.provenance | {HELD_OUT: f"{truth:.2f}"}), made)
    if made.stat().st_size > LARGEST:
        sys.exit(f"{made} has {made.stat().st_size} bytes, more than {LARGEST}: it does not ship.")
    MODEL.parent.mkdir(exist_ok=True)
    shutil.copyfile(made, MODEL)
    print(f"{MODEL}: {made.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()

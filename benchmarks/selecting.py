# SPDX-License-Identifier: GPL-3.0-or-later
"""Grow to the Thing on scenes whose truth is known: intersection over union in other views and frames, and seconds.

    python benchmarks/selecting.py [--count 20000] [--scene walker] [--run MODEL.safetensors]

A stroke over the thing and one over what is not it are drawn on one frame of one view; the masks of what is found and of the truth are
compared in views and on frames without strokes.  --run takes a model that was trained on pictures of the scene, instead of the bake.
"""
from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "library")]

import touching_scenes as scenes  # noqa: E402

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.selecting.grow import grow  # noqa: E402
from fastgs_blender.selecting.joins import joins  # noqa: E402
from fastgs_blender.selecting.shapes import Lasso, seen_surface, under  # noqa: E402


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--scene", choices=scenes.SCENES)
    parser.add_argument("--run", type=Path)
    options = parser.parse_args()
    for name in [options.scene] if options.scene else scenes.SCENES:
        scene = scenes.made(name, options.count)
        model = fg.load(options.run) if options.run else scene.model
        for against in (True, False):
            seconds, found = timed(model, scene, against)
            overlaps = scenes.overlaps(model, found, scene)
            print(f"{name:14} {'two strokes' if against else 'one stroke ':11}  IoU {np.mean(overlaps):.3f}, least {np.min(overlaps):.3f}"
                  f"   {len(model)} Gaussians, joins {seconds[0]:.2f} s, growing {seconds[1]:.2f} s of processor", flush=True)
    lasso(model)


def timed(model, scene, against):
    """((seconds of processor of the joins, of growing), what is found)."""
    yes, no = scenes.strokes(model, scene)
    start = time.process_time()
    joins(model)
    middle = time.process_time()
    found = grow(model, yes, no if against else None)
    return (middle - start, time.process_time() - middle), found


def lasso(model, count: int = 300_000):
    """Prints the seconds of processor of a lasso among `count` Gaussians."""
    many = model.take(np.arange(count) % len(model))
    camera, angles = scenes.cameras()[0], np.linspace(0, 2 * np.pi, 200)
    instance = fg.Instance(many, np.eye(4), 0.4)
    line = Lasso(tuple((120 + 60 * np.cos(a), 90 + 50 * np.sin(a)) for a in angles))
    for about in ("compiling", "surface", "through", "visible"):
        start = time.process_time()
        if about in ("compiling", "surface"):
            surface = seen_surface([instance], camera)
        if about != "surface":
            under(instance.viewed(camera), camera, line, None if about == "through" else surface)
        print(f"lasso among {count}: {about} {time.process_time() - start:.3f} s of processor")


if __name__ == "__main__":
    main()

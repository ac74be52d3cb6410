# SPDX-License-Identifier: GPL-3.0-or-later
"""What Scene Light costs: the processor time that lamps and shadows add to a frame, divided by that of the plain frame; both in turn.

    python benchmarks/scene_light.py [--gaussians 60000] [--size 960x540] [--runs 3] [--example]

Splats and a mesh of 3600 triangles throw shadows.  A sun may cost 3 plain frames, and an area lamp of 16 samples 12: the last column says
how much of that they take.  The area lamp stands above everything, and then in the middle, where it shines to all sides.

--example: the example's dancer beside a ball of 9216 triangles, in place of a cloud.
"""
from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

from features import T, cost, faces, sheet  # noqa: E402
from raster_cpu import scene  # noqa: E402

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.cameras.poses import look_at  # noqa: E402
from fastgs_blender.rendering.instances import Instance, ObjectSettings  # noqa: E402
from fastgs_blender.rendering.lamps import Lamp, flat  # noqa: E402
from fastgs_blender.rendering.passes import PassSettings  # noqa: E402
from fastgs_blender.rendering.relight import SceneLight  # noqa: E402
from fastgs_blender.rendering.shadow import Light  # noqa: E402
from fastgs_blender.rendering.ways import across  # noqa: E402

LIT = ObjectSettings(captured_light=0.2, lamp_light=1.0, shadows=1.0)


def area(middle: np.ndarray, up: np.ndarray, height: float) -> Lamp:
    """An area lamp of 16 points so far above the middle of the scene, which shines downwards."""
    x, y = across(up)
    return Lamp(Light.rectangle(middle + height * up, 0.5 * x, 0.5 * y, 16), np.full(3, 10 * height**2), -up, flat())


def cloud(count: int, width: int, height: int):
    """(model, camera, meshes, middle, up, towards a sun) of the cloud."""
    model, camera = scene(count, width, height)
    middle, up = np.array([0, 0, 6.0]), np.array([0, -1.0, 0])
    return replace(model, clip=fg.Clip(60)), camera, sheet(60, 30) + np.float32([0, -2, 0]), middle, up, (0.5, -1, -0.3)


def example(width: int, height: int):
    """The same of the example, seen as in docs/meshes.webp."""
    model, eye, target = fg.load(ROOT / "examples" / "fireside.safetensors"), np.array([0.75, -3.0, 1.5]), np.array([0.1, 0.0, 0.78])
    pose, pixels = look_at(eye, target), 27 / 36 * width
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 97), np.linspace(0, np.pi, 49))
    ball = 0.3 * np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], -1) + (0.52, -0.71, 0.3)
    camera = fg.Camera(width, height, pixels, pixels, width / 2, height / 2, pose)
    return model, camera, faces(ball), np.array([0, 0, 0.9]), np.array([0, 0, 1.0]), (-2.4, -4.0, 2.6)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gaussians", type=int, default=60_000)
    parser.add_argument("--size", default="960x540")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--example", action="store_true")
    args = parser.parse_args()
    width, height = (int(side) for side in args.size.split("x"))
    model, camera, meshes, middle, up, towards = example(width, height) if args.example else cloud(args.gaussians, width, height)
    sun = Light.sun(towards, samples=1)
    lamps = {"a sun": (Lamp(sun, np.full(3, 3.0)), 3), "an area lamp of 16 samples, above": (area(middle, up, 8.0), 12),
             "an area lamp of 16 samples, in the middle": (area(middle, up, 1.0), None)}
    fg.render(model, camera, T)
    print(f"{len(model):,} Gaussians, {width} x {height}: what light adds, in plain frames")
    lit = [Instance(model, np.eye(4), T, LIT)]
    found = {name: ({"model": lit, "settings": PassSettings(light=SceneLight((lamp,), meshes))}, most)
             for name, (lamp, most) in lamps.items()}
    found["lamps in the scene that light no object"] = {"settings": PassSettings(light=SceneLight((Lamp(sun, np.ones(3)),)))}, None
    for name, (options, most) in found.items():
        added = cost(model, camera, options, args.runs) - 1
        print(f"{name:44} {added:6.2f}" + (f"   {added / most:.0%} of what it may cost" if most else ""), flush=True)


if __name__ == "__main__":
    main()

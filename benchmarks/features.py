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
T = 0.4
"""The time that is shown."""
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

from raster_cpu import scene  # noqa: E402

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.cameras.panorama import Panorama  # noqa: E402
from fastgs_blender.cameras.viewpoints import viewpoint_of  # noqa: E402
from fastgs_blender.model.surroundings import Surroundings  # noqa: E402
from fastgs_blender.rendering.crops import Crop  # noqa: E402
from fastgs_blender.rendering.exposure import Aperture, Exposure  # noqa: E402
from fastgs_blender.rendering.filters import Filter  # noqa: E402
from fastgs_blender.rendering.instances import Instance, ObjectSettings  # noqa: E402
from fastgs_blender.rendering.masks import pack_mask  # noqa: E402
from fastgs_blender.rendering.passes import PASSES, PassSettings  # noqa: E402
from fastgs_blender.rendering.shadow import Light, Shadow  # noqa: E402


def sheet(columns: int = 80, rows: int = 45) -> np.ndarray:
    """The triangles of a wavy sheet in the middle of the scene, before a half of the picture."""
    u, v = np.meshgrid(np.linspace(-1, 1, columns + 1), np.linspace(-1, 1, rows + 1))
    return faces(np.stack([2.4 * u, 1.3 * v, 6 + 0.4 * np.sin(7 * u) * np.cos(5 * v)], -1))


def faces(points: np.ndarray) -> np.ndarray:
    """The triangles [F, 3, 3] of a grid of points [rows, columns, 3]."""
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, :-1], points[1:, 1:]
    return np.concatenate([np.stack(corners, 2).reshape(-1, 3, 3) for corners in ((a, b, c), (b, d, c))]).astype(np.float32)


def features(model, camera) -> dict[str, tuple[dict, float | None]]:
    """By name: the options of render(), and how many plain frames may pass for one with the feature (None: no bound)."""
    found = {f"pass {name}": ({"passes": ("rgb", "alpha", name)}, None) for name, entry in PASSES.items()
             if name not in ("rgb", "alpha") and not entry.level}
    found["all passes"] = {"passes": tuple(PASSES)}, None
    shadow = Shadow(Light.sun((0.3, -0.8, -0.5), 0.05, samples=16), sheet())
    found["holdout of 7200 triangles"] = {"holdout": sheet()}, None
    found["splat shadow, a sun of 16 samples"] = {"passes": ("rgb", "alpha", "shadow"), "settings": PassSettings(shadows=(shadow,))}, None
    found["motion blur, 32 steps"] = {"exposure": Exposure(-0.25, 0.25, steps=32)}, 0.6 * 32
    found["the same with Cryptomatte"] = {"passes": ("rgb", "alpha", "cryptomatte_00"), "exposure": Exposure(-0.25, 0.25, steps=32)}, None
    found["depth of field, 64 samples"] = {"exposure": Exposure(aperture=Aperture(0.02, 5.0, samples=64))}, 0.7 * 64
    found["sorting by pixel"] = {"settings": PassSettings(sorting="pixel")}, None
    sharper = viewpoint_of(replace(camera, fx=4 * camera.fx, fy=4 * camera.fy))
    found["far view, antialiased"] = {"model": replace(model, surroundings=Surroundings(cameras=(sharper,)))}, None
    found |= {name: ({"model": instances}, None) for name, instances in objects(model).items()}
    found["equirectangular panorama"] = {"camera": Panorama(camera.width, camera.height, camera.world_to_camera)}, None
    return found


def objects(model) -> dict[str, list[Instance]]:
    """By name: the model as objects show it.  None of these hides anything, so that the picture itself costs what it did."""
    def shown(t: float = T, **settings) -> Instance:
        return Instance(model, np.eye(4), t, ObjectSettings(**settings))

    hidden = np.zeros(len(model), bool)
    hidden[0] = True
    everywhere = np.diag([1e-6, 1e-6, 1e-6, 1])
    return {
        "a look": [shown(exposure=0.1, gamma=1.1, saturation=0.9, hue=0.1, tint=(1, 0.9, 0.9), splat_scale=0.99)],
        "a crop with a soft edge": [shown(crops=[Crop(everywhere, shape="SPHERE", soft=0.1)])],
        "a filter by speed": [shown(filters=[Filter("SPEED", 1e9)])],
        "a mask of the brush": [shown(mask=pack_mask(hidden))],
        "four objects": [shown(), *(Instance(model, np.diag([s, s, s, 1]), T) for s in (1.1, 1.2, 1.3))],
        "three echoes": [shown(), *(shown(T - 0.02 * k, opacity=0.5**k) for k in (1, 2, 3))],
    }


def cost(model, camera, options: dict, runs: int) -> float:
    """Processor time of a frame with these options by that of a plain one: the median of the ratios of neighbouring runs."""
    def spent(**given):
        begin = time.process_time()
        fg.render(**{"model": model, "camera": camera, "t": T} | given)
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
    fg.render(model, camera, T)
    print(f"{args.gaussians:,} Gaussians, {width} x {height}: cost in plain frames")
    for name, (options, bound) in features(model, camera).items():
        ratio = cost(model, camera, options, args.runs)
        print(f"{name:34} {ratio:6.2f}" + (f"   {ratio / bound:.0%} of what it may cost" if bound else ""), flush=True)


if __name__ == "__main__":
    main()

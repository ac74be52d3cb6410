# SPDX-License-Identifier: GPL-3.0-or-later
"""The model in examples/: a scene of our own (benchmarks/fireside_scene.py), filmed by Capture This Scene, trained and compressed.

    python tools/train_example.py [--work build/example]

Takes about an hour and a half on two cores; pictures that are there already are kept, and training goes on where it was.
"""
from __future__ import annotations

import argparse
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from blender_setup import ROOT, enable_addon

sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.cameras.cameras_json import View, save_cameras  # noqa: E402
from fastgs_blender.cameras.poses import look_at  # noqa: E402
from fastgs_blender.formats.rate import HELD_OUT  # noqa: E402

MODEL = ROOT / "examples" / "fireside.safetensors"
VIEWS, FRONT = ROOT / "examples" / "cameras.json", "orbit04"
"""Cameras that the example can be looked at with, and the one that an import begins with."""
LARGEST = 8_000_000
"""Bytes."""
GAUSSIANS, STEPS = 160_000, 5_000


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "example", help="where the pictures and the run go")
    work = parser.parse_args().work.resolve()
    capture, run = work / "capture", work / "run"
    film(capture)
    command = [sys.executable, "-m", "fastgs_blender", "train", capture, "--out", run, "--resume", "--basis", "paper",
               "--iterations", STEPS, "--max-gaussians", GAUSSIANS, "--set", "warm_up=0.05,0.5"]
    subprocess.run([*map(str, command)], check=True, cwd=ROOT)
    save_cameras(views(), VIEWS)
    publish(run / "model.safetensors", capture)


def film(capture: Path) -> None:
    """The pictures of all cameras of the scene, and a bake of it, by the extension's own operator."""
    enable_addon()
    import bpy
    import fireside_scene

    fireside_scene.fireside()
    bpy.ops.fastgs.capture_scene(out=str(capture), cameras='ALL', width=960, height=720, quality='FAST', samples=2, world='FILM')


def views() -> list[View]:
    """Nine cameras on an arc in front of the dancer."""
    width, height, focal, target = 640, 360, 470.0, np.array([0.0, 0.2, 1.02])
    eyes = [(3.3 * np.sin(turn), 0.2 - 3.3 * np.cos(turn), 1.45) for turn in np.radians(np.linspace(-52, 52, 9))]
    return [View(f"orbit{k:02}", fg.Camera(width, height, focal, focal, width / 2, height / 2, look_at(np.array(eye), target)))
            for k, eye in enumerate(eyes)]


def publish(trained: Path, capture: Path) -> None:
    """The trained model with its view, and what it reaches on the camera that was held out, compressed."""
    subprocess.run([sys.executable, "-m", "fastgs_blender", "annotate", str(trained), "--view", str(VIEWS), FRONT], check=True, cwd=ROOT)
    model = fg.load(trained)
    reached = fg.evaluate(model, fg.open_capture(capture), lpips=False)["average"]["psnr"]  # compressing wants to know it
    fg.save(replace(model, provenance=model.provenance | {HELD_OUT: f"{reached:.2f}"}), MODEL, compress="fine")
    size = MODEL.stat().st_size
    if size > LARGEST:
        sys.exit(f"{MODEL} has {size} bytes, more than {LARGEST}: it does not ship.")
    print(f"{MODEL}: {size / 1e6:.1f} MB, {reached:.2f} dB on the held-out camera")


if __name__ == "__main__":
    main()

# SPDX-License-Identifier: GPL-3.0-or-later
"""The compressed variant of our own file: python benchmarks/compression.py [--model FILE ...] [--level fine small] [--capture FOLDER]

For each model and level: how many times smaller the file is than the model's arrays in float32, the PSNR of its pictures against those of
the model as it was, and what held-out views lose by it.  The pictures are taken by cameras and at times that compressing does not look
at: those of the capture in full size for the example, a wide forward view and two beside it for models whose cameras are not known.

The loss of a model whose held-out views have R dB is 10 log10(1 + 10^((R - PSNR) / 10)): the error of compression has nothing to do with
the model's own, so their squares add up.  R is what the file records of its held-out views (the example: 32.8 dB), and 32 dB for files
that record nothing, as Spacetime Gaussians report on Neural 3D Video: no truth is known of the .splatv files.  --capture measures the
example's loss itself, on the held-out view of the capture that tools/train_example.py makes.
"""
from __future__ import annotations

import argparse
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.formats import rate, sensitivity  # noqa: E402
from fastgs_blender.formats.rate import LEVELS  # noqa: E402

EXAMPLE = ROOT / "examples" / "fireside.safetensors"
WANTED = {"fine": (8.0, 0.1), "small": (15.0, 0.3)}
"""How many times smaller, at least, and the dB that may be lost."""
GUESSED, UNSEEN = 5, 5000
"""Cameras of a model that has none, and the number of the first in the series of shots: compressing takes its first few hundred."""
WIDTH = 676
TIMES = (0.11, 0.31, 0.53, 0.72, 0.93)


def main() -> None:
    """Prints the table; ends with 1 where a level is missed."""
    warnings.simplefilter("ignore", fg.LossWarning)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", type=Path, nargs="*",
                        default=[EXAMPLE, *sorted((ROOT.parent / "shared" / "data" / "splatv").glob("*.splatv"))])
    parser.add_argument("--level", nargs="*", default=list(LEVELS), choices=list(LEVELS))
    parser.add_argument("--capture", type=Path, help="the example's capture, whose held-out view is the truth")
    arguments = parser.parse_args()
    good = True
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "model.safetensors"
        print(f"{'model':24} {'level':>6} {'Gaussians':>17} {'MB':>13} {'smaller':>8} {'PSNR':>7} {'loses':>9} {'seconds':>8}")
        for path in arguments.model:
            model = fg.load(path)
            views = cameras(path)
            truth = pictures(model, views)
            for level in arguments.level:
                start = time.perf_counter()
                fg.save(model, target, compress=level)
                seconds, again, size = time.perf_counter() - start, fg.load(target), target.stat().st_size
                found = psnr(truth, pictures(again, views))
                loss = 10 * np.log10(1 + 10 ** ((rate.held_out(model) - found) / 10))
                kept, reached = model.nbytes / size >= WANTED[level][0], loss <= WANTED[level][1]
                good &= kept and reached
                print(f"{path.name:24} {level:>6} {len(model):7d} > {len(again):7d} {model.nbytes / 1e6:5.2f} > {size / 1e6:5.2f} "
                      f"{model.nbytes / size:6.2f} x {found:7.2f} {loss:6.3f} dB {seconds:8.1f}"
                      f"{'' if kept and reached else '  MISSED'}", flush=True)
                if arguments.capture and path == EXAMPLE:
                    before, after = held_out(model, arguments.capture), held_out(again, arguments.capture)
                    print(f"{'':24} {'':>6} held out: {before:.3f} > {after:.3f} dB, loses {before - after:.3f} dB")
    sys.exit(not good)


def cameras(path: Path) -> list[fg.Camera]:
    """Some cameras of the file beside it; without one, guessed cameras at places that compressing does not look from."""
    beside = path.with_name("cameras.json")
    if beside.is_file():
        views = fg.load_cameras(beside)
        return [view.camera for view in views[::max(1, len(views) // 4)]]
    return [enlarged(shot.camera) for shot in sensitivity.shots(fg.load(path), GUESSED, UNSEEN)]


def enlarged(camera: fg.Camera) -> fg.Camera:
    """The camera with pictures of WIDTH pixels."""
    factor = WIDTH / camera.width
    lens = (factor * value for value in (camera.fx, camera.fy, camera.cx, camera.cy))
    return fg.Camera(WIDTH, round(factor * camera.height), *lens, camera.world_to_camera)


def pictures(model: fg.GaussianModel, views: list[fg.Camera]) -> list[np.ndarray]:
    """What the cameras see at some times."""
    return [np.clip(fg.render(model, camera, t, ("rgb",))["rgb"], 0, 1) for camera in views for t in TIMES]


def psnr(first: list[np.ndarray], second: list[np.ndarray]) -> float:
    """Of all pictures together."""
    return float(-10 * np.log10(np.mean([np.mean((a - b) ** 2) for a, b in zip(first, second)])))


def held_out(model: fg.GaussianModel, folder: Path) -> float:
    """PSNR of the held-out views of a capture, the mean over its pictures."""
    return float(fg.evaluate(model, fg.open_capture(folder), lpips=False)["average"]["psnr"])


if __name__ == "__main__":
    main()

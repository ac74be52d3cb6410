# SPDX-License-Identifier: GPL-3.0-or-later
"""The compressed variant of our own file: python benchmarks/compression.py [--model FILE ...] [--load 1000000]

For each model and fineness: how many times smaller than its arrays in float32, and the PSNR of its pictures against those of the model
as it was, three cameras at three times.  A model whose pictures are P dB from the truth loses 10 log10(1 + 10^((P - PSNR) / 10)) dB by it;
the table has that for P = 30, which held-out views of real captures reach.  Last, the time to load a large file.
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
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "library")]

from random_models import random_model  # noqa: E402

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.model.pruning import pruned  # noqa: E402

TRUTH = 30.0
FINENESS = (2.0, 1.0, 0.5)


def main() -> None:
    """Prints the table."""
    warnings.simplefilter("ignore", fg.LossWarning)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", type=Path, nargs="*", default=[ROOT / "examples" / "playground.safetensors",
                                                                  *sorted((ROOT.parent / "shared" / "data" / "splatv").glob("*.splatv"))])
    parser.add_argument("--load", type=int, default=1_000_000, help="Gaussians of the file whose loading is timed")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "model.safetensors"
        print(f"{'model':24} {'fineness':>8} {'pruned':>7} {'smaller':>8} {'PSNR':>7} {'loses':>7}")
        for path in arguments.model:
            model, views = fg.load(path), cameras(path)
            truth = pictures(model, views)
            for fineness in FINENESS:
                for share in (0.0, 0.2):
                    fg.save(pruned(model, share) if share else model, target, compress=fineness)
                    found = psnr(truth, pictures(fg.load(target), views))
                    loss = 10 * np.log10(1 + 10 ** ((TRUTH - found) / 10))
                    smaller = model.nbytes / target.stat().st_size
                    print(f"{path.name:24} {fineness:8g} {share:7.0%} {smaller:7.1f}x {found:7.2f} {loss:7.2f}")
        model = random_model(np.random.default_rng(0), arguments.load, "paper", "line", "radial", "sigmoid", extent=5.0)
        fg.save(model, target, compress=0.5)
        times = []
        for _ in range(3):
            start = time.perf_counter()
            fg.load(target)
            times.append(time.perf_counter() - start)
        print(f"{arguments.load:,} Gaussians load in {min(times):.2f} s")


def cameras(path: Path) -> list[fg.Camera]:
    """Three cameras of the example; for others, three that look along z, as captures in COLMAP's axes do."""
    beside = path.with_name("cameras.json")
    if beside.is_file():
        views = fg.load_cameras(beside)
        return [view.camera for view in views[::max(1, len(views) // 3)]][:3]
    found = []
    for x, y in ((0.0, 0.0), (-0.5, 0.1), (0.5, -0.1)):
        matrix = np.eye(4)
        matrix[:2, 3] = x, y
        found.append(fg.Camera(676, 507, 370.0, 370.0, 338.0, 253.5, matrix))
    return found


def pictures(model: fg.GaussianModel, views: list[fg.Camera]) -> list[np.ndarray]:
    """What the cameras see at three times."""
    return [np.clip(fg.render(model, camera, t, ("rgb",))["rgb"], 0, 1) for camera in views for t in (0.1, 0.5, 0.83)]


def psnr(first: list[np.ndarray], second: list[np.ndarray]) -> float:
    """Of all pictures together."""
    return float(-10 * np.log10(np.mean([np.mean((a - b) ** 2) for a, b in zip(first, second)])))


if __name__ == "__main__":
    main()

# SPDX-License-Identifier: GPL-3.0-or-later
"""What cameras cost that are neither genlocked nor equally exposed, and what training gets back.

    .venv/bin/python benchmarks/uneven.py [--steps 1200] [--frames 16] [--folder DIR] [VARIANT ...]

Films the model that comes with the extension with its own 12 cameras at 160 x 120 (one is held out): as it is, and with one camera's
clock 0.4 frames ahead and exposures that differ by up to 30 % (gains 0.7 to 1.3 of the display values, the held-out camera's is 1).
Trains on both with and without these corrections, and prints the held-out view's quality and what was found.
"""
from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import fastgs_blender as fg
from fastgs_blender.cameras.viewpoints import camera_of
from fastgs_blender.captures.layouts.fastgs import write_cameras
from fastgs_blender.evaluation.training_record import corrections

LATE, SHIFT, HELD_OUT, SIZE = "cam02", 0.4, "cam07", (160, 120)
OFF, ON = {"exposures": "off", "clocks": "off"}, {"exposures": "on", "clocks": "on"}
VARIANTS = {
    "even, off": ("even", OFF), "even, auto": ("even", {}), "even, on": ("even", ON),
    "uneven, off": ("uneven", OFF), "uneven, auto": ("uneven", {}), "uneven, exposures": ("uneven", {"clocks": "off"}),
    "clock, off": ("clock", OFF), "clock, auto": ("clock", {"exposures": "off"}),
}
"""The capture of each variant, and its options."""


def film(folder: Path, kind: str, frames: int) -> None:
    """A capture of the example model; kind: even, uneven, or clock (where exposures are even)."""
    model = fg.load(Path(__file__).resolve().parents[1] / "examples" / "fireside.safetensors")
    cameras, entries = [], []
    for place in model.surroundings.cameras:
        c = camera_of(place)
        share = SIZE[0] / c.width
        cameras.append((place.name, fg.Camera(*SIZE, c.fx * share, c.fy * share, c.cx * share, c.cy * share, c.world_to_camera)))
    rng = np.random.default_rng(2)
    for name, c in cameras:
        gain = np.ones(3) if kind != "uneven" or name == HELD_OUT else rng.uniform(0.75, 1.25) * rng.uniform(0.95, 1.05, 3)
        shift = SHIFT if name == LATE and kind != "even" else 0.0
        (folder / name).mkdir(parents=True)
        for f in range(frames):
            rgb = fg.render(model, c, (f + shift) / model.clip.frame_count)["rgb"] * np.clip(gain, 0.7, 1.3)
            Image.fromarray(np.uint8(np.clip(rgb, 0, 1) * 255 + 0.5)).save(folder / name / f"{f + 1:04}.png")
        entries.append({"name": name, "width": SIZE[0], "height": SIZE[1], "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy,
                        "world_to_camera": c.world_to_camera})
    write_cameras(folder, entries, frame_count=frames, fps=24.0, held_out=[HELD_OUT], axes=model.axes)


def main() -> None:
    """Film, train, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("variants", nargs="*", default=list(VARIANTS))
    parser.add_argument("--steps", type=int, default=1200)
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--folder", type=Path, default=Path("build/uneven"))
    args = parser.parse_args()
    for name in args.variants:
        kind, options = VARIANTS[name]
        capture = args.folder / f"{kind}-{args.frames}"
        if not capture.exists():
            film(capture, kind, args.frames)
        began = time.process_time()
        model = fg.train(capture, args.folder / "run", overwrite=True, device="cpu", iterations=args.steps, max_gaussians=8000,
                         init_points=5000,
                         preview_every=0, **options)
        seconds = time.process_time() - began
        found = corrections(model)
        plain, fitted = (fg.evaluate(model, fg.open_capture(capture), lpips=False, backend="cpu", fit_colours=fit)["average"]["psnr"]
                         for fit in (False, True))
        clocks = found.get("clocks", {})
        error = {view: late - (SHIFT if view == LATE and kind != "even" else 0.0) for view, late in clocks.items()}
        told = f"{LATE} {clocks[LATE]:+.3f}, largest error {max(map(abs, error.values())):.3f} frames" if clocks else ""
        print(f"{name:18} {plain:.2f} dB, colours fitted {fitted:.2f} dB  {seconds:.0f} s of the processor  {told}  "
              f"{'exposures evened' if 'exposures' in found else ''}", flush=True)


if __name__ == "__main__":
    main()

# SPDX-License-Identifier: GPL-3.0-or-later
"""Two halves of the example, apart and of other colours, then aligned, then graded: docs/stitch.webp.

    python tools/stitch_sheet.py [--out docs/stitch.webp]
"""
from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from sheet import grid

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
import fastgs_blender as fg  # noqa: E402
from fastgs_blender.rendering.colour import display  # noqa: E402

SIZE = 300, 220
T = 0.15
PAPER = (236, 239, 243)


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--out", type=Path, default=ROOT / "docs" / "stitch.webp")
    options = arguments.parse_args()
    model = fg.load(ROOT / "examples" / "fireside.safetensors")
    x = fg.slice_model(model, T, cull=False).position[:, 0]
    left, right = model.take(x < 0.8), model.take(x > -0.8)
    turn, c, s = np.eye(4), np.cos(0.12), np.sin(0.12)
    turn[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    turn[:3, 3] = 0.15, 0.1, 0.2
    cold = fg.ObjectSettings(exposure=-0.5, tint=(0.7, 0.9, 1.0), saturation=1.3)
    moving, fixed = fg.Instance(left, turn, T, cold), fg.Instance(right, np.eye(4), T)
    found = fg.align(moving, fixed)
    aligned = replace(moving, placement=found.matrix @ turn)
    grade = fg.match_grade(aligned, fixed)
    graded = replace(aligned, settings=replace(cold, **grade.looks))
    off = np.linalg.norm((found.matrix @ turn - np.eye(4))[:3], axis=0).max()
    sys.stdout.write(f"left from the truth {off:.4f}, overlap {found.overlap:.2f}, colours {grade.before:.3f} -> {grade.after:.3f}\n")
    camera = fg.load_cameras(ROOT / "examples" / "cameras.json")[4].camera.stretched(*SIZE)
    pictures = []
    for name, first in (("as imported", moving), ("aligned", aligned), ("graded", graded)):
        image = fg.render([first, fixed], camera)
        alpha = image["alpha"][..., None]
        straight = np.clip(display(image["rgb"], image["alpha"], model.colour_space), 0, 1)
        pictures.append((name, np.round(255 * straight * alpha + np.array(PAPER) * (1 - alpha)).astype(np.uint8)))
    grid(pictures, 3).save(options.out, quality=85, method=6)


if __name__ == "__main__":
    main()

# SPDX-License-Identifier: GPL-3.0-or-later
"""The example under different looks, crops, filters and times: docs/looks.webp.

    python tools/looks_sheet.py [--out docs/looks.webp]
"""
from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from sheet import grid

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
import fastgs_blender as fg  # noqa: E402
from fastgs_blender.rendering.colour import display  # noqa: E402
from fastgs_blender.rendering.crops import Crop  # noqa: E402
from fastgs_blender.rendering.filters import Filter, parting, values  # noqa: E402
from fastgs_blender.rendering.instances import Instance, ObjectSettings  # noqa: E402

SIZE = 300, 190
FRAME = 6
EYE, TARGET = np.array([1.1, -2.5, 1.5]), np.array([0.0, 0.15, 1.0])
PAPER = (236, 239, 243)


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--out", type=Path, default=ROOT / "docs" / "looks.webp")
    options = arguments.parse_args()
    model = fg.load(ROOT / "examples" / "fireside.safetensors")
    ball = np.diag([1.0, 1.0, 1.0, 1.0])
    ball[:3, 3] = -ball[:3, :3] @ TARGET
    speed = parting(values(model, "SPEED"))
    moving, still = ({"filters": [Filter("SPEED", speed, 1e6, keep)]} for keep in (True, False))
    looks = {
        "as the file says": {}, "exposure 1": {"exposure": 1.0}, "contrast 1.6": {"contrast": 1.6}, "saturation 0": {"saturation": 0.0},
        "hue 120 degrees": {"hue": 2.0944}, "tint": {"tint": (1.0, 0.6, 0.3)}, "opacity 0.25": {"opacity": 0.25},
        "splat scale 0.35": {"splat_scale": 0.35}, "largest size 0.03": {"max_size": 0.03},
        "a soft sphere": {"crops": [Crop(ball, shape="SPHERE", soft=0.6)]}, "moving part": moving,
    }
    pictures = {name: picture(model, [(FRAME, ObjectSettings(**look))]) for name, look in looks.items()}
    trail = [((FRAME - 4 * n) % model.clip.frame_count, ObjectSettings(opacity=0.6**n, **moving)) for n in range(5)]
    pictures["echoes of what moves"] = picture(model, [(FRAME, ObjectSettings(**still)), *trail])
    grid(pictures.items(), 4).save(options.out, quality=85, method=6)
    print(options.out)


def picture(model, shown) -> np.ndarray:
    """uint8 [h, w, 3] of the model at (frame, settings) together, over paper."""
    parts = [Instance(model, np.eye(4), model.clip.t_of_frame(frame), settings) for frame, settings in shown]
    out = fg.render(parts, camera())
    alpha = out["alpha"][..., None]
    straight = np.clip(display(out["rgb"], out["alpha"], model.colour_space), 0, 1)
    return np.round(255 * straight * alpha + np.array(PAPER) * (1 - alpha)).astype(np.uint8)


def camera() -> fg.Camera:
    forward = (TARGET - EYE) / np.linalg.norm(TARGET - EYE)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ EYE
    width, height = SIZE
    return fg.Camera(width, height, 0.8 * width, 0.8 * width, width / 2, height / 2, pose)


if __name__ == "__main__":
    main()

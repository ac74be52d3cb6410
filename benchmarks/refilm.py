# SPDX-License-Identifier: GPL-3.0-or-later
"""Films a trained dynamic model with a rig of 18 cameras: a capture whose truth is known.  Its pictures are by this renderer.

    python benchmarks/refilm.py ../shared/data/splatv/spinach_4.splatv captures/kitchen [--frames 50] [--size 480x360] [--focal 500]

What was filmed is a model, so such a capture has no noise, no lens and no detail that Gaussians could not show: it flatters whatever is
trained on it.  The layout is that of Neural 3D Video: camNN/images/0000.png and poses_bounds.npy; cam00 stands in the middle.  The rig
suits spinach_4, whose scene lies 12 to 23 units before it.
"""
from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.util.picture_files import write_png  # noqa: E402

COLUMNS, ROWS = 6, (-0.9, 0.0, 0.9)
TARGET, MIDDLE = np.array([1.0, 1.5, 16.0]), np.array([0.3, 0.0, 0.0])
WIDTH, STEP = 4.4, 0.15
"""The rig's width, and by how much its cameras stand before and behind each other."""
BOUNDS = 5.0, 60.0
"""The nearest and farthest depth that the layout wants to be told."""


def rig() -> list[np.ndarray]:
    """Where the cameras stand, the one in the middle first: three uneven rows."""
    places = []
    for row, height in enumerate(ROWS):
        for column in range(COLUMNS):
            across = WIDTH * (column / (COLUMNS - 1) - 0.5) + 0.12 * ((5 * column + row) % 3) + 0.2 * (row == 1)
            places.append(np.array([across, height + 0.1 * ((3 * column + row) % 3), STEP * ((column + row) % 3)]))
    first = int(np.argmin([np.linalg.norm(place - MIDDLE) for place in places]))
    return [places.pop(first), *places]


def camera(place: np.ndarray, width: int, height: int, focal: float) -> fg.Camera:
    """A camera there that looks at the target; y points down in the model."""
    forward = (TARGET - place) / np.linalg.norm(TARGET - place)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, -turn @ place
    return fg.Camera(width, height, focal, focal, width / 2, height / 2, pose)


def row_of(view: fg.Camera) -> np.ndarray:
    """The camera's 17 numbers in poses_bounds.npy: pose with the axes down, right, backwards; height, width, focal length; bounds."""
    right, down, forward = view.world_to_camera[:3, :3]
    place = -view.world_to_camera[:3, :3].T @ view.world_to_camera[:3, 3]
    return np.append(np.stack([down, right, -forward, place, (view.height, view.width, view.fx)], 1), BOUNDS)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model")
    parser.add_argument("out", type=Path)
    parser.add_argument("--frames", type=int, default=25)
    parser.add_argument("--size", default="480x360")
    parser.add_argument("--focal", type=float, default=500.0)
    options = parser.parse_args()
    model, (width, height) = fg.load(options.model), map(int, options.size.split("x"))
    views = [camera(place, width, height, options.focal) for place in rig()]
    for number, view in enumerate(views):
        folder = options.out / f"cam{number:02}" / "images"
        folder.mkdir(parents=True, exist_ok=True)
        for frame in range(options.frames):
            rgb = fg.render(model, view, (frame + 0.5) / options.frames)["rgb"]
            write_png(folder / f"{frame:04}.png", (np.clip(rgb, 0, 1) * 255 + 0.5).astype(np.uint8))
    np.save(options.out / "poses_bounds.npy", np.array([row_of(view) for view in views]))
    print(f"{options.out}: {len(views)} cameras, {options.frames} frames of {width} x {height}")


if __name__ == "__main__":
    main()

# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture whose pictures have one shade each, and a folder for its cache."""
from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from fastgs_blender.captures import open_capture
from fastgs_blender.captures.layouts.fastgs import write_cameras

VIEWS, FRAMES, WIDTH, HEIGHT = 3, 8, 40, 30


def shade(view: int, frame: int) -> int:
    return 40 * view + 5 * frame


@pytest.fixture
def capture(tmp_path):
    """Pictures of one shade each."""
    folder = tmp_path / "capture"
    folder.mkdir()
    write_cameras(folder, [dict(name=f"cam{i}", width=WIDTH, height=HEIGHT, fx=40, fy=40, cx=20, cy=15, world_to_camera=np.eye(4))
                           for i in range(VIEWS)], frame_count=FRAMES, fps=24)
    for i in range(VIEWS):
        (folder / f"cam{i}").mkdir()
        for frame in range(FRAMES):
            Image.fromarray(np.full((HEIGHT, WIDTH, 3), shade(i, frame), np.uint8)).save(folder / f"cam{i}" / f"{frame + 1:04}.png")
    return open_capture(folder)


@pytest.fixture
def cache(tmp_path):
    return tmp_path / "cache"

# SPDX-License-Identifier: GPL-3.0-or-later
"""Captures in Blender's window: the file browser gives the screen back, the view can be turned, and pictures fit their frusta."""
from __future__ import annotations

import numpy as np
import pytest
from conftest import read_png
from PIL import Image

import fastgs_blender as fg
from fastgs_blender.captures.layouts import fastgs

FRAMES = 6


@pytest.fixture(scope="module")
def capture(user):
    """The name of a folder with a capture of three cameras whose lenses distort; the pictures of the first are half transparent."""
    folder = user.folder / "lens"
    entries = []
    for k, eye in enumerate(((-1.6, -3.0, 0.8), (0.0, -3.4, 0.6), (1.6, -3.0, 0.8))):
        name = f"cam{k}"
        (folder / name).mkdir(parents=True)
        for f in range(FRAMES):
            picture = np.zeros((120, 160, 4), np.uint8)
            picture[..., k], picture[..., 3] = 255, 255
            if k == 0:
                picture[:, :80, 3] = 0
            Image.fromarray(picture if k == 0 else picture[..., :3]).save(folder / name / f"{f + 1:04}.png")
        pose = fg.look_at(eye, np.zeros(3))
        entries.append(dict(name=name, width=160, height=120, fx=150.0, fy=150.0, cx=80.0, cy=60.0, world_to_camera=pose,
                            distortion={"model": "opencv", "k1": -0.02}))
    fastgs.write_cameras(folder, entries, frame_count=FRAMES, fps=30, start_frame=1, axes="RFU")
    return folder.name


def test_from_the_file_browser_to_frusta(user, capture):
    facts = user.story("captures_window.from_browser_to_frusta", window=True, capture=capture)
    assert facts["full"] == ["FILE_BROWSER"] and facts["during"] == facts["before"], "the browser is gone while pictures are corrected"
    assert facts["turned"]
    for name, cameras in facts["frusta"].items():
        wires, pictures = (read_png(user.folder / f"{name}-{kind}.png")[..., :3] for kind in ("wires", "pictures"))
        for camera, corners in cameras.items():
            for x, y in corners:  # Blender's lines end where the picture does
                around = wires[round(y) - 3:round(y) + 4, round(x) - 3:round(x) + 4]
                assert around.min(-1).min() < 0.12, (name, camera, x, y)
            channel, middle = int(camera[3]), np.mean(corners, 0)
            right = np.mean([corners[0], corners[1], middle, middle], 0)
            left = np.mean([corners[2], corners[3], middle, middle], 0)
            for (x, y), clear in ((left, channel == 0), (right, False)):
                found, ground = (shown[round(y), round(x)] for shown in (pictures, wires))
                if clear:
                    assert np.abs(found - ground).max() < 0.06, "nothing is drawn where a picture is transparent"
                else:
                    assert found[channel] > 0.8 and np.delete(found, channel).max() < 0.35, (name, camera, found)

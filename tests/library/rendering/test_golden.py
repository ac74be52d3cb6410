# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders of stored models stay the same.  `python tests/library/rendering/test_golden.py` writes them anew after a wanted change."""
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import fastgs_blender as fg

GOLDEN = Path(__file__).resolve().parents[2] / "golden"
TOLERANCE = 1
"""Steps of 8 bits."""


def picture(name: str, backend: str) -> np.ndarray:
    """RGBA [90, 120, 4] uint8 of a stored model, a little off axis, between two frames."""
    model = fg.load(GOLDEN / f"{name}.safetensors")
    turn = np.array([[0.8, 0, -0.6], [0, 1, 0], [0.6, 0, 0.8]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, (0, 0.1, 3.2)
    camera = fg.Camera(120, 90, 110, 110, 55, 47, pose)
    out = fg.render(model, camera, model.clip.t_of_frame(17.5), backend=backend)
    rgba = np.concatenate([out["rgb"], out["alpha"][..., None]], -1)
    return np.round(255 * np.clip(rgba, 0, 1)).astype(np.uint8)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
@pytest.mark.parametrize("name", ["fourier-features", "keyframes-sh"])
def test_pictures_stay(name, backend):
    wanted = np.asarray(Image.open(GOLDEN / f"{name}.png")).astype(int)
    assert wanted[..., 3].mean() > 30
    assert np.abs(picture(name, backend) - wanted).max() <= TOLERANCE


if __name__ == "__main__":
    for path in GOLDEN.glob("*.safetensors"):
        Image.fromarray(picture(path.stem, "reference")).save(path.with_suffix(".png"))

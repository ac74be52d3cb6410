# SPDX-License-Identifier: GPL-3.0-or-later
"""The installed extension in Blender's window."""
from __future__ import annotations

import numpy as np
import pytest
from conftest import psnr, read_png


def black_behind(rgba: np.ndarray) -> np.ndarray:
    """The sRGB colours [h, w, 3] that Blender shows for premultiplied splats over black: it fades linear light."""
    alpha = rgba[..., 3:]
    straight = np.divide(rgba[..., :3], alpha, out=np.zeros_like(rgba[..., :3]), where=alpha > 0)
    linear = np.where(straight <= 0.04045, straight / 12.92, ((straight + 0.055) / 1.055) ** 2.4) * alpha
    return np.clip(np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055), 0, 1)


def found_in(picture: np.ndarray, screen: np.ndarray) -> tuple[float, tuple[int, int]]:
    """(psnr, (x, y)) of the place in a screenshot that shows a picture best."""
    h, w = picture.shape[:2]
    # the difference's square, everywhere, by correlation of the grey values
    a, b = picture.mean(-1), screen.mean(-1)
    shape = (screen.shape[0] + h, screen.shape[1] + w)
    spectrum = np.fft.rfft2(b, shape)
    cross = np.fft.irfft2(spectrum * np.conj(np.fft.rfft2(a, shape)), shape)
    power = np.fft.irfft2(np.fft.rfft2(b * b, shape) * np.conj(np.fft.rfft2(np.ones_like(a), shape)), shape)
    score = (power - 2 * cross)[:screen.shape[0] - h + 1, :screen.shape[1] - w + 1]
    y, x = np.unravel_index(np.argmin(score), score.shape)
    return psnr(screen[y:y + h, x:x + w], picture), (int(x), int(y))


@pytest.fixture(scope="module")
def first_steps(user, model):
    """Imported through the operator, the sidebar's tab open, F12 pressed."""
    return user.story("window.first_steps", window=True, model=model[1])


def test_f12_in_the_window(first_steps, user, model, reference):
    assert first_steps["finished"]
    assert "IMAGE_EDITOR" in first_steps["areas"]
    saved = read_png(user.folder / "f12-saved.png")[..., :3]
    wanted = black_behind(reference(model[0], first_steps["camera"], first_steps["frame"] - first_steps["start"]))
    assert wanted.mean() > 0.1
    assert np.abs(saved - wanted).max() <= 2 / 255
    # Blender frames the picture, and in a region of odd size puts it between two pixels
    quality, _ = found_in(saved[4:-4, 4:-4], read_png(user.folder / "f12.png")[..., :3])
    assert quality > 36


def test_panels_draw(user, model):
    """In the properties editor; a Python error in a panel's draw() fails the story."""
    places = user.story("window.properties", window=True, model=model[1])
    assert set(places) == {'RENDER', 'VIEW_LAYER', 'OBJECT'}
    for place, (labels, x, y, w, h) in places.items():
        picture = read_png(user.folder / f"properties-{place.lower()}.png")[y:y + h, x:x + w]
        assert picture.std() > 0.05, f"{place} is empty"
        assert labels

# SPDX-License-Identifier: GPL-3.0-or-later
"""The installed extension in Blender's window."""
from __future__ import annotations

import numpy as np
import pytest
from conftest import psnr, read_png

EDGE = 4
INNER = slice(EDGE, -EDGE), slice(EDGE, -EDGE)
"""A picture without its edge, on which Blender draws lines."""


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
    assert "IMAGE_EDITOR" in first_steps["areas"]
    saved = read_png(user.folder / "f12-saved.png")[..., :3]
    wanted = black_behind(reference(model[0], first_steps["camera"], first_steps["frame"] - first_steps["start"]))
    assert wanted.mean() > 0.1
    assert np.abs(saved - wanted).max() <= 2 / 255
    # Blender frames the picture, and in a region of odd size puts it between two pixels
    quality, _ = found_in(saved[INNER], read_png(user.folder / "f12.png")[..., :3])
    assert quality > 36


def test_panels_draw(user, model):
    """In the properties editor; a Python error in a panel's draw() fails the story."""
    places = user.story("window.properties", window=True, model=model[1])
    assert set(places) == {'RENDER', 'VIEW_LAYER', 'OBJECT'}
    for place, (labels, x, y, w, h) in places.items():
        picture = read_png(user.folder / f"properties-{place.lower()}.png")[y:y + h, x:x + w]
        assert picture.std() > 0.05, f"{place} is empty"
        assert labels


@pytest.fixture(scope="module")
def viewports(user, model):
    """Screenshots of the 3D view through the camera, one pixel for each of the picture's."""
    facts = user.story("window.viewports", window=True, model=model[1])
    final = read_png(user.folder / "rendered-f12.png")[..., :3]
    height, width = final.shape[:2]
    assert np.allclose(facts["box"][2:], (width, height), atol=0.01)
    # Blender's outline of the picture lies on its edge, and the outline's corner is drawn to a pixel
    _, (x, y) = found_in(final[INNER], read_png(user.folder / "rendered-12.png")[..., :3])
    assert np.abs(np.array([x, y]) - EDGE - facts["box"][:2]).max() <= 1.01

    def crop(name):
        return read_png(user.folder / f"{name}.png")[y:y + height - 2 * EDGE, x:x + width - 2 * EDGE, :3]

    return facts, crop, final[INNER]


def test_rendered_shading_is_what_f12_shows(viewports, model, reference):
    facts, crop, final = viewports
    wanted = black_behind(reference(model[0], facts["camera"], 25 - facts["start"]))[INNER]
    print("Rendered against F12:", psnr(crop("rendered-12"), final), "and the library:", psnr(crop("rendered-25"), wanted), "dB")
    assert psnr(crop("rendered-12"), final) >= 40
    assert psnr(crop("rendered-25"), wanted) >= 40
    assert psnr(crop("rendered-25"), final) < 30  # the frame was another


def test_solid_shading_shows_splats_among_meshes(viewports, model, reference):
    """Where splats are opaque they have the model's colours; what a mesh hides of them is hidden."""
    facts, crop, _ = viewports
    wanted = reference(model[0], facts["camera"], 25 - facts["start"])[INNER]
    opaque = wanted[..., 3] > 0.99
    assert np.abs(crop("solid-25") - wanted[..., :3])[opaque].mean() < 0.02
    walled = crop("solid-wall")
    column = np.broadcast_to(np.arange(opaque.shape[1]) - opaque.shape[1] / 2, opaque.shape)
    assert np.abs(walled - wanted[..., :3])[opaque & (column > 5)].mean() < 0.02
    assert np.ptp(walled[column < -5].reshape(-1, 3), axis=0).max() < 0.1

# SPDX-License-Identifier: GPL-3.0-or-later
"""The installed extension in Blender's window."""
from __future__ import annotations

import numpy as np
import pytest
from conftest import black_behind, psnr, read_png, region_camera
from PIL import Image

from fastgs_blender.rendering.crops import Crop
from fastgs_blender.rendering.masks import unpack_mask

EDGE = 4
INNER = slice(EDGE, -EDGE), slice(EDGE, -EDGE)
"""A picture without its edge, on which Blender draws lines."""


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
def first_steps(user):
    """The example imported and seen in Solid and Rendered shading beside our tab, and F12 pressed."""
    return user.story("window.first_steps", window=True)


def test_the_example_in_the_viewport(first_steps, user, example, reference):
    """Where neither Blender's text nor our tab lies over it, the view is what the library draws, but for a few lines and the cursor."""
    assert first_steps["count"] == len(example)
    x, y, width, height = first_steps["region"]
    clear = slice(130, -50), slice(80, -330)
    wanted = reference(example, region_camera(first_steps), first_steps["frame"] - first_steps["start"])[clear]
    opaque = wanted[..., 3] > 0.99
    assert opaque.mean() > 0.6 and wanted[..., :3].std() > 0.15
    # what is drawn over Solid shading Blender encodes with a plain gamma of 2.2, which is sRGB to within 8 / 255
    for name, colours, limit in (("solid", wanted[..., :3], 9 / 255), ("rendered", black_behind(wanted), 3 / 255)):
        shown = read_png(user.folder / f"{name}.png")[y:y + height, x:x + width, :3][clear]
        error = np.quantile(np.abs(shown - colours).max(-1)[opaque], 0.95)
        print(f"The example in the viewport, {name}: 95 % of the pixels differ by less than {error * 255:.1f}/255")
        assert error <= limit


def test_f12_in_the_window(first_steps, user, example, reference):
    assert "IMAGE_EDITOR" in first_steps["areas"]
    saved = read_png(user.folder / "f12-saved.png")[..., :3]
    wanted = black_behind(reference(example, first_steps["camera"], first_steps["frame"] - first_steps["start"]))
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


@pytest.fixture
def crops(user, reference, model):
    """crops(facts): a function of a screenshot's name, the camera's picture in it, one pixel for each of the picture's.

    `facts` are of the story's through_camera; its first screenshot tells where the picture is.
    """
    def crops(facts):
        wanted = black_behind(reference(model[0], facts["camera"], facts["frame"] - facts["start"]))
        height, width = wanted.shape[:2]
        assert np.allclose(facts["box"][2:], (width, height), atol=0.01)
        # Blender's outline of the picture lies on its edge, and the outline's corner is drawn to a pixel
        quality, (x, y) = found_in(wanted[INNER], read_png(user.folder / "anchor.png")[..., :3])
        assert quality > 40
        assert np.abs(np.array([x, y]) - EDGE - facts["box"][:2]).max() <= 1.01
        return lambda name: read_png(user.folder / f"{name}.png")[y:y + height - 2 * EDGE, x:x + width - 2 * EDGE, :3]

    return crops


@pytest.fixture
def library(model, reference):
    """library(facts, frame): what the library draws of that frame, cut as crops are, RGBA premultiplied."""
    return lambda facts, frame: reference(model[0], facts["camera"], frame - facts["start"])[INNER]


def test_rendered_and_solid_shading(user, model, crops, library):
    """Rendered shading is F12's picture.  Solid shows splats among meshes: with the model's colours where they are opaque, and
    nothing of what a mesh hides."""
    facts = user.story("window.viewports", window=True, model=model[1])
    crop, final = crops(facts), read_png(user.folder / "rendered-f12.png")[..., :3][INNER]
    wanted = library(facts, 25)
    print("Rendered against F12:", psnr(crop("anchor"), final), "and the library:", psnr(crop("rendered-25"), black_behind(wanted)), "dB")
    assert psnr(crop("anchor"), final) >= 40
    assert psnr(crop("rendered-25"), black_behind(wanted)) >= 40
    assert psnr(crop("rendered-25"), final) < 30  # the frame was another

    opaque = wanted[..., 3] > 0.99
    assert np.abs(crop("solid-25") - wanted[..., :3])[opaque].mean() < 0.02
    walled = crop("solid-wall")
    column = np.broadcast_to(np.arange(opaque.shape[1]) - opaque.shape[1] / 2, opaque.shape)
    assert np.abs(walled - wanted[..., :3])[opaque & (column > 5)].mean() < 0.02
    assert np.ptp(walled[column < -5].reshape(-1, 3), axis=0).max() < 0.1


def test_playback(user, model, crops, library):
    """Frame after frame is drawn; in between and at the end there is one of the clip's, and little is sent to the GPU."""
    facts = user.story("window.playing", window=True, model=model[1])
    crop = crops(facts)
    drawn = list(dict.fromkeys(facts["drawn"]))
    print("Playback:", len(facts["drawn"]), "redraws of", len(drawn), "frames,", facts["bytes"] / 1e6, "MB each")
    assert drawn == list(range(drawn[0], drawn[0] + len(drawn)))
    assert facts["bytes"] < 3e6
    best = max(psnr(crop("playing"), black_behind(library(facts, frame))) for frame in drawn)
    assert best > 30  # the order of the splats may be that of the frame before
    assert psnr(crop("stopped"), black_behind(library(facts, facts["stopped"]))) >= 40


def test_engine_and_extension_go_while_they_draw(user, model, crops, library):
    facts = user.story("window.switching", window=True, model=model[1])
    crop, wanted = crops(facts), library(facts, 12)
    opaque = wanted[..., 3] > 0.99
    assert np.abs(crop("other-engine") - wanted[..., :3])[opaque].mean() < 0.02
    # without the extension there is the proxy, of which nothing was seen before
    points = np.abs(crop("without-extension") - crop("nothing")).max(-1) > 0.02
    assert points.mean() > 0.02
    assert np.abs(crop("without-extension") - wanted[..., :3])[opaque].mean() > 0.05
    assert psnr(crop("back"), black_behind(wanted)) >= 40


def test_a_crop_box(user, model, crops, reference):
    facts = user.story("window.cropping", window=True, model=model[1])
    box = Crop(np.linalg.inv(facts["crop"]))
    wanted, whole = (black_behind(reference(model[0], facts["camera"], 12 - facts["start"], boxes))[INNER] for boxes in ((box,), ()))
    assert psnr(whole, wanted) < 25
    assert psnr(crops(facts)("cropped"), wanted) >= 40


def test_the_box_eraser(user, model, crops, reference):
    """What a box was dragged over is gone, in the viewport as in the library, until undo brings it back."""
    facts = user.story("tools_window.erasing", window=True, model=model[1])
    bits = unpack_mask(facts["mask"], len(model[0]))
    assert 0.02 < bits.mean() < 0.98 and facts["undone"] == ""
    pictures = [reference(shown, facts["camera"], 12 - facts["start"]) for shown in (model[0], model[0].take(~bits))]
    whole, wanted = (black_behind(picture)[INNER] for picture in pictures)
    assert psnr(whole, wanted) < 30
    assert psnr(crops(facts)("brushed"), wanted) >= 40
    assert psnr(crops(facts)("brush-undone"), whole) >= 40


def test_pictures_on_cameras(user, model):
    """A camera's background stands on its frustum, where Blender draws that, in its own colours, before the splats."""
    facts = user.story("window.filmed", window=True, model=model[1])
    x, y, w, h = facts["box"]
    with Image.open(user.folder / "filmed-0.png") as file:
        wanted = np.asarray(file.convert("RGB").resize((round(w), round(h)), Image.Resampling.BOX)) / 255.0
    assert w > 150 and wanted.std() > 0.1
    # the frustum's lines run over it
    quality, (left, top) = found_in(wanted[INNER], read_png(user.folder / "picture.png")[..., :3])
    print("A picture on its camera:", quality, "dB at", left - EDGE, top - EDGE, "for", x, y)
    assert quality > 24
    assert np.hypot(left - EDGE - x, top - EDGE - y) < 3

# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames as files: the right colours in both formats, and never half a file."""
from __future__ import annotations

import errno
import os

import numpy as np
import OpenEXR
import pytest
from PIL import Image
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.rendering import colour, images, passes


@pytest.fixture
def picture(rng):
    """A premultiplied picture with empty, soft and opaque pixels, and its straight colours."""
    alpha = rng.uniform(0.05, 1, (5, 7)).astype(np.float32)
    alpha[0], alpha[1] = 0, 1
    straight = rng.uniform(0, 1, (5, 7, 3)).astype(np.float32)
    straight[0] = 0
    depth = np.where(alpha > 0, 3 + alpha, np.inf).astype(np.float32)
    return {"rgb": straight * alpha[..., None], "alpha": alpha, "depth": depth, "median_depth": depth + 1}, straight


def read_exr(path) -> dict[str, np.ndarray]:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: np.array(channel.pixels) for name, channel in file.channels().items()}


def test_srgb_curve_has_the_standards_values_and_an_inverse():
    np.testing.assert_allclose(colour.srgb_to_linear(np.array([0, 0.04045, 0.5, 1])), [0, 0.0031308, 0.21404114, 1], atol=1e-7)
    values = np.linspace(-2, 3, 500)
    np.testing.assert_allclose(colour.linear_to_srgb(colour.srgb_to_linear(values)), values, atol=2e-7)
    assert colour.srgb_to_linear(np.ones(2, np.float32)).dtype == np.float32


def test_png_has_the_models_own_colours_straight(picture, tmp_path):
    image, straight = picture
    images.write_png(tmp_path / "a.png", image, "srgb")
    pixels = np.asarray(Image.open(tmp_path / "a.png"))
    wanted = np.concatenate([straight, image["alpha"][..., None]], -1)
    assert np.abs(pixels / 255 - wanted).max() <= 0.5 / 255 + 1e-6


def test_png_of_a_linear_model_is_encoded_once(picture, tmp_path):
    image, straight = picture
    images.write_png(tmp_path / "a.png", image, "linear")
    pixels = np.asarray(Image.open(tmp_path / "a.png"))[..., :3]
    assert np.abs(pixels / 255 - colour.linear_to_srgb(straight)).max() <= 0.5 / 255 + 1e-6


def test_exr_is_scene_linear_and_premultiplied_and_holds_every_pass(picture, tmp_path):
    image, straight = picture
    images.write_exr(tmp_path / "a.exr", image, "srgb")
    channels = read_exr(tmp_path / "a.exr")
    assert set(channels) == {"R", "G", "B", "A", "Depth.Z", "MedianDepth.Z"}
    assert {c.dtype for c in channels.values()} == {np.dtype(np.float32)}
    wanted = colour.srgb_to_linear(straight.astype(np.float64)) * image["alpha"][..., None]
    np.testing.assert_allclose(np.stack([channels[c] for c in "RGB"], -1), wanted, atol=1e-6)
    np.testing.assert_array_equal(channels["A"], image["alpha"])
    np.testing.assert_array_equal(channels["Depth.Z"][1:], image["depth"][1:])
    assert (channels["Depth.Z"][0] == np.float32(1e10)).all()


def test_exr_of_a_linear_model_is_what_was_rendered(picture, tmp_path):
    image, _ = picture
    images.write_exr(tmp_path / "a.exr", image, "linear", passes=("rgb",))
    channels = read_exr(tmp_path / "a.exr")
    assert set(channels) == {"R", "G", "B"}
    np.testing.assert_array_equal(np.stack([channels[c] for c in "RGB"], -1), image["rgb"])


def test_a_new_entry_of_the_table_is_a_pass_everywhere(picture, tmp_path, monkeypatch, rng):
    image, _ = picture
    monkeypatch.setitem(passes.PASSES, "velocity", passes.Pass("velocity", lambda blended: 2 * blended.rgb, ("rgb",), 3,
                                                               exr=("Velocity.X", "Velocity.Y", "Velocity.Z")))
    camera = fg.Camera(9, 7, 8, 8, 4, 3, np.eye(4))
    model = random_model(rng, 30, "static")
    model.position[:, 2] += 3
    for backend in ("cpu", "reference"):
        drawn = fg.render(model, camera, passes=("velocity", "rgb"), backend=backend)
        assert drawn["rgb"].any() and np.array_equal(drawn["velocity"], 2 * drawn["rgb"])
    images.write_exr(tmp_path / "a.exr", {"velocity": image["rgb"]}, "srgb")
    channels = read_exr(tmp_path / "a.exr")
    assert set(channels) == {"Velocity.X", "Velocity.Y", "Velocity.Z"}
    np.testing.assert_array_equal(channels["Velocity.Y"], image["rgb"][..., 1])


def test_over_a_background(picture):
    image, straight = picture
    ground = np.array([0.2, 0.4, 0.6], np.float32)
    result = colour.over(image["rgb"], image["alpha"], ground)
    np.testing.assert_allclose(result[0], np.broadcast_to(ground, result[0].shape))
    np.testing.assert_allclose(result[1], straight[1])


@pytest.mark.parametrize("write", [images.write_png, images.write_exr])
def test_a_failed_write_leaves_the_old_file_and_nothing_beside_it(picture, tmp_path, monkeypatch, write):
    path = tmp_path / "frame"
    path.write_bytes(b"old")

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(fg.FastGSError, match="No space left") as error:
        write(path, picture[0], "srgb")
    assert str(error.value).startswith(str(path))
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["frame"]


@pytest.mark.parametrize("write", [images.write_png, images.write_exr])
def test_a_folder_that_is_gone_is_one_sentence(picture, tmp_path, write):
    path = tmp_path / "gone" / "a.img"
    with pytest.raises(fg.FastGSError, match="written") as error:
        write(path, picture[0], "srgb")
    assert str(path) in str(error.value)


@pytest.mark.parametrize("kind", ["png", "exr"])
def test_save_image_writes_by_the_names_ending(picture, tmp_path, kind):
    image, _ = picture
    fg.save_image(image, tmp_path / f"a.{kind}", "linear")
    (images.write_png if kind == "png" else images.write_exr)(tmp_path / f"b.{kind}", image, "linear")
    assert (tmp_path / f"a.{kind}").read_bytes() == (tmp_path / f"b.{kind}").read_bytes()


def test_save_image_refuses_other_pictures(picture, tmp_path):
    image, _ = picture
    for wrong, name, said in ((image, "a.jpg", "a.jpg"), ({"depth": image["depth"]}, "a.png", "depth"), (image["rgb"], "a.png", "array")):
        with pytest.raises(fg.FastGSError, match=said):
            fg.save_image(wrong, tmp_path / name)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Panoramas: places of things in the picture, no visible edges between faces, and a narrow fisheye that equals a pinhole."""
from __future__ import annotations

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.cameras.panorama import Panorama
from fastgs_blender.rendering.exposure import Exposure
from fastgs_blender.rendering.instances import Instance


def specks(directions, size=0.05):
    directions = np.asarray(directions, float)
    count = len(directions)
    return fg.GaussianModel(position=3 * directions / np.linalg.norm(directions, axis=1)[:, None],
                            rotation=np.tile([1.0, 0, 0, 0], (count, 1)), scale=np.full((count, 3), np.log(size)),
                            opacity=np.full(count, 4.0), features=np.full((count, 3), 0.8))


@pytest.mark.parametrize("camera", [
    Panorama(128, 64, np.eye(4)), Panorama(120, 100, np.eye(4), "equidistant", fov=np.radians(220)),
    Panorama(120, 100, np.eye(4), "equisolid", fov=np.radians(180), focal=35.0),
    Panorama(96, 80, np.eye(4), longitude=(-1, 2), latitude=(-0.5, 1), window=(20, 10, 60, 50))])
def test_things_appear_where_the_camera_looks(camera):
    """A speck in the direction of a pixel shows there, at its distance; passes are those of its surroundings."""
    seen = camera.directions()
    _, _, width, height = camera.window
    for y, x in ((height // 2, width // 2), (height // 2, width // 4), (height // 3, width // 2), (height // 4, width // 3)):
        out = fg.render([Instance(specks(seen[y, x][None]), np.eye(4), 0.0, name="it", index=4)], camera,
                        passes=("rgb", "alpha", "depth", "position", "object_index", "count"))
        place = np.unravel_index(out["alpha"].argmax(), out["alpha"].shape)
        assert np.abs(np.subtract(place, (y, x))).max() <= 1
        assert out["depth"][place] == pytest.approx(3, abs=0.03) and out["object_index"][place] == 4 and out["count"][place] > 0.9
        np.testing.assert_allclose(out["position"][place], 3 * seen[place], atol=0.15)
        assert np.isinf(out["depth"]).mean() > 0.8


def test_no_edge_of_a_face_is_seen(rng):
    """A shell of many large translucent splats all around: nowhere does the picture jump more than within a face."""
    directions = rng.normal(size=(3000, 3))
    model = specks(directions, 0.25)
    out = fg.render(model, Panorama(256, 128, np.eye(4)))["rgb"][40:88]
    across = np.abs(np.diff(np.concatenate([out, out[:, :1]], 1), axis=1)).mean((0, 2))  # the picture's own edge is one of them
    edges = [255, 31, 32, 95, 96, 159, 160, 223, 224]
    assert across[edges].max() < 2.5 * np.median(across)


def test_what_a_fisheye_does_not_see_is_empty():
    camera = Panorama(64, 64, np.eye(4), "equidistant", fov=np.pi)
    blank = np.isnan(camera.directions()[..., 0])
    assert 0.15 < blank.mean() < 0.3
    out = fg.render(specks(np.random.default_rng(0).normal(size=(500, 3)), 0.3), camera, passes=("alpha", "depth", "mist"))
    assert not out["alpha"][blank].any() and np.isinf(out["depth"][blank]).all() and (out["mist"][blank] == 1).all()
    assert out["alpha"][~blank].mean() > 0.5


def test_motion_blur_in_panoramas():
    model = fg.GaussianModel(position=[[0.0, 0, 3]], rotation=[[1, 0, 0, 0]], scale=np.full((1, 3), -2.5), opacity=[4.0],
                             features=[[1.0, 1, 1]], basis=fg.Polynomial(1), motion=np.array([[[2.0, 0, 0]]]), clip=fg.Clip(1))
    sharp, blurred = (fg.render(model, Panorama(128, 64, np.eye(4)), 0.5, exposure=each)["alpha"] for each in (None, Exposure(-0.5, 0.5)))
    assert (blurred > 0.02).sum() > 1.5 * (sharp > 0.02).sum()


def test_panoramas_that_there_are_not():
    with pytest.raises(fg.FastGSError, match="mirror"):
        Panorama(10, 10, np.eye(4), "mirror")

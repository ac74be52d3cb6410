# SPDX-License-Identifier: GPL-3.0-or-later
"""Splats sorted pixel by pixel: as the oracle says, and without the jumps that a turning camera makes where centres are sorted."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_cameras import hostile_scales, random_camera, random_pose
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.cameras.panorama import Panorama
from fastgs_blender.kernels.cpu import raster_by_pixel, rasterise
from fastgs_blender.rendering.exposure import Aperture, Exposure
from fastgs_blender.rendering.passes import PASSES, PassSettings
from fastgs_blender.util import threads

BY_PIXEL = PassSettings(sorting="pixel")
TOLERANCE = 2e-4


def close(found, wanted, flips=2, **tolerance):
    """Whether pictures agree but for a few pixels, in which splats are equally far, or at the cut."""
    difference = np.abs(found - wanted)
    difference = difference.max(-1) if difference.ndim == 3 else difference
    return np.count_nonzero(difference > tolerance.get("to", TOLERANCE)) <= flips


@pytest.mark.parametrize("first", range(0, 40, 8))
def test_kernels_agree_with_the_oracle(first):
    for seed in range(first, first + 8):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(1, 120))
        sizes = {"scale": hostile_scales(rng, n)} if seed % 2 else {}
        look = ("rgb", "sh1", "sigmoid")[seed % 3]
        model = random_model(rng, n, "paper", "line", "radial", look, size=10 ** rng.uniform(-1.5, -0.2), **sizes)
        camera = random_camera(rng)
        camera = replace(camera, window=(7, 5, 30, 29)) if seed % 4 == 0 else camera
        passes = ("rgb", "alpha", "depth", "median_depth", "first_depth", "count")
        fast, exact = (fg.render(model, camera, 0.3, passes, backend, settings=BY_PIXEL) for backend in ("cpu", "reference"))
        assert close(fast["rgb"], exact["rgb"]) and close(fast["alpha"], exact["alpha"]), seed
        covered = (exact["alpha"] > 1e-3) & (fast["alpha"] > 1e-3)
        for name in ("depth", "median_depth", "first_depth", "count"):
            assert np.count_nonzero(np.abs(fast[name][covered] / exact[name][covered] - 1) > 1e-3) <= 0.02 * covered.sum() + 1, (seed, name)


def test_with_a_holdout_the_kernels_agree_with_the_oracle():
    for seed in range(6):
        rng = np.random.default_rng(seed)
        model = random_model(rng, 60, size=0.3)
        camera = fg.Camera(48, 40, 40, 40, 24, 20, random_pose(rng, 3.0))
        triangles = 1.5 * rng.normal(size=(6, 3, 3))
        fast, exact = (fg.render(model, camera, 0.3, ("rgb", "alpha", "holdout"), backend, settings=BY_PIXEL, holdout=triangles)
                       for backend in ("cpu", "reference"))
        assert exact["holdout"].any()
        for name, image in fast.items():
            assert close(image, exact[name], flips=0.005 * image.size, to=5e-3), (seed, name)


def crossing(turn: float):
    """Two long flat Gaussians that cross like scissors, seen by a camera that has turned about its own place by so much."""
    model = fg.GaussianModel(position=[[0.5, 0, 3.0], [-0.5, 0, 3.0]], rotation=[[np.cos(a), 0, np.sin(a), 0] for a in (0.35, -0.35)],
                             scale=np.log([[1.0, 0.5, 0.01]] * 2), opacity=[4.0, 4.0], features=[[1, 0.2, 0], [0, 0.4, 1]])
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    return model, fg.Camera(96, 64, 60, 60, 48, 32, pose)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_nothing_pops_while_the_camera_turns(backend):
    """Turned by a thousandth, to either side of where both centres are equally far: sorted by centre, half of the picture jumps."""
    jumps = {}
    for sorting in ("centre", "pixel"):
        pictures = [fg.render(*crossing(turn), backend=backend, settings=PassSettings(sorting=sorting))["rgb"] for turn in (-5e-4, 5e-4)]
        jumps[sorting] = np.abs(pictures[1] - pictures[0]).max(-1)
    assert (jumps["centre"] > 0.3).mean() > 0.05 and jumps["pixel"].max() < 0.1, {name: jump.max() for name, jump in jumps.items()}


def test_crossing_sheets_pass_through_each_other():
    """Left of where they cross the one is in front, right of it the other."""
    red = fg.render(*crossing(0.0), settings=BY_PIXEL)["rgb"][32]
    blue = red[:, 2] > red[:, 0]
    assert (blue[30:46] != blue[50:66]).all() and blue[30:46].all() == blue[30] and blue[50:66].all() == blue[50]


def test_long_lists_keep_their_order(monkeypatch, rng):
    """Hundreds of faint sheets through each other wait at each pixel: there is room for them all, in bands too."""
    monkeypatch.setattr(rasterise, "ENTRIES", 400)
    model = random_model(rng, 300, size=0.5, extent=0.5, opacity=np.full(300, -3.5))
    camera = fg.Camera(40, 36, 40, 40, 20, 18, random_pose(rng, 3.0))
    fast, exact = (fg.render(model, camera, 0.3, ("rgb", "alpha", "count"), backend, settings=BY_PIXEL) for backend in ("cpu", "reference"))
    assert exact["count"].max() > 2 * raster_by_pixel.WAITING
    assert np.abs(fast["rgb"] - exact["rgb"]).max() < TOLERANCE and close(fast["count"], exact["count"], flips=30, to=0.5)


def test_all_passes_and_the_same_bytes_for_any_number_of_threads(rng):
    model = random_model(rng, 1500, "paper", "line", "radial", "sigmoid", size=0.08)
    camera, triangles = fg.Camera(90, 70, 70, 70, 45, 35, random_pose(rng, 3.0)), rng.normal(size=(5, 3, 3))
    pictures = []
    try:
        for count in (1, 3, 1):
            threads.set_threads(count)
            pictures.append(fg.render(model, camera, 0.3, tuple(PASSES), settings=BY_PIXEL, holdout=triangles))
    finally:
        threads.set_threads(0)
    assert all(np.array_equal(pictures[0][name], each[name], equal_nan=True) for each in pictures for name in PASSES)
    plain = fg.render(model, camera, 0.3, holdout=triangles)
    assert np.abs(plain["rgb"] - pictures[0]["rgb"]).max() > 1e-3 and np.abs(plain["alpha"] - pictures[0]["alpha"]).mean() < 0.02


def test_exposures_and_panoramas_sort_by_pixel_too():
    model, camera = crossing(5e-4)
    sharp = fg.render(model, camera, settings=BY_PIXEL)
    for exposure in (Exposure(-0.5, 0.5, steps=2), Exposure(aperture=Aperture(1e-6, 3.0, samples=2))):
        for backend in ("cpu", "reference"):
            found = fg.render(model, camera, settings=BY_PIXEL, exposure=exposure, backend=backend)
            assert np.abs(found["alpha"] - sharp["alpha"]).max() < 1e-3 and np.abs(found["rgb"] - sharp["rgb"]).max() < 0.02
    eye = Panorama(256, 128, np.eye(4))
    around = [fg.render(model, eye, settings=PassSettings(sorting=sorting))["rgb"] for sorting in ("pixel", "centre")]
    assert np.abs(around[0] - around[1]).max() > 0.3


def test_a_single_splat_and_none(rng):
    model, camera = random_model(rng, 1, size=0.3), fg.Camera(40, 30, 30, 30, 20, 15, random_pose(rng, 3.0))
    one, other = (fg.render(model, camera, settings=PassSettings(sorting=sorting)) for sorting in ("centre", "pixel"))
    assert one["alpha"].any() and np.abs(one["rgb"] - other["rgb"]).max() < 1e-6
    for backend in ("cpu", "reference"):
        assert not fg.render(model.take(np.s_[:0]), camera, settings=BY_PIXEL, backend=backend)["alpha"].any()


def test_an_unknown_sorting_is_refused():
    with pytest.raises(fg.FastGSError, match="centre, pixel"):
        PassSettings(sorting="depth")

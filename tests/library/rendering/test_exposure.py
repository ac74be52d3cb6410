# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion blur and depth of field: averages of pictures, whichever way they are computed."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.model.edits import Edit
from fastgs_blender.rendering import colour
from fastgs_blender.rendering.crops import Crop
from fastgs_blender.rendering.cryptomatte import number
from fastgs_blender.rendering.exposure import Aperture, Exposure
from fastgs_blender.rendering.instances import Instance, Moment, ObjectSettings
from fastgs_blender.rendering.masks import pack_mask
from fastgs_blender.util import threads

CAMERA = fg.Camera(96, 64, 90, 90, 48, 32, np.eye(4))


def light(picture):
    """Premultiplied scene-linear light of a picture."""
    return colour.scene_linear(picture["rgb"], picture["alpha"], "srgb")


def arm(speed=3.0):
    """A small ball that crosses the picture before a wall that stands still."""
    rng = np.random.default_rng(1)
    wall = np.stack([*rng.uniform(-4, 4, (2, 400)), np.full(400, 6.0)], 1)
    ball = np.array([[-speed / 2, 0.3, 3.0]]) + rng.normal(0, 0.1, (40, 3))
    motion = np.zeros((440, 1, 3))
    motion[400:, 0, 0] = speed
    return fg.GaussianModel(position=np.concatenate([wall, ball]), rotation=rng.normal(size=(440, 4)),
                            scale=np.log(np.r_[np.full(400, 0.25), np.full(40, 0.05)])[:, None].repeat(3, 1), opacity=np.full(440, 3.0),
                            features=rng.uniform(0, 1, (440, 3)), basis=fg.Polynomial(1), motion=motion, clip=fg.Clip(10))


def average(model, camera, times, cameras=None):
    pictures = [fg.render(model, eye, t) for t, eye in zip(times, cameras or [camera] * len(times), strict=True)]
    return np.mean([light(p) for p in pictures], 0), np.mean([p["alpha"] for p in pictures], 0)


def test_motion_blur_is_the_average_of_all_times():
    """A shutter of four tenths of the clip, 24 pixels of travel; what stands still is the plain picture, to 1e-4."""
    model = arm(2.0)
    out = fg.render(model, CAMERA, 0.5, exposure=Exposure(-2, 2, steps=64))
    expected, _ = average(model, CAMERA, 0.3 + 0.4 * (np.arange(128) + 0.5) / 128)
    difference = np.abs(light(out) - expected)
    assert difference.mean() < 5e-4 and difference.max() < 0.02
    plain = fg.render(model, CAMERA, 0.5)
    assert np.abs(light(plain) - expected).max() > 0.1, "it should move"
    still = np.zeros((64, 96), bool)
    still[:16], still[-8:] = True, True
    assert np.abs(out["rgb"] - plain["rgb"])[still].max() < 1e-4
    exact, coarse = (fg.render(model, CAMERA, 0.5, exposure=Exposure(-2, 2, steps=32), backend=name) for name in ("reference", "cpu"))
    assert np.abs(light(exact) - light(coarse)).mean() < 5e-4


def test_what_does_not_move_stays_as_it_is(rng):
    model = random_model(rng, 300, "paper", "line", "radial", "sh1", size=0.1)
    camera = replace(CAMERA, world_to_camera=np.diag([1.0, 1, 1, 1]) + np.eye(4)[2][:, None] * [0, 0, 0, 3.0])
    still = fg.freeze(model, 0.4)
    plain = fg.render(still, camera)
    assert plain["alpha"].any()
    blurred = fg.render(still, camera, exposure=Exposure(-1, 1))
    for name in plain:
        np.testing.assert_allclose(blurred[name], plain[name], atol=1e-4)


def test_a_streak_is_no_row_of_copies():
    """Eight steps for a speck that crosses 60 pixels: its trail is even, though copies would be eight pixels apart."""
    model = fg.GaussianModel(position=[[-1.0, 0, 3.0]], rotation=[[1, 0, 0, 0]], scale=np.full((1, 3), np.log(0.03)), opacity=[2.0],
                             features=[[1.0, 1, 1]], basis=fg.Polynomial(1), motion=np.array([[[2.0, 0, 0]]]), clip=fg.Clip(1))
    row = fg.render(model, CAMERA, 0.5, passes=("alpha",), exposure=Exposure(-0.5, 0.5, steps=8))["alpha"][32, 26:70]
    assert row.min() > 0.6 * row.max() > 0
    plain = fg.render(model, CAMERA, 0.5, passes=("alpha",))["alpha"]
    assert row.max() < 0.3 * plain.max()


def test_objects_cameras_and_the_shutters_curve():
    """The object moves between the moments that are given, the camera zooms; the shutter opens late."""
    model = fg.freeze(arm(), 0.5)
    later = np.eye(4)
    later[0, 3] = 0.4
    zoomed = replace(CAMERA, fx=100, fy=100)
    moments = tuple(Moment({"it": Instance(model, place, 0.0, place="it")}, eye) for place, eye in ((np.eye(4), CAMERA), (later, zoomed)))
    exposure = Exposure(moments=moments, curve=(0.0, 0.0, 1.0, 1.0, 1.0), steps=64)
    out = fg.render([Instance(model, np.eye(4), 0.0, place="it")], CAMERA, exposure=exposure)
    x = (np.arange(256) + 0.5) / 256
    weight = np.interp(x, np.linspace(0, 1, 5), exposure.curve)
    expected = 0
    for share, w in zip(x, weight / weight.sum(), strict=True):
        place, focal = np.eye(4), 90 + 10 * share
        place[0, 3] = 0.4 * share
        expected = expected + w * light(fg.render([(model, place, 0.0)], replace(CAMERA, fx=focal, fy=focal)))
    assert np.abs(light(out) - expected).mean() < 5e-4 and np.abs(light(out) - expected).max() < 0.03


@pytest.mark.parametrize("blades", [0, 5, 6])
def test_depth_of_field_is_the_average_over_the_lens(blades):
    """Of some 250 pinhole pictures through a grid of points of the opening, which is made here; the plane of focus stays sharp."""
    model = fg.freeze(arm(1.0), 0.5)
    lens = Aperture(0.25, 3.0, blades, 0.3, samples=128)
    out = fg.render(model, CAMERA, exposure=Exposure(aperture=lens))
    edges = blades or 64
    middles = 0.3 + 2 * np.pi * (np.arange(edges) + 0.5) / edges
    points = np.stack(np.meshgrid(*[(np.arange(18) - 8.5) / 9] * 2), -1).reshape(-1, 2)
    points = 0.25 * points[(points @ np.stack([np.cos(middles), np.sin(middles)]) <= np.cos(np.pi / edges)).all(1)]
    assert 180 < len(points) < 260
    cameras = []
    for x, y in points:
        shift = np.eye(4)
        shift[:2, 3] = -x, -y
        cameras.append(replace(CAMERA, world_to_camera=shift, cx=48 + 90 * x / 3, cy=32 + 90 * y / 3))
    expected, _ = average(model, None, [0.0] * len(points), cameras)
    plain = light(fg.render(model, CAMERA))
    assert np.abs(light(out) - expected).mean() < 0.1 * np.abs(plain - expected).mean(), (
        np.abs(light(out) - expected).mean(), np.abs(plain - expected).mean())


def test_points_of_the_lens():
    """They fill the opening evenly: its middle, its extent, its corners; any beginning does."""
    for blades, area in ((0, np.pi), (3, 1.299), (6, 2.598)):
        points = Aperture(2.0, 1.0, blades).points(2048) / 2
        assert np.abs(points.mean(0)).max() < 0.01
        assert np.linalg.norm(points, axis=1).max() <= 1 + 1e-9
        grid = np.unique((points * 8).astype(int), axis=0)
        assert abs(len(grid) / 64 - area) < 0.9
        for count in (16, 128):
            assert np.abs(points[:count].mean(0)).max() < 1 / np.sqrt(count)
    disc = Aperture(1.0, 1.0).points(8)
    np.testing.assert_allclose(disc.T @ disc / 8, np.eye(2) / 4, atol=1e-12)
    lens = Aperture(1.0, 1.0)
    for exposure in (Exposure(-1, 1), Exposure(-1, 1, curve=(0, 1, 0.5)), Exposure(-1, 1, aperture=lens), Exposure(aperture=lens)):
        samples = exposure.samples(3)
        for level in range(4):
            assert sum(sample.weights[level] for sample in samples) == pytest.approx(1, abs=1e-3)
            assert all(sample.weights[level] == 0 for sample in samples if sample.level > level)
    wide = Aperture(1.0, 1.0, ratio=2.0).points(500)
    assert np.ptp(wide[:, 1]) > 1.8 * np.ptp(wide[:, 0])


def test_exposures_are_repeatable_and_windows_are_parts():
    model, exposure = arm(), Exposure(-1, 1, steps=16, aperture=Aperture(0.05, 3.0, samples=16))
    whole = fg.render(model, CAMERA, 0.5, exposure=exposure)
    threads.set_threads(1)
    try:
        assert fg.render(model, CAMERA, 0.5, exposure=exposure)["rgb"].tobytes() == whole["rgb"].tobytes()
    finally:
        threads.set_threads(0)
    part = fg.render(model, replace(CAMERA, window=(20, 10, 40, 30)), 0.5, exposure=exposure)
    np.testing.assert_allclose(part["rgb"], whole["rgb"][10:40, 20:60], atol=0.02)


def test_data_passes_are_of_the_pictures_own_time():
    out, plain = (fg.render(arm(), CAMERA, 0.5, ("rgb", "alpha", "depth", "count"), exposure=each) for each in (Exposure(-1, 1), None))
    assert out["depth"].tobytes() == plain["depth"].tobytes() and out["count"].tobytes() == plain["count"].tobytes()
    assert np.abs(out["alpha"] - plain["alpha"]).max() > 0.01


def test_exposures_that_make_no_sense():
    with pytest.raises(fg.FastGSError, match="one step"):
        Exposure(steps=0)
    with pytest.raises(fg.FastGSError, match="curve"):
        Exposure(curve=(0.0, 0.0))


def test_what_is_hidden_stays_hidden_and_what_moves_moves_in_every_sample():
    """A shutter of moments, in which the ball covers a few tiles alone: the same as one of the model's own time, with a mask too."""
    model = arm(2.0)
    for gone in (np.zeros(440, bool), np.arange(440) % 3 == 0):
        settings = ObjectSettings(mask=pack_mask(gone))
        left = model.take(~gone)
        expected = fg.render(left, CAMERA, 0.5, exposure=Exposure(-2, 2, steps=64))
        moments = [Moment({"one": Instance(model, np.eye(4), t, settings, place="one")}, CAMERA) for t in np.linspace(0.3, 0.7, 9)]
        shutter = Exposure(moments=tuple(moments), steps=64)
        found = fg.render([Instance(model, np.eye(4), 0.5, settings, place="one")], CAMERA, exposure=shutter)
        assert np.abs(found["rgb"] - expected["rgb"]).max() < 2e-3
        lens = Exposure(aperture=Aperture(0.05, 4.0, samples=16))
        blurred = fg.render([Instance(model, np.eye(4), 0.5, settings)], CAMERA, exposure=lens)
        assert np.abs(blurred["rgb"] - fg.render(left, CAMERA, 0.5, exposure=lens)["rgb"]).max() < 2e-3


@pytest.mark.slow
def test_edits_are_blurred_between_the_moments():
    """A still model that an edit moves through the open shutter is what a model that moves by itself is."""
    model = arm(2.0)
    still = replace(model, basis=fg.Static(), motion=np.zeros((440, 0, 3)))
    expected = fg.render(model, CAMERA, 0.5, exposure=Exposure(-2, 2, steps=64))

    def at(t):
        edited = Edit(0.0, position=fg.slice_model(model, t, cull=False).position).applied(still)
        return Instance(edited, np.eye(4), 0.0, place="one", origin=still)

    moments = tuple(Moment({"one": at(t)}, CAMERA) for t in np.linspace(0.3, 0.7, 9))
    for backend in ("cpu", "reference"):
        found = fg.render([at(0.5)], CAMERA, exposure=Exposure(moments=moments, steps=64), backend=backend)
        assert np.abs(found["rgb"] - expected["rgb"]).mean() < 1e-3 and np.abs(found["rgb"] - expected["rgb"]).max() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("soft", [0.0, 0.4])
def test_crops_and_looks_that_move_are_blurred(soft):
    """A sphere that uncovers a still model as it sweeps along, while the model fades: the average of all times."""
    model = fg.freeze(arm(), 0.5)

    def at(share):
        matrix = np.diag([1.0, 1, 0.1, 1])
        matrix[0, 3] = 0.8 - 1.6 * share
        crops = [Crop(np.eye(4) * [0.2, 0.2, 0.05, 1]), Crop(matrix, remove=True, shape="SPHERE", soft=soft)]
        return Instance(model, np.eye(4), 0.0, ObjectSettings(crops=crops, opacity=1 - 0.5 * share), place="one")

    moments = tuple(Moment({"one": at(share)}, CAMERA) for share in np.linspace(0, 1, 9))
    expected = np.mean([light(fg.render([at((i + 0.5) / 128)], CAMERA)) for i in range(128)], 0)
    assert np.abs(light(fg.render([at(0.5)], CAMERA)) - expected).max() > 0.15, "it should matter"
    for backend in ("cpu", "reference"):
        found = light(fg.render([at(0.5)], CAMERA, exposure=Exposure(moments=moments, steps=64), backend=backend))
        assert np.abs(found - expected).mean() < 1e-3 and np.abs(found - expected).max() < 0.02


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_mattes_are_averages_and_data_is_the_middle_of_the_shutter(backend):
    """A matte fits the blurred picture.  Depths and numbers of objects are sharp, of the middle of the time, wherever that lies."""
    camera = fg.Camera(48, 32, 45, 45, 24, 16, np.eye(4))
    model = arm(1.0)
    still = np.arange(440) < 400
    parts = [Instance(model.take(np.flatnonzero(which)), np.eye(4), 0.5, name=name, index=index)
             for name, index, which in (("Wall", 1, still), ("Ball", 2, ~still))]
    passes = ("alpha", "cryptomatte_00", "depth", "object_index")
    exposure = Exposure(0, 4, steps=8)
    found = fg.render(parts, camera, passes=passes, exposure=exposure, backend=backend)
    middle = fg.render([replace(part, t=0.7) for part in parts], camera, passes=passes, backend=backend)
    for name in ("depth", "object_index"):
        np.testing.assert_array_equal(found[name], middle[name])
    assert (found["depth"] != fg.render(parts, camera, passes=["depth"], backend=backend)["depth"]).any()

    def ball(level):
        return np.where(level[..., 0::2] == number("Ball"), level[..., 1::2], 0).sum(-1)

    samples = exposure.samples(exposure.levels)
    matte = sum(s.weights[-1] * ball(fg.render([replace(part, t=0.5 + 0.4 * s.time) for part in parts], camera, passes=["cryptomatte_00"],
                                               backend=backend)["cryptomatte_00"]) for s in samples)
    assert np.abs(ball(found["cryptomatte_00"]) - matte).max() < 0.03
    assert np.abs(ball(middle["cryptomatte_00"]) - matte).max() > 0.3, "it should move"
    cover = found["cryptomatte_00"][..., 1::2].sum(-1)
    np.testing.assert_allclose(cover, found["alpha"], atol=1e-4)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles that hide splats: on scenes whose values are known, and the kernels against the oracle on random ones."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_cameras import random_pose
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.cameras.panorama import Panorama
from fastgs_blender.kernels.cpu.holdout import Occluder
from fastgs_blender.rendering.exposure import Aperture, Exposure
from fastgs_blender.rendering.holdout import SAMPLES, points, sample_depths
from fastgs_blender.rendering.instances import Instance, Moment
from fastgs_blender.rendering.passes import PASSES
from fastgs_blender.util.threads import set_threads

BACKENDS = ("cpu", "reference")
CAMERA = fg.Camera(32, 24, 40, 40, 16, 12, np.eye(4))
EVERYTHING = ("rgb", "alpha", "holdout")


def sheet(z, alpha):
    """One Gaussian as wide as the picture, flat along z, of nearly this alpha everywhere."""
    return fg.GaussianModel(position=[[0, 0, z]], rotation=[[1, 0, 0, 0]], scale=np.log([[500, 500, 0.01]]),
                            opacity=[np.log(alpha / (1 - alpha))], features=[[0.2, 0.4, 0.6]])


def sheets(*pairs):
    return [Instance(sheet(z, alpha), np.eye(4), 0.0) for z, alpha in pairs]


def rectangle(left, top, right, bottom, z):
    """Two triangles that cover these pixels of CAMERA, at a depth."""
    corners = [((x - 16) / 40 * z, (y - 12) / 40 * z, z) for x, y in ((left, top), (right, top), (right, bottom), (left, bottom))]
    return np.array([[corners[i] for i in (0, 1, 2)], [corners[i] for i in (0, 2, 3)]], np.float32)


def everywhere(z):
    return rectangle(-100, -100, 200, 200, z)


def camera_around(rng, orthographic=False, **fields):
    """A camera that looks at the origin from three units away, turned at random."""
    focal = 12 if orthographic else 45
    return fg.Camera(48, 40, focal, 1.1 * focal, 20, 22, random_pose(rng, 3.0), orthographic=orthographic, **fields)


def soup(rng, count, spread=1.5, size=0.7):
    """Triangles here and there around a random model, some of them behind the camera and through its near plane."""
    return (rng.normal(0, spread, (count, 1, 3)) + rng.normal(0, size, (count, 3, 3))).astype(np.float32)


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_lies_behind_is_hidden_and_what_lies_in_front_blends(backend):
    scene = sheets((2, 0.4), (3, 0.5), (5, 0.9))
    found = fg.render(scene, CAMERA, passes=(*EVERYTHING, "depth"), backend=backend, holdout=rectangle(8, 6, 24, 18.5, 4.0))
    free = fg.render(scene, CAMERA, passes=(*EVERYTHING, "depth"), backend=backend)
    inside, edge, outside = np.s_[6:18, 8:24], np.s_[18, 8:24], np.ones((24, 32), bool)
    outside[6:19, 8:24] = False
    front = fg.render(scene[:2], CAMERA, passes=(*EVERYTHING, "depth"), backend=backend)
    for name in ("rgb", "alpha", "depth"):
        assert np.abs(found[name][inside] - front[name][inside]).max() < 1e-6
        assert np.array_equal(found[name][outside], free[name][outside])  # to the last bit
    assert found["holdout"][inside] == pytest.approx(1 - front["alpha"][inside], abs=1e-6) and not found["holdout"][outside].any()
    for name in ("rgb", "alpha"):  # half of the pixels' points are covered
        assert np.abs(found[name][edge] - (front[name][edge] + free[name][edge]) / 2).max() < 1e-6
    assert (found["depth"][edge] > front["depth"][edge]).all() and (found["depth"][edge] < free["depth"][edge]).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_an_opaque_mesh_in_front_leaves_nothing(backend):
    everything = [name for name in PASSES if name not in EVERYTHING and name != "mist"]
    found = fg.render(sheets((2, 0.4), (5, 0.999)), CAMERA, passes=(*EVERYTHING, *everything), backend=backend, holdout=everywhere(1.0))
    assert not found["rgb"].any() and not found["alpha"].any() and (found["holdout"] == 1).all()
    for name in everything:
        assert (found[name] == PASSES[name].empty).all(), name


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_floor_does_not_reach_over_what_stands_on_it(backend):
    """A flat Gaussian's middle lies before a wall that stands on it: above the line where they meet, the wall alone is seen."""
    floor = fg.GaussianModel(position=[[0, 1.0, 3.0]], rotation=[[1, 0, 0, 0]], scale=np.log([[0.5, 0.001, 0.5]]), opacity=[6.0],
                             features=[[0.2, 0.4, 0.6]])
    wall = everywhere(3.6)  # y points down: floor and wall meet at y = 1, z = 3.6, on the row 12 + 40 / 3.6 = 23.1
    found, free = (fg.render(floor, CAMERA, passes=EVERYTHING, backend=backend, holdout=each) for each in (wall, None))
    assert free["alpha"][20:22, 14:18].min() > 0.1
    assert not found["alpha"][:22].any() and (found["holdout"][:22] == 1).all()
    assert free["alpha"][23, 14:18].min() > 0.3 and np.abs(found["alpha"][23] - free["alpha"][23]).max() < 1e-6


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_mesh_without_splats_still_holds_light_back(backend):
    found = fg.render([], CAMERA, passes=tuple(PASSES), backend=backend, holdout=rectangle(8, 6, 24, 18, 4.0))
    assert (found["holdout"][6:18, 8:24] == 1).all() and found["holdout"].sum() == 12 * 16 and not found["alpha"].any()
    assert np.isinf(found["depth"]).all()
    lens = Exposure(aperture=Aperture(0.1, 2))
    blurred = fg.render([], CAMERA, passes=EVERYTHING, backend=backend, holdout=everywhere(4.0), exposure=lens)
    assert blurred["holdout"] == pytest.approx(1, abs=1e-6)


def test_the_points_of_a_pixel_make_sixteen_steps_of_an_edge():
    for axis in range(2):
        assert np.array_equal(np.sort(points()[:, axis]), (np.arange(SAMPLES) + 0.5) / SAMPLES)
    for cut in (0.25, 0.5, 0.8125):
        found = fg.render([], CAMERA, passes=("holdout",), holdout=rectangle(4, 4, 20 + cut, 10, 2.0))["holdout"]
        assert found[6, 20] == cut


def test_meshes_have_no_cracks():
    """A bumpy surface of many triangles, some smaller than a pixel, from edge to edge."""
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(np.linspace(-2, 2, 91), np.linspace(-2, 2, 83))
    grid = np.stack([x, y, 3 + 0.2 * rng.random(x.shape)], -1).astype(np.float32)
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    triangles = np.concatenate([np.stack(t, -2).reshape(-1, 3, 3) for t in ((a, b, c), (a, c, d))])
    found = fg.render(sheets((5, 0.9)), CAMERA, passes=EVERYTHING, holdout=triangles)
    assert (found["holdout"] == 1).all() and not found["alpha"].any()


@pytest.mark.parametrize("orthographic", [False, True])
def test_triangles_are_drawn_as_the_oracle_says(orthographic):
    rng = np.random.default_rng(11)
    for _ in range(3):
        camera = camera_around(rng, orthographic, near=0.3, far=9.0, window=(5, 3, 41, 30))
        triangles = np.concatenate([soup(rng, 60), soup(rng, 200, 1.0, 0.05), soup(rng, 4, 3.0, 20.0)])
        wanted = sample_depths(triangles, camera)
        occluder = Occluder.of(triangles, camera)
        left, top, columns, rows = occluder.listing.grid
        drawn = np.full((rows * columns, 256, SAMPLES), np.inf, np.float32)
        for tile in range(rows * columns):
            found = occluder.depths(tile, tile + 1)
            drawn[tile] = found[0] if len(found) else np.inf
        picture = drawn.reshape(rows, columns, 16, 16, SAMPLES).transpose(0, 2, 1, 3, 4).reshape(16 * rows, 16 * columns, SAMPLES)
        x0, y0, width, height = camera.window
        picture = picture[y0 - 16 * top:, x0 - 16 * left:][:height, :width]
        assert (np.isfinite(picture) == np.isfinite(wanted)).mean() > 1 - 1e-5 and np.isfinite(wanted).mean() > 0.2
        both = np.isfinite(picture) & np.isfinite(wanted)
        assert np.quantile(np.abs(picture[both] / wanted[both] - 1), 1 - 1e-4) < 1e-5


@pytest.mark.slow
def test_kernels_agree_with_the_oracle():
    rng = np.random.default_rng(5)
    for kind, orthographic in (("rgb", False), ("sigmoid", False), ("sh1", True)):
        model, camera = random_model(rng, 300, appearance=kind), camera_around(rng, orthographic)
        triangles = soup(rng, 40)
        names = (*EVERYTHING, "depth", "normal", "count")
        found, wanted = (fg.render(model, camera, 0.3, names, backend, holdout=triangles) for backend in BACKENDS)
        free = fg.render(model, camera, 0.3, names, "cpu")
        for name in EVERYTHING:
            assert np.abs(found[name] - wanted[name]).max() < 2e-3 and np.abs(found[name] - wanted[name]).mean() < 2e-5, name
        uncovered = np.isinf(sample_depths(triangles, camera)).all(-1)
        assert 0.05 < uncovered.mean() < 0.95
        for name in names:
            assert np.array_equal(found[name][uncovered], free[name][uncovered]), name


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_mesh_that_moves_is_blurred(backend):
    """It crosses eight pixels while the shutter is open; the sheet behind it stands still."""
    scene = sheets((5, 0.9))
    moments = tuple(Moment({}, CAMERA, rectangle(4 + 8 * t, -50, 12 + 8 * t, 50, 2.0)) for t in (0.0, 0.5, 1.0))
    exposure = Exposure(moments=moments, steps=64)
    found = fg.render(scene, CAMERA, passes=EVERYTHING, backend=backend, exposure=exposure, holdout=moments[1].holdout)
    x = np.arange(32) + 0.5
    wanted = np.clip(np.minimum(x - 4, 20 - x) / 8, 0, 1)
    assert np.abs(found["holdout"] - wanted).max() < 0.02
    still = fg.render(scene, CAMERA, passes=EVERYTHING, backend=backend)
    assert np.abs(found["alpha"] - still["alpha"] * (1 - wanted)).max() < 0.02
    assert np.abs(found["alpha"] - still["alpha"])[:, 22:].max() < 1e-6
    for middle in (moments[1].holdout[:1], None):  # other triangles, and none, at another time
        other = replace(exposure, moments=(moments[0], replace(moments[1], holdout=middle), moments[2]))
        changed = fg.render(scene, CAMERA, passes=EVERYTHING, backend=backend, exposure=other, holdout=moments[1].holdout)["holdout"]
        assert 0.2 < changed.max() < found["holdout"].max() + 0.01
    still = replace(exposure, moments=tuple(replace(moment, holdout=None) for moment in moments))
    found = fg.render(scene, CAMERA, passes=EVERYTHING, backend=backend, exposure=still, holdout=rectangle(8, 6, 24, 18, 2.0))
    assert found["holdout"][12, 12] == pytest.approx(1, abs=1e-5) and not found["holdout"][2].any()


def test_depth_of_field_blurs_a_mesh_as_the_average_of_pinholes():
    lens = Aperture(0.25, 4.0, samples=256)
    scene, triangles = sheets((4, 0.8)), rectangle(8, 6, 24, 18, 2.0)
    found = fg.render(scene, CAMERA, passes=EVERYTHING, exposure=Exposure(aperture=lens), holdout=triangles)
    eyes = [lens.through(CAMERA, point) for point in lens.points(256)]
    wanted = np.mean([fg.render(scene, eye, passes=EVERYTHING, holdout=triangles)["holdout"] for eye in eyes], 0)
    assert np.abs(found["holdout"] - wanted).max() < 0.02 and 0.1 < wanted[12, 6] < 0.9


def test_panoramas_have_meshes_all_around():
    model = fg.GaussianModel(position=np.random.default_rng(2).normal(0, 1, (200, 3)) * 3, rotation=np.tile([1.0, 0, 0, 0], (200, 1)),
                             scale=np.full((200, 3), -1.5), opacity=np.full(200, 3.0), features=np.full((200, 3), 0.5))
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    faces = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    box = np.array([[corners[f[i]] for i in part] for f in faces for part in ((0, 1, 2), (0, 2, 3))])
    camera = Panorama(64, 32, np.eye(4))
    outside = fg.render(model, camera, passes=EVERYTHING, holdout=30 * box)
    inside = fg.render(model, camera, passes=EVERYTHING, holdout=0.01 * box)
    assert np.array_equal(outside["rgb"], fg.render(model, camera)["rgb"])
    assert outside["holdout"] + outside["alpha"] == pytest.approx(1, abs=1e-4)
    assert not inside["alpha"].any() and inside["holdout"] == pytest.approx(1, abs=1e-6)


def test_the_same_bytes_for_any_number_of_threads():
    rng = np.random.default_rng(9)
    model, camera, triangles = random_model(rng, 300), camera_around(rng), soup(rng, 300)
    pictures = []
    for count in (1, 3):
        set_threads(count)
        pictures.append(fg.render(model, camera, 0.2, EVERYTHING, holdout=triangles))
    set_threads(0)
    assert all(np.array_equal(pictures[0][name], pictures[1][name]) for name in EVERYTHING)


def test_what_is_no_triangle_is_refused():
    for wrong in ([[1, 2, 3]], "mesh", np.zeros((4, 3))):
        with pytest.raises(fg.FastGSError, match=r"holdout.*\(F, 3, 3\)"):
            fg.render(sheet(2, 0.5), CAMERA, holdout=wrong)
    broken = np.concatenate([everywhere(1.0) * np.nan, everywhere(3.0)[:0]])
    assert fg.render(sheet(2, 0.5), CAMERA, holdout=broken)["alpha"].all()

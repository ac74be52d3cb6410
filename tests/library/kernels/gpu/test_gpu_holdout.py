# SPDX-License-Identifier: GPL-3.0-or-later
"""What triangles hide, shadows, and sorting by pixel: the GPU's pictures against the oracle's."""
from __future__ import annotations

import numpy as np
import pytest
from random_cameras import random_pose
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.kernels.gpu import holdout, shaders
from fastgs_blender.rendering.passes import PassSettings
from fastgs_blender.rendering.shadow import Light, Shadow
from fastgs_blender.util.backends import load_backend

CLOSE, MEAN, FEW = 2e-3, 1e-5, 0.001
"""Pictures may differ by more than CLOSE in a share FEW of the pixels: where a splat's alpha or a triangle's edge is at a limit."""


def scene(seed: int, orthographic: bool = False):
    """(model, camera, triangles): some of these reach behind the camera, far beside the picture, and through each other."""
    rng = np.random.default_rng(seed)
    model = random_model(rng, 80, "fourier", "line", "radial", ("sh1", "sigmoid", "rgb")[seed % 3], size=10 ** rng.uniform(-1.5, -0.4))
    focal = 14 if orthographic else 50
    camera = fg.Camera(60, 44, focal, 1.1 * focal, 31, 20, random_pose(rng, 3.0), orthographic=orthographic, window=(5, 3, 50, 38))
    small, large = rng.normal(0, 0.8, (6, 3, 3)), rng.normal(0, 1, (2, 3, 3)) * (30, 30, 30)
    return model, camera, np.concatenate([small, large]).astype(np.float32)


def check(found, wanted, name):
    """That two pictures of a pass are the same within the bounds."""
    a, b = (np.nan_to_num(each[name].astype(np.float64), posinf=-1.0) for each in (found, wanted))
    difference = np.abs(a - b) / np.maximum(np.abs(b), 1)
    far = difference > CLOSE
    assert far.mean() <= FEW, (name, far.mean(), difference.max())
    assert np.where(far, 0, difference).mean() <= MEAN, name


@pytest.mark.parametrize("seed", [0, 1, 2, 4])
def test_holdouts_and_sorting_by_pixel_agree_with_the_oracle(gpu, adapter, seed):
    """Alone and together: colour, alpha, what triangles stop, depths, and without triangles (with them the oracle lets each point of a
    pixel end for itself) the number of splats."""
    model, camera, triangles = scene(seed, orthographic=seed % 3 == 2)
    passes = ("rgb", "alpha", "holdout", "depth", "median_depth", "first_depth", "count")
    plain = fg.render(model, camera, 0.4, backend=f"gpu:{adapter.name}")
    for number, (meshes, sorting) in enumerate(((triangles, "centre"), (None, "pixel"), (triangles, "pixel"))):
        given = {"passes": passes, "holdout": meshes, "settings": PassSettings(sorting=sorting)}
        found, wanted = (fg.render(model, camera, 0.4, backend=name, **given) for name in (f"gpu:{adapter.name}", "reference"))
        for name in passes[:-1] if meshes is not None else passes:
            check(found, wanted, name)
        assert meshes is None or 0.05 < found["holdout"].mean() < 1, "triangles hide something"
        assert number == 1 or np.abs(found["alpha"] - plain["alpha"]).max() > 0.1
    again = fg.render(model, camera, 0.4, backend=f"gpu:{adapter.name}", **given)
    assert all(np.array_equal(found[name], again[name]) for name in passes)


def test_long_lists_are_sorted_in_each_pixel_too(gpu, adapter):
    """Some hundred faint, tilted sheets before each pixel: a pixel goes through its list several times."""
    rng = np.random.default_rng(9)
    n = 400
    model = fg.GaussianModel(position=rng.normal(0, 0.3, (n, 3)), rotation=rng.normal(size=(n, 4)), scale=np.log([[0.5, 0.5, 0.01]] * n),
                             opacity=np.full(n, -3.5), features=rng.uniform(0, 1, (n, 3)))
    camera = fg.Camera(24, 20, 20, 20, 12, 10, random_pose(rng, 3.0))
    given = {"passes": ("rgb", "alpha", "median_depth", "count"), "settings": PassSettings(sorting="pixel")}
    found, wanted = (fg.render(model, camera, backend=name, **given) for name in (f"gpu:{adapter.name}", "reference"))
    assert wanted["count"].max() > 60, "more than are kept at a time"
    for name in given["passes"]:
        check(found, wanted, name)
    unsorted = fg.render(model, camera, passes=("rgb",), backend=f"gpu:{adapter.name}")["rgb"]
    assert np.abs(unsorted - wanted["rgb"]).max() > 0.01


@pytest.mark.parametrize("orthographic", [False, True])
def test_surfaces_are_the_cpus(gpu, fresh, monkeypatch, orthographic):
    """The depth of the nearest triangle; in strips too, where buffers are small."""
    _, camera, triangles = scene(4, orthographic)
    wanted, found = (np.array(backend.surface(triangles, camera)) for backend in (load_backend("cpu"), gpu))
    both = np.isfinite(wanted) & np.isfinite(found)
    assert (np.isfinite(wanted) != np.isfinite(found)).mean() < 0.002 and both.any() and not both.all()
    assert (np.abs(found[both] - wanted[both]) > 1e-3 * wanted[both]).mean() < 0.002
    fresh.backend.device.binding = 1 << 16
    strips = []
    monkeypatch.setattr(holdout.Occluder, "cover", lambda *given, one=holdout.Occluder.cover: strips.append(given) or one(*given))
    assert np.array_equal(fresh.backend.surface(triangles, camera), found) and len(strips) == 3
    assert not np.isfinite(gpu.surface(triangles[:0], camera)).any()


def test_shadows_and_a_holdout_alone_are_the_cpus(gpu, adapter):
    """A ball's shadow on the ground; and a picture in which there is nothing but triangles."""
    camera = fg.Camera(48, 32, 40, 40, 24, 16, np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 8], [0, 0, 0, 1.0]]))
    ball = fg.GaussianModel(position=[[1, 0.5, 2]], rotation=[[1, 0, 0, 0]], scale=np.log([[0.3] * 3]), opacity=[2.0], features=[[0.5] * 3])
    ground = np.array([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], np.float32)[[[0, 1, 2], [0, 2, 3]]]
    settings = PassSettings(shadows=(Shadow(Light.sun((1, 0, 1)), ground, size=96),))
    found, wanted = (fg.render(ball, camera, passes=("shadow",), backend=name, settings=settings)
                     for name in (f"gpu:{adapter.name}", "cpu"))
    assert wanted["shadow"].min() < 0.5 < wanted["shadow"].max()
    check(found, wanted, "shadow")
    found = fg.render([], camera, passes=("alpha", "holdout"), backend=f"gpu:{adapter.name}", holdout=ground[:1])
    assert not found["alpha"].any() and found["holdout"][0, -1] != found["holdout"][-1, 0]


@pytest.mark.slow
def test_triangles_alone_leave_no_alpha_where_a_gpu_divides_roughly(fresh, monkeypatch):
    """NVIDIA's quotients are up to 2.5 units off in the last place; then depth = sum / alpha had values where nothing was."""
    source = shaders.source
    monkeypatch.setattr(shaders, "source", lambda *given, **constants: source(*given, **constants).replace(
        "/ f32(POINTS - taken)", "* (0.9999999 / f32(POINTS - taken))"))
    fresh.backend.device._pipelines = {}
    model, camera, triangles = scene(0, orthographic=False)
    for settings in (PassSettings(), PassSettings(sorting="pixel")):
        found = fg.render([], camera, passes=("alpha", "depth"), backend=fresh.name, holdout=triangles, settings=settings)
        assert not found["alpha"].any() and np.isinf(found["depth"]).all()
    found = fg.render(model, camera, 0.4, passes=("depth",), backend=fresh.name, holdout=triangles)
    check(found, fg.render(model, camera, 0.4, passes=("depth",), backend="cpu", holdout=triangles), "depth")

# SPDX-License-Identifier: GPL-3.0-or-later
"""What a Python program gets wrong is told in one sentence, which says what is wanted."""
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fastgs_blender as fg

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
EYE = np.eye(4)
QUAD = np.tile(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), (2, 1, 1))
FACES = np.array([[0, 1, 2], [1, 3, 2]])


def camera(*changes, **named):
    values = dict(width=64, height=48, fx=50, fy=50, cx=32, cy=24, world_to_camera=EYE)
    return fg.Camera(**{**values, **named})


@pytest.fixture(scope="module")
def model():
    return fg.GaussianModel(np.zeros((1, 3)), np.ones((1, 4)), np.zeros((1, 3)), np.ones(1), np.ones((1, 3)))


RENDERS = [
    (lambda m, c: fg.render(None, c), "model.*None"), (lambda m, c: fg.render("a.ply", c), r"fg\.load.*not 'a\.ply'"),
    (lambda m, c: fg.render(Path("a.ply"), c), "PosixPath|WindowsPath"),
    (lambda m, c: fg.render([m], c), ".model, placement"), (lambda m, c: fg.render([(m, EYE)], c), ".model, placement"),
    (lambda m, c: fg.render([(m, np.eye(3), 0)], c), "4 x 4"), (lambda m, c: fg.render([(m, "here", 0)], c), "placement.*numbers"),
    (lambda m, c: fg.render(m, None), "Camera.*None"), (lambda m, c: fg.render(m, c, None), "finite.*None"),
    (lambda m, c: fg.render(m, c, "0.5"), "finite.*'0.5'"), (lambda m, c: fg.render(m, c, np.nan), "finite.*nan"),
    (lambda m, c: fg.render(m, c, passes="rgb"), r'list.*\["rgb"\].* .rgb'),
    (lambda m, c: fg.render(m, c, passes=None), "list.*None"), (lambda m, c: fg.render(m, c, passes=["rgb", "wet"]), "'wet'"),
    (lambda m, c: fg.render(m, c, backend=3), "backend 3"), (lambda m, c: fg.slice_model(None, 0), "model.*None"),
    (lambda m, c: fg.slice_model(m, None), "finite.*None"), (lambda m, c: fg.freeze("x", 0), "'x'"),
]
MAKES = [
    (lambda: camera(width=64.5), "width.*whole.*64.5"), (lambda: camera(height=None), "height.*None"),
    (lambda: camera(width=0), "1 x 1 .*0 x 48"), (lambda: camera(width=np.inf), "width.*inf"),
    (lambda: camera(fx="wide"), "fx.*'wide'"),
    (lambda: camera(fy=0), "not be 0"), (lambda: camera(world_to_camera=np.eye(3)), "4 x 4"),
    (lambda: camera(world_to_camera=np.zeros((4, 4))), "directions"),
    (lambda: camera(world_to_camera="eye"), r"\(4, 4\).*'eye'"), (lambda: camera(window=(1, 2)), r"\(x, y, width, height\)"),
    (lambda: camera(window=(0, 0, 65, 2)), "window.*within"),
    (lambda: fg.Fourier(-1), "order.*from 0 to .*-1"), (lambda: fg.Fourier(2, "a"), "scale.*offset"),
    (lambda: fg.Cosine(None), "not None"),
    (lambda: fg.Polynomial(1.5), "not 1.5"), (lambda: fg.Keyframes(("a", "b")), "keyframe times"),
    (lambda: fg.Keyframes((1, 0)), "increase"), (lambda: fg.Keyframes(1), "shape"),
    (lambda: fg.SH(9), "not 9"), (lambda: fg.Clip(0), "frame_count 0, fps 30"), (lambda: fg.Raster(blur=-1), "blur -1"),
    (lambda: fg.GaussianModel("a", 1, 2, 3, 4), r"position.*shape"),
    (lambda: fg.GaussianModel([["a", "b", "c"]], np.ones((1, 4)), np.zeros((1, 3)), np.ones(1), np.ones((1, 3))), "numbers"),
    (lambda: fg.save(None, "a.ply"), "no GaussianModel"),
    (lambda: fg.bake(None, FACES), r"\(times, vertices, 3\)"),
    (lambda: fg.bake([[1], [1, 2]], FACES), r"\(times, vertices, 3\).*list"),
    (lambda: fg.bake(QUAD, None), r"\(triangles, 3\)"),
    (lambda: fg.bake(QUAD, FACES, count="many"), "Gaussians.*'many'"),
    (lambda: fg.bake(QUAD, FACES, tolerance=None), "tolerance.*None"), (lambda: fg.bake(QUAD, FACES, frames="a"), "frames"),
    (lambda: fg.bake(QUAD, FACES, frame_count=0), "frames.* 0"), (lambda: fg.bake(QUAD, FACES, basis="x"), "'x'"),
    *[(lambda colours=colours: fg.bake(QUAD, FACES, colours), r"\(3,\) or \(4,\) for all, \(triangles, 3 or 4\)" + more)
      for colours, more in ((np.zeros((5, 3)), r".*shape \(5, 3\).*2 triangles"), ((1, 2), r".*shape \(2,\)"), ("red", ".*'red'"),
                            ((0, np.nan, 0), ""))],
    (lambda: fg.bake(QUAD, FACES, lambda triangle, weights: np.zeros(3)), "colours.*shape"),
    (lambda: fg.bake(QUAD[:1], FACES, basis="x"), "'x'"),
    (lambda: fg.save_cameras([1], "c.json"), "cameras.* 1"),
    (lambda: fg.save_cameras(camera(), "c.json"), "list.*a Camera"),
    (lambda: fg.find_offsets("films"), "Capture.*'films'"), (lambda: fg.write_clocks("films", None), "Clocks.*None"),
    (lambda: fg.Backdrop(None), "3 finite numbers"),
    (lambda: fg.orbit([], 3), "camera move"), (lambda: fg.through([camera()] * 2, 0), "from 1 to"),
    (lambda: fg.train(None, "run"), "name.*capture"),
    (lambda: fg.evaluate("a.ply", None), "'a.ply' and None"),
]


@pytest.mark.parametrize(("call", "words"), RENDERS)
def test_render(model, call, words):
    with pytest.raises(fg.FastGSError, match=words) as told:
        call(model, camera())
    assert str(told.value).endswith(".") and "\n" not in str(told.value)


@pytest.mark.slow
@pytest.mark.parametrize(("call", "words"), MAKES)
def test_everything_else(tmp_path, monkeypatch, call, words):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(fg.FastGSError, match=words) as told:
        call()
    assert str(told.value).endswith(".") and "\n" not in str(told.value) and "{" not in str(told.value)


def test_numbers_of_numpy_are_numbers():
    made = camera(width=np.int32(64), height=48.0, fx=np.float32(50), window=np.array([0, 0, 4, 4]))
    assert (made.width, made.height, made.window) == (64, 48, (0, 0, 4, 4)) and type(made.height) is int

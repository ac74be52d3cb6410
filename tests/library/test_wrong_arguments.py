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
    (lambda m, c: fg.render(None, c), "needs a model.*not None"), (lambda m, c: fg.render("a.ply", c), r"fg\.load.*not 'a\.ply'"),
    (lambda m, c: fg.render(Path("a.ply"), c), "not a PosixPath|not a WindowsPath"),
    (lambda m, c: fg.render([m], c), "given as .model, placement"), (lambda m, c: fg.render([(m, EYE)], c), "given as .model, placement"),
    (lambda m, c: fg.render([(m, np.eye(3), 0)], c), "4 x 4"), (lambda m, c: fg.render([(m, "here", 0)], c), "placement must be numbers"),
    (lambda m, c: fg.render(m, None), "needs a Camera.*not None"), (lambda m, c: fg.render(m, c, None), "finite number, not None"),
    (lambda m, c: fg.render(m, c, "0.5"), "finite number, not '0.5'"), (lambda m, c: fg.render(m, c, np.nan), "finite number, not nan"),
    (lambda m, c: fg.render(m, c, passes="rgb"), r'list of names, such as \["rgb"\], not .rgb'),
    (lambda m, c: fg.render(m, c, passes=None), "list of names"), (lambda m, c: fg.render(m, c, passes=["rgb", "wet"]), "'wet' is unknown"),
    (lambda m, c: fg.render(m, c, backend=3), "backend 3 is unknown"), (lambda m, c: fg.slice_model(None, 0), "a model is wanted"),
    (lambda m, c: fg.slice_model(m, None), "finite number, not None"), (lambda m, c: fg.freeze("x", 0), "not 'x'"),
]
MAKES = [
    (lambda: camera(width=64.5), "width in pixels must be a whole number, not 64.5"), (lambda: camera(height=None), "height.*not None"),
    (lambda: camera(width=0), "1 x 1 pixel, not 0 x 48"), (lambda: camera(width=np.inf), "width.*not inf"),
    (lambda: camera(fx="wide"), "fx.*'wide'"),
    (lambda: camera(fy=0), "must not be 0"), (lambda: camera(world_to_camera=np.eye(3)), "4 x 4"),
    (lambda: camera(world_to_camera="eye"), r"of the shape \(4, 4\), not 'eye'"), (lambda: camera(window=(1, 2)), "window must be"),
    (lambda: camera(window=(0, 0, 65, 2)), "does not lie within"),
    (lambda: fg.Fourier(-1), "order.*from 0 to .*not -1"), (lambda: fg.Fourier(2, "a"), "scale and offset"),
    (lambda: fg.Cosine(None), "not None"),
    (lambda: fg.Polynomial(1.5), "not 1.5"), (lambda: fg.Keyframes(("a", "b")), "keyframe times"),
    (lambda: fg.Keyframes((1, 0)), "increase"), (lambda: fg.Keyframes(1), "shape"),
    (lambda: fg.SH(9), "not 9"), (lambda: fg.Clip(0), "frame_count 0, fps 30"), (lambda: fg.Raster(blur=-1), "blur -1"),
    (lambda: fg.GaussianModel("a", 1, 2, 3, 4), r"position must have the shape"),
    (lambda: fg.GaussianModel([["a", "b", "c"]], np.ones((1, 4)), np.zeros((1, 3)), np.ones(1), np.ones((1, 3))), "must be numbers"),
    (lambda: fg.save(None, "a.ply"), "no GaussianModel"),
    (lambda: fg.bake(None, FACES), r"\(times, vertices, 3\)"),
    (lambda: fg.bake([[1], [1, 2]], FACES), r"\(times, vertices, 3\), not a list"),
    (lambda: fg.bake(QUAD, None), r"\(triangles, 3\)"),
    (lambda: fg.bake(QUAD, FACES, count="many"), "number of Gaussians.*'many'"),
    (lambda: fg.bake(QUAD, FACES, tolerance=None), "tolerance.*not None"), (lambda: fg.bake(QUAD, FACES, frames="a"), "frames"),
    (lambda: fg.bake(QUAD, FACES, frame_count=0), "frames of the clip.*not 0"), (lambda: fg.bake(QUAD, FACES, basis="x"), "'x'"),
    *[(lambda colours=colours: fg.bake(QUAD, FACES, colours), r"\(3,\) or \(4,\) for all, \(triangles, 3 or 4\)" + more)
      for colours, more in ((np.zeros((5, 3)), r".*shape \(5, 3\).*2 triangles"), ((1, 2), r".*shape \(2,\)"), ("red", ".*'red'"),
                            ((0, np.nan, 0), ""))],
    (lambda: fg.bake(QUAD, FACES, lambda triangle, weights: np.zeros(3)), "the function of colours must give the shape"),
    (lambda: fg.bake(QUAD[:1], FACES, basis="x"), "'x'"),
    (lambda: fg.save_cameras([1], "c.json"), "list of cameras.*not from 1"),
    (lambda: fg.save_cameras(camera(), "c.json"), "not from a Camera"),
    (lambda: fg.find_offsets("films"), "of a Capture.*not of 'films'"), (lambda: fg.write_clocks("films", None), "from Clocks.*None"),
    (lambda: fg.Backdrop(None), "3 finite numbers"),
    (lambda: fg.orbit([], 3), "needs a camera"), (lambda: fg.through([camera()] * 2, 0), "from 1 to"),
    (lambda: fg.train(None, "run"), "name the capture"),
    (lambda: fg.evaluate("a.ply", None), "not 'a.ply' and None"),
]


@pytest.mark.parametrize(("call", "words"), RENDERS)
def test_render(model, call, words):
    with pytest.raises(fg.FastGSError, match=words) as told:
        call(model, camera())
    assert str(told.value).endswith(".") and "\n" not in str(told.value)


@pytest.mark.parametrize(("call", "words"), MAKES)
def test_everything_else(tmp_path, monkeypatch, call, words):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(fg.FastGSError, match=words) as told:
        call()
    assert str(told.value).endswith(".") and "\n" not in str(told.value) and "{" not in str(told.value)


def test_numbers_of_numpy_are_numbers():
    made = camera(width=np.int32(64), height=48.0, fx=np.float32(50), window=np.array([0, 0, 4, 4]))
    assert (made.width, made.height, made.window) == (64, 48, (0, 0, 4, 4)) and type(made.height) is int

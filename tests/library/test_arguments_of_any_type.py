# SPDX-License-Identifier: GPL-3.0-or-later
"""Arguments of any type to the public face: each ends in one sentence, or in a result.  test_wrong_arguments.py has the words."""
from __future__ import annotations

import inspect
import warnings
from dataclasses import fields, is_dataclass
from functools import partial

import numpy as np
import pytest

import fastgs_blender as fg

WRONG = (None, [], [1, 2], "x", "", 3, 3.5, -1, float("nan"), float("inf"), np.zeros(3), np.zeros((2, 2, 2)), np.array(["a"]), object(), {},
         True, np.array([None]), b"x", np.zeros((0, 3)), 10**30, 10**400, 1j)
POSITIONS = np.tile(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), (3, 1, 1))
FLAT = dict(position=np.zeros((3, 3)), rotation=np.ones((3, 4)), scale=np.zeros((3, 3)), opacity=np.zeros(3), features=np.zeros((3, 3)))
CAMERA = dict(width=8, height=6, fx=5.0, fy=5.0, cx=4.0, cy=3.0, world_to_camera=np.eye(4))


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """Of each public function and class the arguments that are right, each of which is replaced by wrong ones in turn."""
    folder = tmp_path_factory.mktemp("arguments")
    model, camera = fg.GaussianModel(**FLAT), fg.Camera(**CAMERA)
    fg.save(model, folder / "model.ply")
    fg.save_cameras([camera], folder / "cameras.json")
    path = {"path": folder / "model.ply"}
    nothing = fg.Capture(folder, "none", [], fg.Clip())
    functions = dict(
        bake=dict(positions=POSITIONS, triangles=[[0, 1, 2], [1, 3, 2]], count=5), check={"path": folder},
        dolly=dict(camera=camera, frames=4, distance=1.0), evaluate=dict(model=model, capture=nothing), find_offsets=dict(capture=nothing),
        freeze=dict(model=model, t=0.0), load=path, load_cameras={"path": folder / "cameras.json"}, open_capture={"path": folder},
        open_source=path, orbit=dict(cameras=[camera], frames=4, distance=1.0),
        render=dict(model=model, camera=camera, backend="reference"), save=dict(model=model, path=folder / "other.ply"),
        save_cameras=dict(views=[camera], path=folder / "cameras.json"), slice_model=dict(model=model, t=0.0),
        through=dict(cameras=[camera, camera], frames=4), train=dict(capture="/nowhere", out=folder / "run"),
        write_clocks=dict(capture=folder, clocks=None))
    classes = dict(
        Backdrop=dict(centre=(0, 0, 0), radius=1.0), Camera=CAMERA, GaussianModel=FLAT,
        Viewpoint=dict(width=8, height=6, fx=5.0, fy=5.0, cx=4.0, cy=3.0, position=(0, 0, 0), distance=1.0))
    return functions | classes


MADE_ELSEWHERE = {"BakeReport", "Capture", "CheckReport", "Clocks", "Slice", "View"}
"""Classes of which programs are given objects, or make them of what they were given; nothing is computed while they are made."""


def parts(name):
    what = getattr(fg, name)
    if inspect.isfunction(what):
        return [key for key, p in inspect.signature(what).parameters.items() if p.kind is not p.VAR_KEYWORD]
    return [field.name for field in fields(what) if field.init]


CALLED = [name for name in fg.__all__ if name not in MADE_ELSEWHERE and (
    inspect.isfunction(getattr(fg, name)) or is_dataclass(getattr(fg, name)))]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", CALLED)
def test_a_wrong_argument_is_told_in_a_sentence(name, good, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # "x" is a good name of a file
    given, odd = good.get(name, {}), []
    for key in parts(name):
        for wrong in WRONG:
            odd += _told(name, key, wrong, partial(getattr(fg, name), **{**given, key: wrong}))
    assert not odd


METHODS = {
    "take": lambda model, camera, wrong: model.take(wrong), "moment": lambda model, camera, wrong: model.moment(wrong),
    "rays": lambda model, camera, wrong: camera.rays(wrong),
}


@pytest.mark.parametrize("name", METHODS)
def test_so_is_a_method_s(name):
    model, camera = fg.GaussianModel(**FLAT), fg.Camera(**CAMERA)
    assert not [text for wrong in WRONG for text in _told(name, "argument", wrong, lambda wrong=wrong: METHODS[name](model, camera, wrong))]


def _told(name, key, wrong, call) -> list[str]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            call()
    except fg.FastGSError as error:
        return [] if str(error).rstrip().endswith((".", ")")) else [f"{name} {key}: no sentence: {error}"]
    except Exception as error:  # noqa: BLE001 (whatever else it is, it is wrong)
        return [f"{name} {key}={wrong!r:.30}: {type(error).__name__}: {error}"]
    return []


def test_several_results_have_names():
    """And are unpacked like a tuple."""
    model, report = baked = fg.bake(POSITIONS, [[0, 1, 2], [1, 3, 2]], count=20)
    assert baked.model is model and baked.report is report
    rays = fg.Camera(**CAMERA).rays(np.eye(4))
    assert rays.centre.shape == (3,) and rays.directions.shape == (6, 8, 3)
    span = fg.Radial().span(np.ones(2), np.zeros(2), np.zeros((2, 1)))
    assert (span.begin < span.end).all()

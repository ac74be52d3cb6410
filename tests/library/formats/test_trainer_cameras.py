# SPDX-License-Identifier: GPL-3.0-or-later
"""cameras.json beside the cfg_args of a trainer of the INRIA family, written here as its camera_to_JSON() does."""
from __future__ import annotations

import json
import math
from dataclasses import replace

import mutations
import numpy as np
import pytest
from random_cameras import random_pose
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.cameras.viewpoints import camera_of

WIDTH, HEIGHT, ANGLE = 5187, 3361, 0.9


@pytest.fixture
def poses(rng):
    """World to camera."""
    return [random_pose(rng, 3.0) for _ in range(5)]


@pytest.fixture
def ply(tmp_path, rng, poses):
    """<model>/point_cloud/iteration_7/point_cloud.ply with its cameras.json; settings are written by said()."""
    entries = []
    focal = WIDTH / (2 * math.tan(ANGLE / 2))
    for i, pose in enumerate(poses):
        place = np.linalg.inv(pose)
        entries.append({"id": i, "img_name": f"DSC{i:05}", "width": WIDTH, "height": HEIGHT, "position": place[:3, 3].tolist(),
                        "rotation": place[:3, :3].tolist(), "fy": focal, "fx": focal})
    (tmp_path / "cameras.json").write_text(json.dumps(entries))
    file = tmp_path / "point_cloud" / "iteration_7" / "point_cloud.ply"
    file.parent.mkdir(parents=True)
    fg.save(random_model(rng, 8, appearance="sh1"), file)
    return file


def said(ply, **settings):
    (ply.parents[2] / "cfg_args").write_text(f"Namespace({', '.join(f'{key}={value!r}' for key, value in settings.items())})")


@pytest.mark.parametrize(("images", "resolution", "width"), [
    ("images", -1, 1600), ("images_4", -1, 1297), ("images_2", -1, 1600), ("images", 8, 648), ("images_4", 1, 1297), ("images", 1, 5187),
    ("images", 1000, 1000), (None, None, 1600)])
def test_a_model_knows_the_cameras_that_lie_beside_it(ply, poses, images, resolution, width):
    """At the size that the trainer gave its pictures: the same angle of view in so many pixels."""
    said(ply, **{key: value for key, value in (("images", images), ("resolution", resolution), ("sh_degree", 1)) if value is not None})
    for model in (fg.load(ply), fg.open_source(ply)):
        found = model.surroundings.cameras
        assert [view.name for view in found] == [f"DSC{i:05}" for i in range(5)]
        for view, pose in zip(found, poses):
            camera = camera_of(view)
            np.testing.assert_allclose(camera.world_to_camera, pose, atol=1e-6)
            assert camera.width == width and abs(camera.height - width * HEIGHT / WIDTH) <= 0.5
            assert 2 * math.atan(width / 2 / camera.fx) == pytest.approx(ANGLE)


def test_pictures_of_another_size_follow_them(ply, poses):
    """Not those at the size of the training, whose bytes stay."""
    said(ply, images="images", resolution=100)
    model = fg.load(ply)
    camera = camera_of(model.surroundings.cameras[0])
    for size, same in ((100, True), (50, False), (200, False)):
        eye = camera.stretched(size, round(size * HEIGHT / WIDTH))
        one, other = (fg.render([fg.Instance(model, np.eye(4), 0.0, fg.ObjectSettings(antialias=on))], eye)["rgb"] for on in (True, False))
        assert np.array_equal(one, other) == same


def test_what_a_file_itself_knows_goes_first(ply, tmp_path, poses):
    said(ply, resolution=-1)
    own = fg.load(ply)
    (ply.parents[2] / "cfg_args").unlink()
    assert not fg.load(ply).surroundings.cameras, "without settings nobody knows how large the pictures were"
    said(ply, resolution=4)
    fg.save(own, ply.parent / "own.safetensors")
    assert fg.load(ply.parent / "own.safetensors").surroundings == own.surroundings != fg.load(ply).surroundings


@pytest.mark.parametrize("name", ["edited.ply", "point_cloud.spz"])
def test_other_files_in_the_folder_may_have_been_moved(ply, name):
    said(ply, resolution=-1)
    fg.save(replace(fg.load(ply), surroundings=fg.Surroundings()), ply.parent / name)
    assert not fg.load(ply.parent / name).surroundings.cameras


@pytest.mark.parametrize(("name", "content"), [
    ("cameras.json", "[{"), ("cameras.json", '{"format": "fast-gs capture"}'), ("cfg_args", "what?")])
def test_damaged_files_beside_a_model_cost_its_cameras_alone(ply, name, content):
    said(ply, resolution=-1)
    (ply.parents[2] / name).write_text(content)
    with pytest.warns(fg.LossWarning, match=rf"{name}.*point_cloud\.ply"):
        model = fg.load(ply)
    assert len(model) == 8 and not model.surroundings.cameras


def test_mutated_files_beside_a_model(ply, tmp_path):
    """Whatever they say, the model is read, and drawn by the first camera."""
    said(ply, images="images_4", resolution=-1)
    root = ply.parents[2]
    files = {path.relative_to(root).as_posix(): path.read_bytes() for path in (ply, root / "cfg_args", root / "cameras.json")}

    def read(folder):
        model = fg.load(folder / "point_cloud" / "iteration_7" / "point_cloud.ply")
        assert len(model) == 8
        for view in model.surroundings.cameras[:1]:
            picture = fg.render(model, camera_of(view).stretched(32, 24))
            assert np.isfinite(picture["rgb"]).all()

    mutations.campaign("trainer cameras", read, {"model": files}, tmp_path / "seeds", fixed=[ply.relative_to(root).as_posix()])

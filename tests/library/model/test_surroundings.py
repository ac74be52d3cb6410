# SPDX-License-Identifier: GPL-3.0-or-later
"""What a file knows besides its Gaussians: the backdrop, which is drawn from inside only, the capture's cameras, a good view."""
from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from random_models import random_model
from toy_captures import write_capture

import fastgs_blender as fg
from fastgs_blender.cameras.poses import look_at
from fastgs_blender.cameras.viewpoints import camera_of, viewpoint_of
from fastgs_blender.cli import main
from fastgs_blender.formats.annotate import annotate
from fastgs_blender.formats.scenes import placed
from fastgs_blender.model.framing import focus_sphere, in_ball, is_subject, without_backdrop
from fastgs_blender.model.surroundings import MOST_CAMERAS, Backdrop, Surroundings, Viewpoint, together
from fastgs_blender.rendering import visibility
from fastgs_blender.rendering.instances import Instance, ObjectSettings

RADIUS = 6.0


def camera(away: float, name: str = "") -> fg.Camera:
    """A camera so far from the middle, which it looks at."""
    return fg.Camera(48, 40, 40, 40, 24, 20, look_at(np.array([0.6, -0.8, 0.0]) * away, np.zeros(3)))


@pytest.fixture(scope="module")
def model():
    """60 Gaussians in the middle that move, and 200 large ones on a sphere around them; some of these move through the middle."""
    rng = np.random.default_rng(3)
    model = random_model(rng, 260, "line", temporal="radial", size=0.1, motion=0.2)
    out = rng.normal(size=(200, 3))
    model.position[60:] = out / np.linalg.norm(out, axis=1, keepdims=True) * 1.1 * RADIUS
    model.scale[60:] = np.log(0.4)
    model.motion[60:80, 0] = -model.position[60:80]
    return replace(model, surroundings=Surroundings(Backdrop((0, 0, 0), RADIUS)))


@pytest.mark.parametrize("backend", ["cpu", "reference"])
@pytest.mark.parametrize(("shown", "away", "whole"), [
    ("INSIDE", 3.0, True), ("INSIDE", 7.0, False), ("SHOWN", 7.0, True), ("HIDDEN", 3.0, False)])
def test_a_backdrop_is_drawn_from_inside_only(model, backend, shown, away, whole):
    placement = np.diag([2.0, 2.0, 2.0, 1.0])  # the sphere is the model's: it grows with the object
    eye, settings = camera(2 * away), ObjectSettings(backdrop=shown)
    left = replace(model if whole else model.take(np.s_[:60]), surroundings=Surroundings())
    wanted = fg.render([Instance(left, placement, 0.6)], eye, passes=("rgb", "alpha", "depth"), backend=backend)
    got = fg.render([Instance(model, placement, 0.6, settings)], eye, passes=("rgb", "alpha", "depth"), backend=backend)
    assert wanted["alpha"].max() > 0.2
    for name, image in got.items():
        np.testing.assert_array_equal(image, wanted[name])
    order = visibility.order([Instance(model, placement, 0.6, settings).viewed(eye)], eye, backend=backend)
    np.testing.assert_array_equal(order, visibility.order([Instance(left, placement, 0.6).viewed(eye)], eye, backend=backend))


def test_a_backdrop_is_no_part_of_the_subject(model):
    assert np.array_equal(without_backdrop(model).position, model.position[:60])
    plain = replace(model, surroundings=Surroundings())
    assert without_backdrop(plain) is plain
    strays = np.concatenate([np.random.default_rng(0).normal(size=(300, 3)), np.full((20, 3), 40.0)])
    assert np.array_equal(is_subject(strays), np.arange(320) < 300)


def ring(distance: float, middle=(1.0, 2.0, 3.0), **lens) -> list[Viewpoint]:
    """Twelve cameras around a place, which they look at."""
    lens = {**dict(width=48, height=40, fx=40, fy=40, cx=24, cy=20), **lens}
    angles = np.arange(12) * np.pi / 6
    eyes = np.array(middle) + distance * np.stack([np.cos(angles), np.sin(angles), np.zeros(12)], 1)
    return [viewpoint_of(fg.Camera(**lens, world_to_camera=look_at(eye, np.array(middle))), "", distance) for eye in eyes]


def test_what_cameras_have_whole_in_their_pictures_is_the_subject():
    centre, radius = focus_sphere(ring(5.0))
    assert np.allclose(centre, (1, 2, 3), atol=1e-6) and radius == pytest.approx(5 * np.sin(np.arctan(0.5)), rel=1e-6)
    _, narrow = focus_sphere(ring(5.0, fx=80, fy=80))
    assert narrow == pytest.approx(5 * np.sin(np.arctan(0.25)), rel=1e-6)
    _, aside = focus_sphere(ring(5.0, cx=12))  # less of the left is seen
    assert aside == pytest.approx(5 * np.sin(np.arctan(0.3)), rel=1e-6)
    assert focus_sphere([]) is None and focus_sphere([replace(view, distance=0.0) for view in ring(5.0)]) is None

    places = np.array([(1, 2, 3), (2.5, 2, 3), (1, 2, 9), (8, 2, 3)], np.float32)
    assert np.array_equal(in_ball(places, (centre, radius)), [True, True, False, False])
    assert in_ball(places, None).all()
    beside = in_ball(places + 100, (centre, radius))
    assert beside.all(), "a ball beside everything tells nothing"


def test_only_known_ways_to_show_it(model):
    with pytest.raises(fg.FastGSError, match="INSIDE, SHOWN, HIDDEN"):
        ObjectSettings(backdrop="NEVER")


@pytest.mark.parametrize("name", ["m.safetensors", "m.ply", "m.splatv"])
@pytest.mark.filterwarnings("ignore::fastgs_blender.LossWarning")
def test_files_keep_all_of_it(model, tmp_path, name):
    view = viewpoint_of(camera(4.0), "good", 4.0)
    around = Surroundings(Backdrop((1, 2, 3), 4.5), (view, replace(view, name="other")), view)
    fg.save(replace(model, surroundings=around), tmp_path / name)
    assert fg.load(tmp_path / name).surroundings == around
    back = camera_of(view)
    assert np.allclose(back.world_to_camera, camera(4.0).world_to_camera, atol=1e-6) and (back.width, back.fx) == (48, 40)


def test_files_without_it_are_as_they_were(model, tmp_path):
    fg.save(replace(model, surroundings=Surroundings()), tmp_path / "m.safetensors")
    assert b"surroundings" not in (tmp_path / "m.safetensors").read_bytes()


@pytest.mark.parametrize("wrong", [
    [], {"cameras": {}}, {"cameras": [[]]}, {"backdrop": {"radius": -1.0}}, {"backdrop": {"centre": [0.0]}}, {"backdrop": 3},
    {"view": {"width": 0}}, {"view": {"rotation": [0.0, 0.0, 0.0, 0.0]}}, {"view": {"fx": 0.0}}, {"view": {"distance": -1.0}},
    {"cameras": [{}] * (MOST_CAMERAS + 1)}, {"view": {"position": [1e30, 0.0, 0.0]}}])
def test_what_a_damaged_header_says_is_refused(model, tmp_path, wrong):
    path = tmp_path / "m.safetensors"
    fg.save(model, path)
    data = path.read_bytes()
    size = int.from_bytes(data[:8], "little")
    header = json.loads(data[8:8 + size])
    about = json.loads(header["__metadata__"]["fast-gs"])
    about["model"]["surroundings"] = wrong
    header["__metadata__"]["fast-gs"] = json.dumps(about)
    text = json.dumps(header).encode()
    path.write_bytes(len(text).to_bytes(8, "little") + text + data[8 + size:])
    with pytest.raises(fg.FastGSError, match=r"m\.safetensors"):
        fg.load(path)


def test_parts_of_one_capture_together():
    views = [Viewpoint(name=str(k)) for k in range(100)]
    first = Surroundings(Backdrop(radius=5.0), tuple(views[:60]))
    both = together([first, Surroundings(Backdrop(radius=4.0), tuple(views[40:]), views[7])])
    assert both.backdrop.radius == 4.0 and both.view is views[7]
    moved = Surroundings(Backdrop((9.0, 0.0, 0.0), 4.0), (Viewpoint(position=(9.0, 0.0, 0.0)),))  # a camera that went on its way
    assert together([first, moved]).backdrop is None
    assert together([replace(first, backdrop=Backdrop(radius=12.0)), moved]).backdrop.radius == 12.0
    assert len(both.cameras) == MOST_CAMERAS and (both.cameras[0], both.cameras[-1]) == (views[0], views[99])


def test_they_move_with_the_model(model):
    """What a camera of the file sees is what it saw before the model was turned, moved and scaled, its backdrop left out."""
    turn = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = 3 * turn * np.sign(np.linalg.det(turn)), (1, 2, 3)
    eye = viewpoint_of(camera(3.0), "eye", 3.0)
    still = fg.freeze(replace(model, surroundings=Surroundings(Backdrop((0, 0, 0), RADIUS), (eye,), eye)), 0.0)
    moved = placed(still, place)
    near = replace(still.raster, near=0.0)
    pictures = [fg.render([Instance(replace(each, raster=near), np.eye(4), 0.0, ObjectSettings(backdrop="HIDDEN"))],
                          camera_of(each.surroundings.view))["rgb"] for each in (still, moved)]
    assert np.ptp(pictures[0]) > 0.2
    np.testing.assert_allclose(*pictures, atol=2e-3)
    assert moved.surroundings.cameras[0].distance == pytest.approx(9.0) and moved.surroundings.backdrop.radius == pytest.approx(3 * RADIUS)
    assert placed(still, np.diag([1.0, 2.0, 1.0, 1.0])).surroundings == Surroundings()
    mirrored = placed(still, np.diag([-1.0, 1.0, 1.0, 1.0])).surroundings
    assert mirrored == Surroundings(still.surroundings.backdrop)


def test_the_command_annotates_a_file_in_place(model, tmp_path, capsys):
    path, cameras = tmp_path / "m.safetensors", tmp_path / "cameras.json"
    fg.save(replace(model, surroundings=Surroundings()), path)
    cameras.write_text(json.dumps([{"img_name": "left", "width": 64, "height": 48, "position": [0, -3, 1], "fx": 50, "fy": 50,
                                    "rotation": [[1, 0, 0], [0, 0, 1], [0, -1, 0]]}]))
    assert main(["annotate", str(path), "--backdrop", "0", "0", "0", "6", "--view", str(cameras), "left"]) == 0
    assert "a backdrop, left" in capsys.readouterr().out
    read = fg.load(path)
    assert read.surroundings.backdrop == Backdrop((0, 0, 0), 6) and read.surroundings.view.position == (0, -3, 1)
    assert all(np.array_equal(a, model.arrays[name]) for name, a in read.arrays.items())
    assert main(["annotate", str(path), "--no-backdrop"]) == 0
    assert fg.load(path).surroundings == replace(read.surroundings, backdrop=None)
    assert main(["annotate", str(path)]) == 2
    assert "nothing to store" in capsys.readouterr().err
    with pytest.raises(fg.FastGSError, match=r"m\.ply.*convert"):
        annotate(path, tmp_path / "m.ply", backdrop=None)


def test_the_command_stores_cameras_in_the_size_that_was_trained_on(model, tmp_path, capsys):
    """Half as many pixels are half the focal length, at which far views begin to be antialiased."""
    path, capture = tmp_path / "m.safetensors", str(write_capture(tmp_path / "capture", 1, 3))
    fg.save(model, path)
    stored = []
    for scale in ((), ("--scale", "0.5")):
        assert main(["annotate", str(path), "--capture", capture, *scale]) == 0
        stored.append(fg.load(path).surroundings.cameras)
    for full, half in zip(*stored, strict=True):
        assert full.position == half.position and half.fx == pytest.approx(full.fx / 2) and half.width == full.width / 2
    assert main(["annotate", str(path), "--scale", "0.5"]) == 2
    assert "give --capture as well" in capsys.readouterr().err

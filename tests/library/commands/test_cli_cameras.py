# SPDX-License-Identifier: GPL-3.0-or-later
"""fastgs cameras: from a capture, a model or a camera file to cameras that fastgs render follows."""
from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import tiny_captures
from toy_captures import toy_cameras, write_capture

import fastgs_blender as fg
from fastgs_blender import cli
from fastgs_blender.cameras import flights, poses
from fastgs_blender.commands.sight import sight

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_capture(tmp_path_factory.mktemp("toy") / "capture")


@pytest.fixture
def run(tmp_path, capsys):
    """run(source, *options): the cameras that fastgs cameras writes."""

    def run(source, *options, code=0):
        out = tmp_path / "cameras.json"
        out.unlink(missing_ok=True)
        assert cli.main(["cameras", str(source), "--out", str(out), *map(str, options)]) == code
        return fg.load_cameras(out) if code == 0 else capsys.readouterr().err

    return run


def place(camera) -> np.ndarray:
    return poses.inverse(camera.world_to_camera)[:3, 3]


def test_a_capture_gives_its_cameras(run, capture):
    for source in (capture, capture / "cameras.json"):
        views = run(source)
        assert [view.name for view in views] == [f"cam{i:02}" for i in range(5)]
        for view, truth in zip(views, toy_cameras(5), strict=True):
            np.testing.assert_allclose(view.camera.world_to_camera, truth.world_to_camera, atol=1e-9)
    assert [view.name for view in run(capture, "--views", "cam03,0")] == ["cam03", "cam00"]
    assert run(capture, "--view", "cam01", "--size", "24x18")[0].camera.width == 24


def test_both_kinds_of_cameras_json_are_told_apart_everywhere(run, capture, tmp_path, capsys):
    ours, theirs = capture / "cameras.json", EXAMPLES / "cameras.json"
    assert len(run(ours)) == 5 and len(run(theirs)) == len(fg.load_cameras(theirs))
    with pytest.raises(fg.FastGSError, match="fast-gs capture"):
        fg.load_cameras(ours)
    from fastgs_blender.cameras.paths import load_path

    with pytest.raises(fg.FastGSError, match="cameras.*pictures.*capture"):
        load_path(ours)
    for command in (["train", str(theirs), "--out", str(tmp_path / "run")], ["info", "--layout", "fastgs", str(theirs)]):
        assert cli.main(command) == 2
        said = capsys.readouterr().err
        assert "holds cameras alone" in said or "another program's" in said
    for cameras in (ours, theirs):
        assert cli.main(["bench", "--gaussians", "50", "--size", "16x9", "--repeat", "1", "--camera", str(cameras)]) == 0


def test_an_orbit_goes_around_what_the_cameras_look_at(run, capture):
    start, centre = toy_cameras(5)[0], sight(capture).centre
    path = [view.camera for view in run(capture, "--move", "orbit", "--frames", 8)]
    radius = np.linalg.norm(place(start) - centre)
    assert len(path) == 8
    np.testing.assert_allclose(place(path[0]), place(start), atol=1e-6)
    for camera in path:
        assert np.linalg.norm(place(camera) - centre) == pytest.approx(radius)
        seen = camera.world_to_camera @ np.append(centre, 1)
        assert abs(seen[:2]).max() < 1e-6 and seen[2] == pytest.approx(radius), "it looks at the centre"
        assert camera.world_to_camera[1, :3] @ start.world_to_camera[1, :3] > 0 or camera.world_to_camera[1, 1] > 0
    steps = np.linalg.norm(np.diff([place(camera) for camera in [*path, path[0]]], axis=0), axis=1)
    assert steps == pytest.approx(steps.mean()), "even, and the last frame leads to the first"
    higher = run(capture, "--move", "orbit", "--frames", 3, "--elevation", 60, "--distance", 9, "--turns", "-0.5")
    assert np.linalg.norm(place(higher[1].camera) - centre) == pytest.approx(9)


def test_a_dolly_and_a_path(run, capture):
    first = toy_cameras(5)[0]
    path = [view.camera for view in run(capture, "--move", "dolly", "--view", "cam00", "--frames", 5, "--distance", 1)]
    np.testing.assert_allclose(place(path[-1]) - place(first), poses.inverse(first.world_to_camera)[:3, 2], atol=1e-9)
    zoom = [view.camera for view in run(capture, "--move", "dolly", "--view", "cam00", "--frames", 5, "--zoom")]
    assert zoom[-1].fx < zoom[0].fx == first.fx
    through = [view.camera for view in run(capture, "--move", "path", "--views", "cam01,cam03", "--frames", 6)]
    for end, name in ((0, 1), (-1, 3)):
        np.testing.assert_allclose(through[end].world_to_camera, toy_cameras(5)[name].world_to_camera, atol=1e-6)
    assert len(run(capture, "--move", "path", "--closed")) == 6, "as many frames as the capture"
    assert len(run(capture, "--move", "orbit", "--frames", 1)) == 1


def test_paths_of_other_programs(run, capture, tmp_path):
    out = tmp_path / "path.json"
    assert cli.main(["cameras", str(capture), "--move", "orbit", "--frames", "9", "--format", "nerfstudio", "--out", str(out)]) == 0
    assert "camera_path" in json.loads(out.read_text())
    again = run(out)
    assert len(again) == 9 and np.linalg.norm(place(again[0].camera) - place(toy_cameras(5)[0])) < 1e-4


@pytest.mark.parametrize(("kind", "out"), [("transforms.json", "transforms.json"), ("colmap", "model")])
def test_cameras_without_pictures_are_a_source_too(run, capture, tmp_path, kind, out):
    """What is written beside no pictures, as a data set of another program, is read as cameras."""
    assert cli.main(["cameras", str(capture), "--format", kind, "--out", str(tmp_path / out)]) == 0
    views = run(tmp_path / out)
    assert [view.name for view in views] == [f"cam{i:02}" for i in range(5)]
    for view, truth in zip(views, toy_cameras(5), strict=True):
        np.testing.assert_allclose(view.camera.world_to_camera, truth.world_to_camera, atol=1e-9)


@pytest.mark.parametrize("kind", ["cameras.json", "fastgs", "nerfstudio", "instant-ngp", "supersplat", "transforms.json"])
def test_a_path_under_any_name_is_known_by_its_content(kind, run, capture, tmp_path):
    """Beside a COLMAP model, too, whose files have names of their own; and what cannot be read is said of the file that it is."""
    assert cli.main(["cameras", str(capture), "--format", "colmap", "--out", str(tmp_path / "model")]) == 0
    move = ["--move", "orbit", "--frames", "4", "--format", kind]
    assert cli.main(["cameras", str(capture), *move, "--out", str(tmp_path / "model" / "shot.txt.old")]) == 0
    assert len(run(tmp_path / "model" / "shot.txt.old")) == 4
    (tmp_path / "cut.json").write_text('{"frames": [')
    (tmp_path / "cut.ply").write_text("ply\nformat ascii 1.0\nend_header\n")
    assert "JSON" in run(tmp_path / "cut.json", code=2) and "not a Gaussian model" in run(tmp_path / "cut.ply", code=2)


@pytest.mark.parametrize(("options", "told"), [(["--move", "orbit", "--distance", "4"], True), (["--view", "cam01"], True), ([], False)])
def test_a_lost_frame_rate_is_told(options, told, tmp_path, capsys):
    """As COLMAP does: of a camera that moves, and not of those of a rig."""
    tiny_captures.fastgs(tmp_path)
    (tmp_path / "out").mkdir()
    for kind in ("cameras.json", "colmap"):
        assert cli.main(["cameras", str(tmp_path), *options, "--format", kind, "--out", str(tmp_path / "out" / kind.split(".")[0])]) == 0
        assert ("24 frames a second" in capsys.readouterr().err) == told


def test_frames_of_a_camera_that_moves_have_times(tmp_path):
    tiny_captures.fastgs(tmp_path)
    out = tmp_path / "out" / "transforms.json"
    out.parent.mkdir()
    assert cli.main(["cameras", str(tmp_path), "--view", "cam01", "--size", "32x24", "--format", "transforms.json", "--out", str(out)]) == 0
    values = json.loads(out.read_text())
    assert values["fps"] == 24 and [frame["time"] for frame in values["frames"]] == [0, 0.5]


def test_from_a_model_to_frames_without_a_capture(run, tmp_path):
    views = run(EXAMPLES / "fireside.safetensors", "--move", "orbit", "--frames", 2, "--size", "16x9", "--distance", 4)
    assert len(views) == 2
    assert cli.main(["render", str(EXAMPLES / "fireside.safetensors"), "--camera", str(tmp_path / "cameras.json"), "--frames", "0:1",
                     "--out", str(tmp_path / "frames")]) == 0
    from PIL import Image

    assert np.asarray(Image.open(tmp_path / "frames" / "0001.png"))[..., 3].mean() > 60, "the subject is in the picture"


@pytest.mark.parametrize(("options", "words"), [
    (["--view", "nobody"], "no view 'nobody'"), (["--format", "maya"], "no camera path format"), (["--size", "3"], "WIDTHxHEIGHT"),
    (["--move", "path", "--view", "cam00"], "two cameras"), (["--move", "orbit", "--frames", "-1"], "frames"),
    (["--move", "dolly", "--view", "0", "--zoom", "--distance", "99"], "reach its subject")])
def test_wrong_arguments(run, capture, options, words):
    assert words in run(capture, *options, code=2)


def test_nothing_is_replaced_unless_told(capture, tmp_path, capsys):
    out = tmp_path / "mine.json"
    out.write_text("mine")
    assert cli.main(["cameras", str(capture), "--out", str(out)]) == 2
    assert "--overwrite" in capsys.readouterr().err and out.read_text() == "mine"
    assert cli.main(["cameras", str(capture), "--out", str(out), "--overwrite", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["names"][0] == "cam00"


def test_leaving_the_region_is_told(capture, tmp_path, capsys):
    cli.main(["cameras", str(capture), "--out", str(tmp_path / "a.json"), "--move", "orbit", "--distance", "50"])
    assert "expect holes" in capsys.readouterr().err
    cameras = toy_cameras(5)
    assert flights.outside(flights.through(cameras[:2], 4), cameras).max() < 0.2

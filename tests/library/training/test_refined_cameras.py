# SPDX-License-Identifier: GPL-3.0-or-later
"""Refinement of given poses and focal lengths, on points that a rig on an arc sees with noise."""
from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.cameras.lens import Intrinsics, Lens
from fastgs_blender.cameras.poses import look_at
from fastgs_blender.captures.capture import Capture, Shot
from fastgs_blender.captures.refined import refined
from fastgs_blender.captures.sources import Source
from fastgs_blender.training.core.settings import settings
from fastgs_blender.training.initial import bundle, refine
from fastgs_blender.training.initial.geometry import project, visible
from fastgs_blender.training.run.files import REFINED
from fastgs_blender.training.run.plan import NOTHING, Plan, write
from fastgs_blender.util import rotations

VIEWS, POINTS, NOISE, TURN, FOCAL = 8, 700, 0.2, 0.14, 0.0044
"""Cameras, points, pixels of noise; degrees by which a wrong camera is turned, and by which share its focal length is wrong."""


def arc() -> list[fg.Camera]:
    eyes = [(6 * np.sin(a), -6 * np.cos(a), 1 + 0.5 * (k % 2)) for k, a in enumerate(np.linspace(-0.8, 0.8, VIEWS))]
    return [fg.Camera(480, 360, 500.0, 500.0, 240.0, 180.0, look_at(np.array(eye), np.zeros(3))) for eye in eyes]


def wrong(camera: fg.Camera, number: int) -> fg.Camera:
    """The camera as a poor calibration tells it: turned where it stands, with another focal length."""
    axis = np.random.default_rng([3, number]).normal(size=3)
    pose = camera.world_to_camera.copy()
    turn = rotations.to_matrices(rotations.exp(np.radians(TURN) / 2 * axis / np.linalg.norm(axis)))
    pose[:3] = turn @ pose[:3]
    focal = camera.fx * (1 + FOCAL * (-1) ** number)
    return replace(camera, fx=focal, fy=focal, world_to_camera=pose)


PINHOLE = Lens()


def seen(true, given, lens=PINHOLE) -> bundle.Tracks:
    """Tracks of random points: the true cameras' pictures of them, by the given cameras' focal lengths."""
    rng = np.random.default_rng(5)
    xyz = rng.uniform(-1.7, 1.7, (POINTS, 3))
    rows = []
    for v, (camera, other) in enumerate(zip(true, given)):
        places = project(camera, xyz)[0] + rng.normal(0, NOISE, (POINTS, 2))
        source = lens.distort((places - (camera.cx, camera.cy)) / camera.fx) * camera.fx / other.fx
        plane = lens.undistort(source)
        slopes = refine._by_shrink(Shot("a", 0, other, Source(Path("a"), lens=lens)), plane)
        rows += [(p, v, *plane[p], *slopes[p]) for p in np.flatnonzero(visible(camera, xyz))]
    table = np.array(sorted(rows))
    return bundle.Tracks(table[:, 1].astype(int), table[:, 0].astype(int), table[:, 2:4], table[:, 4:])


def rig(cameras, lenses=None) -> bundle.Rig:
    return refine.rig_of(cameras, lenses or range(VIEWS), [(camera.fx, camera.fy) for camera in cameras])


def off(found: bundle.Rig, true) -> tuple[float, float]:
    """Mean turn in degrees against the true cameras, after the turn that all have in common, and mean error of the focal lengths."""
    turns = bundle.turned(found, rig(true))
    world = np.einsum("vji,vj->vi", found.turns, turns)
    focal = found.pixels[:, 0] / found.shrink / [camera.fx for camera in true] - 1
    return float(np.degrees(np.linalg.norm(world - world.mean(0), axis=1)).mean()), float(np.abs(focal).mean())


@pytest.mark.parametrize("lens", [Lens(), Lens("opencv", (-0.2, 0.05)), Lens("fisheye", (0.02,))], ids=lambda lens: lens.model)
def test_wrong_cameras_are_put_right(lens):
    true = arc()
    given = [wrong(camera, k) for k, camera in enumerate(true)]
    better, before, after, used = refine.compared(rig(given), seen(true, given, lens=lens))
    assert before > 0.8 and after < 0.25 and used.all()
    turn, focal = off(better, true)
    assert turn < 0.25 * off(rig(given), true)[0] and focal < 0.25 * FOCAL
    assert np.abs(better.centres - rig(true).centres).max() < 0.03, "0.5 % of the distance"


def test_wrong_matches_hardly_count():
    true = arc()
    given = [wrong(camera, k) for k, camera in enumerate(true)]
    tracks, rng = seen(true, given), np.random.default_rng(1)
    rays = tracks.rays + (rng.uniform(size=(len(tracks.rays), 1)) < 0.03) * rng.normal(0, 5 / 500, tracks.rays.shape)
    better, before, after, _ = refine.compared(rig(given), replace(tracks, rays=rays, slopes=rays))
    assert after < 0.35 * before and off(better, true)[1] < 0.3 * FOCAL


def test_true_cameras_stay_where_they_are():
    true = arc()
    better, before, after, _ = refine.compared(rig(true), seen(true, true))
    assert after > refine.BETTER * before
    assert off(better, true)[0] < 0.01 and off(better, true)[1] < 5e-4


def test_only_the_camera_that_is_wrong_moves():
    """One camera of eight is turned; the features of tracks that were held back tell which."""
    true = arc()
    given = [wrong(camera, k) if k == 3 else camera for k, camera in enumerate(true)]
    better, _, _, moved = refine.compared(rig(given), seen(true, given))
    away = np.degrees(np.linalg.norm(bundle.turned(better, rig(true)), axis=1))
    assert moved.tolist() == [k == 3 for k in range(VIEWS)] and away[3] < 0.3 * TURN and not np.delete(away, 3).max() > 1e-6


def test_cameras_with_one_lens_have_one_focal_length():
    true = arc()
    given = [replace(wrong(camera, k), fx=camera.fx * (1 + FOCAL), fy=camera.fy * (1 + FOCAL)) for k, camera in enumerate(true)]
    better, _, _, _ = refine.compared(rig(given, [None] * VIEWS), seen(true, given))
    assert len(set(better.shrink)) == 1 and better.shrink[0] > 1, "on an arc, a focal length that all have wrong is hardly seen"
    assert off(better, true)[0] < 0.3 * off(rig(given), true)[0]


def test_too_few_tracks_tell_nothing():
    true = arc()
    tracks = seen(true, true)
    _, before, after, used = refine.compared(rig(true), tracks.take(np.arange(len(tracks)) < 50))
    assert np.isnan([before, after]).all() and not used.any()


def capture_of(cameras, held_out=(), frames=2) -> Capture:
    image = Source(Path("a"), intrinsics=Intrinsics(500.0, 500.0, 240.0, 180.0, 480, 360))
    shots = [Shot(f"cam{v:02}", f, camera, image, None, v in held_out, f / frames)
             for f in range(frames) for v, camera in enumerate(cameras)]
    return Capture(Path("arc"), "test", shots, fg.Clip(frames))


class Given:
    """Stands in for the pictures: refine.tracked() of these tracks, for two moments; asked: moments that were looked at."""

    def __init__(self, monkeypatch, tracks, cameras):
        self.asked = 0

        def tracked(capture, store, settings, views, progress):
            for _ in range(2):
                self.asked += 1
                yield tracks, np.array([(camera.fx, camera.fy) for camera in cameras]), {}

        monkeypatch.setattr(refine, "tracked", tracked)


def test_a_run_keeps_what_was_found(tmp_path, monkeypatch):
    true = arc()
    given = [wrong(camera, k) for k, camera in enumerate(true)]
    pictures, said, path = Given(monkeypatch, seen(true, given), given), [], tmp_path / REFINED
    capture = capture_of(given)
    found = refine.refinement(capture, None, settings(), path, False, said.append)
    assert "8 refined" in said[0] and found["after"] < 0.3 and found["before"] > 0.8
    again = refine.refinement(capture, None, settings(), path, True, said.append)
    assert again == found and pictures.asked == 2 and len(said) == 1 and not found["cameras"].keys() & set(capture.held_out_views)
    better = refined(capture, again["cameras"])
    for shot, camera in zip(better.shots, 2 * true):
        assert shot.camera.fx == pytest.approx(camera.fx, rel=0.3 * FOCAL)
        assert shot.image.intrinsics.fx / 500 == pytest.approx(shot.camera.fx / given[int(shot.view[3:])].fx)
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    apart = [np.linalg.norm(np.subtract(project(a.camera, points)[0], project(b, points)[0]), axis=1).mean()
             for a, b in zip(better.shots, true)]
    assert np.mean(apart) < 0.7 * np.mean([np.linalg.norm(project(a, points)[0] - project(b, points)[0], axis=1).mean()
                                           for a, b in zip(given, true)])
    other = replace(capture, path=Path("another"))
    assert refine.kept(path, other) is None
    path.write_text(json.dumps({**json.loads(path.read_text()), "cameras": {"cam00": {"turn": [0], "shift": [0, 0, 0], "focal": 1}}}))
    with pytest.raises(fg.FastGSError, match="cam00"):
        refine.kept(path, capture)


def test_cameras_that_are_held_out_stay(tmp_path):
    capture = capture_of(arc(), held_out=(3,))
    change = {"turn": [0.01, 0, 0], "shift": [0, 0, 0.1], "focal": 1.01}
    better = refined(capture, {view: change for view in capture.views if view not in capture.held_out_views})
    for before, after in zip(capture.shots, better.shots):
        assert (after.camera is before.camera) == before.held_out
    assert refined(capture, {}) is capture and refined(capture, {"of another capture": change}) is capture
    blind = replace(capture, shots=[replace(shot, camera=None) for shot in capture.shots])
    assert refined(blind, {"cam00": change}).shots == blind.shots


@pytest.mark.parametrize("why", ["true", "moving", "two", "off", "begun", "model", "few"])
def test_what_is_left_alone(why, tmp_path, monkeypatch):
    true = arc()
    given = true if why == "true" else [wrong(camera, k) for k, camera in enumerate(true)]
    tracks = seen(true, given)
    pictures = Given(monkeypatch, tracks.take(np.arange(len(tracks)) < 50) if why == "few" else tracks, given)
    capture, said = capture_of(given), []
    if why == "moving":
        capture.shots[-1] = replace(capture.shots[-1], camera=true[0])
    if why == "two":
        capture = capture_of(given, held_out=range(2, VIEWS))
    if why == "model":
        capture.model = Path("baked.safetensors")
    chosen = settings(poses="off" if why == "off" else "auto")
    found = refine.refinement(capture, None, chosen, tmp_path / REFINED, why == "begun", said.append)
    assert found == refine.NOTHING
    assert (pictures.asked, len(said)) == {"true": (1, 1), "few": (2, 1)}.get(why, (0, 0)), "one moment shows that cameras are right"


def test_a_run_that_starts_again_forgets_it(tmp_path):
    (tmp_path / REFINED).write_text("{}")
    write(tmp_path, Plan(settings(), NOTHING))
    assert not (tmp_path / REFINED).exists()

# SPDX-License-Identifier: GPL-3.0-or-later
"""A scan: photographs of the empty place, trained on beside a capture's films."""
from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toy_captures import MemoryStore, toy_cameras, toy_scene, write_shots

import fastgs_blender as fg
from fastgs_blender.captures.capture import Capture, Shot
from fastgs_blender.captures.scan import with_scan
from fastgs_blender.training.core.schedule import Views, at_a_moment
from fastgs_blender.training.core.settings import Settings
from fastgs_blender.training.core.targets import target
from fastgs_blender.training.initial.visual_hull import VisualHull, hull_of

FRAMES, STILL = 8, 60
PLACE = toy_scene(FRAMES).take(np.arange(STILL))
SUBJECT = toy_scene(FRAMES).take(np.arange(STILL, 80))


def films(chosen=(0, 4, 8)) -> tuple[Capture, MemoryStore]:
    """Films of some of nine cameras; the first of these, cam00, is held out."""
    cameras = toy_cameras(9)
    shots = [Shot(f"cam{k:02}", f, cameras[v], None, None, k == 0, f / FRAMES) for f in range(FRAMES) for k, v in enumerate(chosen)]
    return Capture(Path("films"), "test", shots, toy_scene(FRAMES).clip), MemoryStore(toy_scene(FRAMES), shots)


def photographs() -> tuple[Capture, MemoryStore]:
    """Pictures of the empty place, from places between the films' cameras; the first one is not for training."""
    shots = [Shot(f"cam{v:02}", 0, camera, None, None, v == 0) for v, camera in enumerate(toy_cameras(9))]
    return Capture(Path("scan"), "test", shots, fg.Clip(1, 24.0, 1)), MemoryStore(PLACE, shots)


def test_photographs_join_the_capture_as_shots_of_no_moment():
    capture, scan = films()[0], photographs()[0]
    both = with_scan(capture, scan)
    assert both.films == capture.training
    assert [shot.view for shot in both.scan] == [f"scan/cam{v:02}" for v in range(1, 9)]
    part = both.part(4, 3)
    assert len(part.scan) == 8 and {shot.frame for shot in part.films} == {0, 1, 2}


def test_photographs_are_no_larger_than_the_films_and_share_their_world():
    capture, scan = films()[0], photographs()[0]
    large = replace(scan, axes="RUB", shots=[replace(shot, camera=shot.camera.stretched(480, 360)) for shot in scan.shots])
    joined = with_scan(capture, large).scan[0].camera
    assert (joined.width, joined.height) == (48, 36)
    point = np.array([0.3, 0.2, 0.5])  # in the capture's world; y and z point the other way in the scan's
    np.testing.assert_allclose(joined.pixels(joined.world_to_camera[:3, :3] @ point + joined.world_to_camera[:3, 3]),
                               _pixels(scan.shots[1].camera, point * (1, -1, -1)), atol=1e-9)


def _pixels(camera, point):
    return camera.pixels(camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3])


def test_what_cannot_be_joined_is_refused():
    capture, scan = films()[0], photographs()[0]
    with pytest.raises(fg.FastGSError, match="poses in one"):
        with_scan(capture, replace(scan, shots=[replace(shot, camera=None) for shot in scan.shots]))
    with pytest.raises(fg.FastGSError, match="no pictures"):
        with_scan(capture, replace(scan, shots=[replace(shot, held_out=True) for shot in scan.shots]))


def test_a_share_of_the_steps_sees_the_scan_each_picture_as_often():
    shots = with_scan(films()[0], photographs()[0]).training
    views = Views(shots, 0, 0.25)
    steps = [[shots[k] for k in views.at(i, 2)] for i in range(64)]
    of_scan = [step for step in steps if step[0].place]
    assert len(of_scan) == 16 and all(shot.place for step in of_scan for shot in step)
    counts = [sum(shot is photo for step in of_scan for shot in step) for photo in shots if photo.place]
    assert set(counts) == {4}
    films_alone = Views([shot for shot in shots if not shot.place], 0)
    rest = [step for step in steps if not step[0].place]
    assert [[shot.view for shot in step] for step in rest] == [[shots[k].view for k in films_alone.at(i, 2)] for i in range(48)]


def test_a_photograph_stands_for_any_frame():
    shot = with_scan(films()[0], photographs()[0]).scan[0]
    frames = [at_a_moment(shot, FRAMES, 0, i, 0) for i in range(40)]
    assert {each.frame for each in frames} == set(range(FRAMES))
    assert all(each.t == each.frame / FRAMES for each in frames)


def test_the_hull_holds_what_moves_and_little_else():
    """By the truth: where Gaussians that move are drawn, a photograph does not count; what stands still alone it mostly does."""
    capture, store = films((1, 0, 2, 4, 6, 8))
    hull = VisualHull(capture, store)
    camera, free = photographs()[0].shots[3].camera, []
    for frame in range(FRAMES):
        drawn = fg.render(SUBJECT, camera, frame / FRAMES)["alpha"] > 0.3
        covered = hull.covers(camera, frame)
        assert covered[drawn].mean() > 0.95
        free.append(1 - covered[~drawn].mean())
    assert np.mean(free) > 0.3


def test_no_photograph_counts_where_films_tell_nothing():
    capture, store = films()
    scan, pictures = photographs()
    assert hull_of(capture, store) is None
    said = []
    first = replace(with_scan(capture, scan), shots=[shot for shot in with_scan(capture, scan).shots if shot.frame == 0])
    store.pictures |= pictures.pictures
    assert hull_of(first, store, said.append) is None and "starting points" in said[0]


def test_hidden_pixels_have_no_weight():
    capture, store = films()
    shot, hidden = capture.training[0], np.zeros((36, 48), bool)
    hidden[:18] = True
    goal = target(capture, store.pixels(shot), shot, Settings(), 2, 0, hidden=hidden)
    np.testing.assert_array_equal(goal.weight, np.repeat(np.float32([0, 1]), 9)[:, None] * np.ones((1, 24), np.float32))


def test_who_is_in_a_photograph_is_left_out_by_its_mask():
    scan, store = photographs()
    shot = replace(with_scan(films()[0], scan).scan[0], mask="file")
    pixels = replace(store.pixels(scan.shots[1]), mask=np.repeat(np.float32([1, 0.25]), 18)[:, None] * np.ones((1, 48), np.float32))
    goal = target(films()[0], pixels, shot, Settings(), 1, 0)
    np.testing.assert_array_equal(goal.weight, 1 - pixels.mask)


@pytest.mark.slow
def test_a_scan_makes_few_cameras_much_better(tmp_path):
    """Three cameras, of which the middle one is not trained on; eight photographs of the empty place."""
    folders = []
    for name, (capture, store) in {"films": films((4, 0, 8)), "scan": photographs()}.items():
        folders.append(tmp_path / name)
        write_shots(folders[-1], capture, store)
    quality = []
    for scan in (None, folders[1]):
        out = tmp_path / f"run-{len(quality)}"
        fg.train(folders[0], out, scan=scan, iterations=400, init="random", init_points=400, max_gaussians=800)
        quality.append(json.loads((out / "report.json").read_text("utf-8"))["held_out_psnr"])
    assert quality[1] > quality[0] + 3, quality

# SPDX-License-Identifier: GPL-3.0-or-later
"""Starting points and poses, on a capture of textured planes: a floor and a wall that stand, a card that moves."""
from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from toy_captures import Pixels, write_capture

import fastgs_blender as fg
from fastgs_blender.cameras.lens import Lens
from fastgs_blender.captures import open_capture
from fastgs_blender.captures.capture import Capture, Points, Shot
from fastgs_blender.training.core.settings import settings
from fastgs_blender.training.core.trainer import Trainer
from fastgs_blender.training.initial import dense
from fastgs_blender.training.initial.calibrate import calibrated, keep, with_poses
from fastgs_blender.training.initial.dense import among_others
from fastgs_blender.training.initial.geometry import visible
from fastgs_blender.training.initial.start import start
from fastgs_blender.training.initial.starting_points import initial_points
from fastgs_blender.util import threads

FRAMES, VIEWS, SIZE = 4, 6, (200, 150)
FLOOR, WALL, CARD_DEPTH, CARD_HALF = 1.0, 3.0, 0.5, 0.45
"""y of the floor (down), z of the wall and of the card, half the card's side."""


def card_x(t):
    return -0.9 + 2.4 * t


@cache
def texture(seed) -> np.ndarray:
    """Smooth noise of three scales [1024, 1024, 3]."""
    rng = np.random.default_rng(seed)
    layers = [np.asarray(Image.fromarray(np.uint8(rng.integers(0, 256, (n, n, 3)))).resize((1024, 1024), Image.Resampling.BICUBIC), float)
              for n in (29, 96, 210)]
    return (layers[0] + layers[1] + layers[2]) / (3 * 255)


def colour(part, u, v) -> np.ndarray:
    """Of places on a plane, which is 12 units wide at most; on the card everything is finer."""
    column, row = (np.floor(x * 1024 / (12 if part < 2 else 5)).astype(int) + 512 for x in (u, v))
    return texture(part)[row, column]


def look(t, camera) -> np.ndarray:
    """The picture [h, w, 3] of the scene, by intersecting rays with its planes, 2 x 2 rays a pixel."""
    width, height = camera.width, camera.height
    doubled = {name: 2 * getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    fine = replace(camera, **doubled, window=None)
    eye, rays = fine.rays(camera.world_to_camera)
    nearest, image = np.full(rays.shape[:2], np.inf), np.zeros(rays.shape)
    for axis, at, across, part, middle, half in ((1, FLOOR, (0, 2), 0, (0, 0), 6.0), (2, WALL, (0, 1), 1, (0, 0), 6.0),
                                                 (2, CARD_DEPTH, (0, 1), 2, (card_x(t), 0.2), CARD_HALF)):
        with np.errstate(divide="ignore"):
            along = (at - eye[axis]) / rays[..., axis]
        u, v = (eye[a] + along * rays[..., a] - m for a, m in zip(across, middle))
        hit = (along > 0) & (along < nearest) & (np.abs(u) < half) & (np.abs(v) < half)
        nearest[hit] = along[hit]
        image[hit] = colour(part, u[hit], v[hit])
    return image.reshape(height, 2, width, 2, 3).mean((1, 3)).astype(np.float32)


def rig() -> list[fg.Camera]:
    cameras = []
    for k, angle in enumerate(np.linspace(-0.55, 0.55, VIEWS)):
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        pose = np.eye(4)
        pose[:3, :3] = turn
        pose[:3, 3] = (0, 0.15 * (k % 2), 3.5)
        cameras.append(fg.Camera(*SIZE, 170.0, 170.0, SIZE[0] / 2, SIZE[1] / 2, pose))
    return cameras


class Store:
    """Pictures of shots by view and frame."""

    def __init__(self, shots, picture=look):
        cameras = dict(zip((f"cam{v:02}" for v in range(VIEWS)), rig()))
        self.pictures = {(shot.view, shot.frame): Pixels(picture(shot.t, cameras[shot.view])) for shot in shots}

    def pixels(self, shot):
        return self.pictures[shot.view, shot.frame]


def shots(posed=True):
    return [Shot(f"cam{v:02}", f, camera if posed else None, None, None, v == 3, f / FRAMES) for f in range(FRAMES)
            for v, camera in enumerate(rig())]


@pytest.fixture(scope="module")
def filmed():
    capture = Capture(Path("planes"), "test", shots(), fg.Clip(FRAMES))
    return capture, Store(capture.shots)


@pytest.fixture(scope="module")
def blank():
    capture = Capture(Path("grey"), "test", shots(), fg.Clip(FRAMES))
    return capture, Store(capture.shots, lambda t, camera: np.full((SIZE[1], SIZE[0], 3), 0.5, np.float32))


@pytest.fixture(scope="module")
def found(filmed):
    said, done = [], []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dense, "FEATURE_PIXELS", SIZE[0] * SIZE[1] / 5)
        points = initial_points(*filmed, settings(init_points=4000), said.append, lambda *ticks: done.append(ticks))[0]
    parts = np.diff([k for k, _ in done])
    assert done[0][0] == 0 and done[-1][0] == done[-1][1] and len(done) > 2 * FRAMES, "progress goes on to its end"
    assert parts[0] == 5 and set(parts[len(dense.chosen_moments(filmed[0])):]) == {1}, "features take longer than other parts"
    return points, said


def off_planes(xyz) -> np.ndarray:
    """Distance to the nearer of floor and wall."""
    return np.minimum(np.abs(xyz[:, 1] - FLOOR), np.abs(xyz[:, 2] - WALL))


@pytest.mark.slow
def test_points_that_stand_lie_on_what_stands(found):
    points, said = found
    still = points.xyz[np.isnan(points.t)]
    assert len(still) > 800
    assert (off_planes(still) < 0.1).mean() > 0.9
    assert "triangulated" in said[-1]
    assert str(len(points) - np.isnan(points.t).sum()) in said[-1]


def test_points_of_a_moment_follow_what_moves(found):
    points, _ = found
    for t in np.arange(FRAMES) / FRAMES:
        timed = points.xyz[points.t == np.float32(t)]
        on_card = (np.abs(timed - (card_x(t), 0.2, CARD_DEPTH)) < (CARD_HALF + 0.1, CARD_HALF + 0.1, 0.1)).all(1)
        assert on_card.sum() > 100
        nearby = np.abs(timed[:, 2] - CARD_DEPTH) < 0.1
        assert (on_card | ~nearby).mean() > 0.95


def test_points_of_a_moment_move_as_what_they_lie_on(found):
    points, _ = found
    on_card = np.isfinite(points.t) & (np.abs(points.xyz[:, 2] - CARD_DEPTH) < 0.1)
    along, *across = np.median(points.velocity[on_card], 0)
    assert 0.4 * (card_x(1) - card_x(0)) < along < 1.1 * (card_x(1) - card_x(0)), "it moves by most of its width from moment to moment"
    assert np.abs(across).max() < 0.1
    assert not points.velocity[np.isnan(points.t)].any()


def test_points_have_the_colours_of_the_pictures(found, filmed):
    points, _ = found
    assert points.rgb.min() >= 0
    assert points.rgb.max() <= 1
    on_wall = np.isnan(points.t) & (np.abs(points.xyz[:, 2] - WALL) < 0.05) & (np.abs(points.xyz[:, :2]) < 5).all(1)
    true = colour(1, points.xyz[on_wall, 0], points.xyz[on_wall, 1])
    assert np.abs(points.rgb[on_wall] - true).mean() < 0.6 * np.abs(texture(1).mean((0, 1)) - true).mean()


@pytest.mark.slow
def test_the_same_points_come_from_the_same_pictures_with_any_number_of_threads_and_without_held_out_ones(found, filmed):
    capture, store = filmed
    blind = Store([])
    blind.pictures = {key: value for key, value in store.pictures.items() if key[0] != "cam03"}
    try:
        threads.set_threads(1)
        again = initial_points(capture, blind, settings(init_points=4000), lambda text: None)[0]
    finally:
        threads.set_threads(0)
    for name in ("xyz", "rgb", "t"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found[0], name))


class Files:
    """Pictures of shots at any size, as a store makes them of their files."""

    def pixels(self, shot):
        return Pixels(look(shot.t, shot.camera))


@pytest.mark.slow
def test_pictures_of_few_cameras_are_swept_twice_as_fine(monkeypatch):
    """Of up to eight; of more it would take too long."""
    sizes = []
    monkeypatch.setattr(dense.sweep, "swept", lambda pictures, near, far: sizes.append(max(pictures[0][0].shape)) or 1 / 0)
    for count in (8, 9):
        many = [replace(shot, view=f"{shot.view}-{k}") for k in range(3) for shot in shots()]
        views = sorted({shot.view for shot in many})[:count]
        capture = Capture(Path("some"), "test", [shot for shot in many if shot.view in views], fg.Clip(FRAMES))
        with pytest.raises(ZeroDivisionError):
            initial_points(capture, Files(), settings(init_points=400, init="triangulate"), lambda text: None)
    assert sizes[0] == 2 * sizes[1]


@pytest.mark.slow
def test_few_cameras_and_small_pictures_give_points_too():
    """Four cameras show most places in pairs; features are looked for in the files' pictures, four times as large as these."""
    quarter = [replace(camera, width=SIZE[0] // 4, height=SIZE[1] // 4, fx=42.5, fy=42.5, cx=SIZE[0] / 8, cy=SIZE[1] / 8, window=None)
               for camera in rig()]
    small = [replace(shot, camera=quarter[int(shot.view[-1])]) for shot in shots() if shot.view in ("cam00", "cam01", "cam02", "cam04")]
    capture = Capture(Path("small"), "test", small, fg.Clip(FRAMES), scale=0.25)
    points = initial_points(capture, Files(), settings(init_points=4000), lambda text: None)[0]
    still = points.xyz[np.isnan(points.t)]
    assert len(still) > 300
    assert (off_planes(still) < 0.15).mean() > 0.8


def test_points_of_a_far_wall_are_no_strays_beside_a_near_thing(rng):
    """What is ten times as far away has its points ten times as far apart, and few points between them are left out."""
    near = np.c_[rng.uniform(-0.5, 0.5, (600, 2)), np.full(600, 1.0)]
    far, strays = np.c_[rng.uniform(-5, 5, (600, 2)), np.full(600, 10.0)], rng.uniform((-1, -1, 3), (1, 1, 6), (12, 3))
    xyz = np.concatenate([near, far, strays])
    kept = among_others(Points(xyz, np.zeros_like(xyz), np.zeros(len(xyz))), np.zeros((1, 3))).xyz
    assert (kept[:, 2] == 10).sum() > 580 and (kept[:, 2] == 1).sum() > 580
    assert len(kept) - np.isin(kept[:, 2], (1.0, 10.0)).sum() <= 3


def test_no_more_points_than_asked_for(filmed):
    capture, store = filmed
    one = replace(capture, shots=capture.at_frame(0))
    assert 100 < len(initial_points(one, store, settings(init_points=300), lambda text: None)[0]) <= 300


def test_without_features_the_layouts_points_are_next(blank, rng):
    capture, store = blank
    brought = Points(rng.normal(0, 1, (50, 3)), rng.uniform(0, 1, (50, 3)))
    said = []
    points = initial_points(replace(capture, points=brought), store, settings(), said.append)[0]
    np.testing.assert_allclose(points.xyz, brought.xyz, rtol=1e-6)
    assert "no starting points" in said[0]
    assert "point file" in said[-1]


def test_without_anything_points_are_random_where_cameras_look_together(blank):
    capture, store = blank
    said = []
    points = initial_points(capture, store, settings(init_points=500), said.append)[0]
    assert len(points) == 500
    assert "random" in said[-1]
    views = [visible(camera, points.xyz) for v, camera in enumerate(rig()) if v != 3]
    assert (np.sum(views, 0) >= 3).all()
    other = initial_points(capture, store, settings(init_points=500, seed=1), lambda text: None)[0]
    assert not np.array_equal(other.xyz, points.xyz)


@pytest.fixture(scope="module")
def card(filmed, tmp_path_factory):
    """A bake of the card that moves, as a file in Blender's axes, and of a smaller card that it hides."""
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * CARD_HALF
    path = tmp_path_factory.mktemp("bake") / "card.safetensors"
    frames = [np.c_[corners[:, 0] + card_x(k / FRAMES), np.full(4, CARD_DEPTH), -(corners[:, 1] + 0.2)] for k in range(FRAMES)]
    positions = np.concatenate([np.stack(frames), np.stack([(f - f.mean(0)) * 0.4 + f.mean(0) + (0, 0.3, 0) for f in frames])], 1)
    model, _ = fg.bake(positions, [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], count=4000)
    fg.save(model, path)
    return path


def test_training_begins_with_a_known_model_as_it_moves_in_the_colours_of_the_pictures(filmed, card):
    capture, store = filmed
    said = []
    chosen = settings(init_model=str(card), max_gaussians=1600, backdrop=0.0, motion="polynomial")
    begun = start(capture, store, chosen, said.append)
    model = begun.model
    assert "4000" in said[-1] and str(len(model)) in said[-1]
    assert 1000 <= len(model) <= 1300 and begun.sizes is None
    shown = np.abs(model.position[:, 2] - CARD_DEPTH) < 0.1  # of what is hidden little is taken, for views from elsewhere
    assert 0.05 < 1 - shown.mean() < 0.15
    for t in (0.0, 0.25, 0.5, 0.75):
        now = fg.slice_model(model.take(shown), t)
        assert np.abs(now.position[:, 0] - card_x(t)).max() < CARD_HALF + 0.03
        seen = colour(2, now.position[:, 0] - card_x(t), now.position[:, 1] - 0.2)
        wrong = np.abs(now.features[:, :3] - seen).mean()
        assert wrong < np.abs(seen.mean(0) - seen).mean() / 2
        assert (now.scale.min(1) < 0.5 * now.scale.max(1)).mean() > 0.95  # flat, facing the cameras
    # of the capture's own model a part of the clip takes its part
    second = replace(capture, model=card, within=(0.5, 0.5), clip=replace(capture.clip, frame_count=2),
                     shots=[replace(shot, frame=shot.frame - 2, t=2 * (shot.t - 0.5)) for shot in capture.shots if shot.frame >= 2])
    later = start(second, store, settings(max_gaussians=1600, backdrop=0.0), said.append).model
    assert np.median(fg.slice_model(later, 0.0).position[:, 0]) == pytest.approx(card_x(0.5), abs=0.1)


def test_a_known_model_is_refined_and_not_lost(filmed, card):
    """Its first steps hardly move it; steps by which places are found would lose them.  A resumed run knows it too."""
    capture, store = filmed
    chosen = settings(init_model=str(card), max_gaussians=1600, backdrop=0.0, motion="polynomial", warm_up=(), iterations=400)
    begun = start(capture, store, chosen, lambda text: None)
    assert begun.warm

    def moved(known: bool) -> float:
        trainer = Trainer(capture, store, chosen, replace(begun, warm=known))
        for _ in range(12):
            trainer.step()
        again = Trainer(capture, store, chosen)
        again.restore(*trainer.state())
        assert again.warm == known
        return float(np.median(np.linalg.norm(again.model().position - begun.model.position, axis=1)))

    assert 0 < moved(True) < 0.15 * moved(False)


def test_a_damaged_model_of_the_capture_is_told_and_points_begin_instead(blank, tmp_path):
    capture, store = blank
    (tmp_path / "bake.safetensors").write_bytes(b"no model")
    said = []
    begun = start(replace(capture, model=tmp_path / "bake.safetensors"), store, settings(init_points=500), said.append)
    assert "bake.safetensors" in said[0] and "random" in said[-2] and "unsure for all" in said[-1] and len(begun.model) >= 500
    with pytest.raises(fg.FastGSError, match="bake.safetensors"):
        start(capture, store, settings(init_model=str(tmp_path / "bake.safetensors")), said.append)


@pytest.mark.parametrize("source", ["triangulate", "file", "model"])
def test_a_start_that_was_asked_for_and_fails_is_an_error(blank, source):
    with pytest.raises(fg.FastGSError):
        start(*blank, settings(init=source), lambda text: None)


def test_a_camera_that_films_alone_gives_points_of_what_stands(filmed):
    capture, store = filmed
    path = [("cam00", 0), ("cam01", 1), ("cam02", 2), ("cam04", 3)]
    alone = replace(capture, shots=[shot for shot in capture.shots if (shot.view, shot.frame) in path])
    points = initial_points(alone, store, settings(init_points=2000), lambda text: None)[0]
    assert len(points) >= 30
    assert points.t is None or np.isnan(points.t).all()


@pytest.mark.posix
def test_a_run_can_still_be_stopped_by_a_signal_once_pycolmap_is_loaded():
    script = ("import os, signal\n"
              "signal.signal(signal.SIGTERM, lambda *a: print('saved', flush=True))\n"
              "from fastgs_blender.training.initial.features import pycolmap_module\n"
              "pycolmap_module()\n"
              "os.kill(os.getpid(), signal.SIGTERM)\n")
    done = subprocess.run([sys.executable, "-c", script], cwd=Path(fg.__file__).parents[1], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "saved"), done.stderr


def test_lines_of_pycolmap_stay_away_from_the_terminal():
    """Pictures of noise have nothing in common, which its mapper calls an error; our own sentence says so."""
    script = ("from types import SimpleNamespace as some\n"
              "import numpy as np\n"
              "from fastgs_blender.training.initial.calibrate import mapped\n"
              "noise = np.random.default_rng(0).random((3, 60, 80, 3))\n"
              "assert mapped([some(view=k) for k in range(3)], some(pixels=lambda shot: some(rgb=noise[shot.view]))) == ({}, {})\n")
    done = subprocess.run([sys.executable, "-c", script], cwd=Path(fg.__file__).parents[1], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


def test_poses_are_found_where_the_capture_has_none(filmed, tmp_path):
    _, store = filmed
    capture = Capture(Path("planes"), "test", shots(posed=False), fg.Clip(FRAMES))
    cameras, lenses, frame = calibrated(capture, store)
    assert (sorted(cameras), frame) == (capture.views, 0)
    true = dict(zip(capture.views, rig()))
    centres, expected = (np.array([-c[v].world_to_camera[:3, :3].T @ c[v].world_to_camera[:3, 3] for v in capture.views])
                         for c in (cameras, true))
    centres, expected = centres - centres.mean(0), expected - expected.mean(0)
    u, s, v = np.linalg.svd(centres.T @ expected)
    fitted = s.sum() / (centres**2).sum() * centres @ u @ v
    assert np.abs(fitted - expected).max() < 0.03 * np.abs(expected).max()
    for name, camera in cameras.items():
        assert camera.fx == pytest.approx(true[name].fx, rel=0.03)
        assert abs(lenses[name].k[0]) < 0.05
    again, _, _ = calibrated(capture, store)
    for name in cameras:
        np.testing.assert_allclose(again[name].world_to_camera, cameras[name].world_to_camera, atol=1e-9)


def test_a_capture_without_anything_to_go_by_says_so(blank):
    _, store = blank
    with pytest.raises(fg.FastGSError, match="no poses"):
        calibrated(Capture(Path("grey"), "test", shots(posed=False)[:VIEWS], fg.Clip(1)), store)


def test_poses_once_found_are_kept_with_the_run(tmp_path):
    folder = write_capture(tmp_path / "film", frames=1, views=3)
    (folder / "cameras.json").unlink()
    (folder / "points.ply").unlink()
    capture = open_capture(folder)
    cameras = dict(zip(capture.views, rig()))
    cameras = {view: replace(camera, width=48, height=36, cx=24, cy=18, window=None) for view, camera in cameras.items()}
    keep(tmp_path / "poses.json", capture, cameras, {view: Lens("opencv", (0.01,)) for view in cameras})
    said = []
    posed = with_poses(capture, None, tmp_path, said.append)
    assert posed.posed
    assert not said
    np.testing.assert_allclose(posed.shots[1].camera.world_to_camera, cameras[capture.views[1]].world_to_camera)

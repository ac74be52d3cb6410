# SPDX-License-Identifier: GPL-3.0-or-later
"""What fastgs check says of poses and lenses where a floor or a wall repeats itself: matches off by whole tiles agree with each other."""
from __future__ import annotations

from dataclasses import replace

import filmed_room
import numpy as np
import pytest

from fastgs_blender.cameras.camera import Camera
from fastgs_blender.captures import open_capture
from fastgs_blender.captures.evidence import median
from fastgs_blender.checks import calibration
from fastgs_blender.checks.focal import common_factor
from fastgs_blender.checks.matching import Matches, Pair, off_lines
from fastgs_blender.checks.reprojection import judged, surely_off
from fastgs_blender.checks.samples import Inspection, sample
from fastgs_blender.training.initial import features
from fastgs_blender.util import rotations

VIEWS = [f"cam{k}" for k in range(6)]
POINTS = 60


def turned(camera, degrees):
    half = np.radians(degrees) / 2
    turn = np.eye(4)
    turn[:3, :3] = rotations.to_matrices(np.array([np.cos(half), 0, np.sin(half), 0]))
    return replace(camera, world_to_camera=turn @ camera.world_to_camera)


def rig():
    return {view: Camera(320, 240, 300.0, 300.0, 160.0, 120.0, filmed_room.pose(angle))
            for view, angle in zip(VIEWS, np.linspace(-0.7, 0.7, len(VIEWS)))}


def made(rng, shifted=(), calibrated=None, points=POINTS):
    """Matches of six cameras that see random points to a third of a pixel; in a camera of `shifted` that share of the features lies
    elsewhere.  calibrated: what the calibration says of some cameras."""
    world, cameras, seen = rng.uniform(-0.6, 0.6, (points, 3)), rig(), {}
    for view, camera in cameras.items():
        local = np.c_[world, np.ones(points)] @ camera.world_to_camera[:3].T
        places = 300 * local[:, :2] / local[:, 2:] + (160, 120) + rng.normal(0, 0.3, (points, 2))
        wrong = rng.random(points) < dict(shifted).get(view, 0)
        places[wrong] += rng.uniform(-25, 25, (wrong.sum(), 2))
        seen[0, view] = features.Features(places, np.zeros((points, 1)), (calibrated or {}).get(view, camera))
    rows, pairs = np.repeat(np.arange(points)[:, None], 2, 1), []
    for a, b in zip(VIEWS, VIEWS[1:] + VIEWS[:1]):
        one, other = seen[0, a], seen[0, b]
        pairs.append(Pair(0, a, b, rows, off_lines(features.fundamental(one.camera, other.camera), one.places, other.places)))
    return Matches(seen, {}, pairs, len(pairs))


def test_what_looks_alike_in_its_own_picture_does_not_count(rng):
    """Twice the same tile, and a feature that is there in two sizes."""
    unit = rng.normal(size=(4, 128))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    one = features.Features(np.array([(10.0, 10), (90, 10), (50, 50), (51, 50), (20, 80)]), unit[[0, 0, 1, 1, 2]], None)
    alone = features.alone(one)
    assert alone[:2] == pytest.approx([0, 0], abs=1e-3) and (alone[2:] > 1).all()
    rows = np.repeat(np.arange(5)[:, None], 2, 1)
    assert features.distinct(rows, one, one, alone, alone)[:, 0].tolist() == [2, 3, 4]
    other = replace(one, descriptors=one.descriptors[::-1])
    assert not len(features.distinct(rows[4:], one, other, alone, alone)), "a match that is farther apart than what is there twice"


def test_shifted_matches_make_a_right_camera_unsure(rng):
    found = judged(made(rng, {"cam2": 0.65}), VIEWS)
    assert found.misses["cam2"] > 3 and not found.wrong and found.unsure == ["cam2"]
    assert max(miss for view, miss in found.misses.items() if view != "cam2") < 1


@pytest.mark.parametrize("shifted", [{}, {"cam2": 0.4, "cam4": 0.3}])
def test_a_turned_camera_is_wrong_among_shifted_matches_too(rng, shifted):
    found = judged(made(rng, shifted, {"cam2": turned(rig()["cam2"], 1.0)}), VIEWS)
    assert found.wrong == ["cam2"] and not found.unsure


def circle(rng, calibrated, count=12, points=40, noise=0.3):
    """Matches of cameras around the middle, of which three in a row share their points; calibrated: functions of some of them."""
    views, pairs = [f"cam{k}" for k in range(count)], []
    cameras = {view: Camera(320, 240, 300.0, 300.0, 160.0, 120.0, filmed_room.pose(2 * np.pi * k / count)) for k, view in enumerate(views)}
    seen = {view: np.zeros((0, 2)) for view in views}
    for k in range(count):
        three, world = [views[(k + i) % count] for i in range(3)], rng.uniform(-0.6, 0.6, (points, 3))
        begins = [len(seen[view]) for view in three]
        for view in three:
            pixels = cameras[view].pixels(cameras[view].local(world)) + rng.normal(0, noise, (points, 2))
            seen[view] = np.concatenate([seen[view], pixels])
        pairs += [(*three[i:i + 2], np.arange(points)[:, None] + begins[i:i + 2]) for i in (0, 1)]
    same = lambda camera: camera  # noqa: E731
    found = {(0, view): features.Features(places, np.zeros((len(places), 1)), calibrated.get(view, same)(cameras[view]))
             for view, places in seen.items()}
    lines = [off_lines(features.fundamental(found[0, a].camera, found[0, b].camera), seen[a][rows[:, 0]], seen[b][rows[:, 1]])
             for a, b, rows in pairs]
    return Matches(found, {}, [Pair(0, *pair, away) for pair, away in zip(pairs, lines)], len(pairs)), views


@pytest.mark.parametrize("seed", [1, 5, 8])
def test_a_right_camera_that_only_wrong_ones_look_at_is_unsure(seed):
    """Its errors are as large as theirs, but no two right cameras say so."""
    rng = np.random.default_rng(seed)

    def bumped(camera, turn=0.02):
        motion = np.eye(4)
        axis = rng.normal(size=3)
        motion[:3, :3] = rotations.to_matrices(np.r_[np.cos(turn / 2), np.sin(turn / 2) * axis / np.linalg.norm(axis)])
        return replace(camera, world_to_camera=motion @ camera.world_to_camera)

    verdict = judged(*circle(rng, {"cam2": bumped, "cam4": bumped}))
    assert sorted(verdict.wrong) == ["cam2", "cam4"] and verdict.unsure == ["cam3"]


@pytest.mark.parametrize("factor", [0.9, 1.0, 1.1])
def test_focal_lengths_that_are_wrong_alike_are_told(rng, factor):
    """Every camera fits the others well in the middle of its picture; pairs of cameras tell it all the same, and a bumped one does not."""
    def zoomed(camera):
        return replace(camera, fx=factor * camera.fx, fy=factor * camera.fy)

    found = common_factor(circle(rng, {f"cam{k}": zoomed for k in range(12)}, noise=0.05)[0])
    assert found is None if factor == 1 else found == pytest.approx(1 / factor, abs=0.01)
    assert common_factor(circle(rng, {"cam2": lambda camera: turned(camera, 1.5), "cam7": zoomed})[0]) is None


def test_a_longer_focal_length_is_wrong(rng):
    found = judged(made(rng, {}, {"cam3": replace(rig()["cam3"], fx=315.0, fy=315.0)}), VIEWS)
    assert found.wrong == ["cam3"]


def test_errors_count_without_a_peak_at_nothing(rng):
    """The rule for poses and borders of lenses: surely too large, and no share of them that fits exactly."""
    around, exact = rng.uniform(3, 30, 60), rng.uniform(0, 0.8, 20)
    assert surely_off(around) and not surely_off(np.concatenate([around, exact]))
    assert not surely_off(np.array([0.4, 1.0, 2.0, 9.0, 30.0])) and not surely_off(np.zeros(0)), "few values are unsure"
    assert surely_off(np.full(40, 2.2) + rng.normal(0, 0.3, 40)) and not surely_off(np.full(40, 1.2) + rng.normal(0, 0.3, 40))
    middle, deviation = median(rng.normal(5, 1, 4000))
    assert middle == pytest.approx(5, abs=0.08) and deviation == pytest.approx(1.2533 / np.sqrt(4000), rel=0.3)


@pytest.fixture
def tiled(tmp_path, monkeypatch):
    """The room with 8 x 8 equal bricks on its wall and 8 x 8 motifs on its floor."""
    real, kept = filmed_room.texture, filmed_room.TEXTURE
    y, x = (values * 8 / kept for values in np.mgrid[:kept, :kept])
    bricks = np.where((((x + 0.5 * (np.floor(y) % 2)) % 1 < 0.06) | (y % 1 < 0.1))[..., None], [0.8, 0.78, 0.75], [0.6, 0.3, 0.22])
    motif = np.random.default_rng(6).uniform(0.1, 0.9, (4, 4, 3))
    motifs = np.tile(np.kron(motif, np.ones((kept // 32, kept // 32, 1))), (8, 8, 1))
    monkeypatch.setattr(filmed_room, "texture", lambda k: (bricks, motifs)[k] if k < 2 else real(k))
    filmed_room.picture.cache_clear()
    yield lambda name, **more: filmed_room.write_room(tmp_path / name, 6, 2, spread=1.3, detail=2, **more)
    filmed_room.picture.cache_clear()


@pytest.mark.slow
def test_an_exact_capture_with_tiles_has_no_wrong_camera(tiled):
    def told(path):
        inspection = Inspection(open_capture(path))
        sample(inspection)
        return [finding for finding in calibration.run(inspection).findings if finding.severity != "note"]

    assert not told(tiled("exact"))
    moved = np.eye(4)
    moved[:2, 3] = 0.1
    assert {finding.views for finding in told(tiled("moved", calibrated={1: lambda pose: moved @ pose}))} <= {("cam01",)}

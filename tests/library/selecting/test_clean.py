# SPDX-License-Identifier: GPL-3.0-or-later
"""clean(): what is found and why, what it costs the cameras' pictures, and what cannot be judged."""
from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from dirty_rooms import EACH, KINDS, WALL, dirty_room, rows
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.cameras.viewpoints import camera_of, viewpoint_of
from fastgs_blender.selecting import sightings as sights
from fastgs_blender.selecting.sightings import sampled_views, sightings
from fastgs_blender.selecting.strays import strays


@pytest.fixture(scope="module")
def room():
    return dirty_room(fg)


def pictures(model, series):
    return [fg.render(model, camera, t, backend="cpu")["rgb"] for _, camera, t in series]


def test_each_kind_is_found_and_the_wall_stays(room):
    found = fg.clean(room, 1.0).found
    for kind in KINDS:
        assert found[kind][rows(kind)].sum() >= EACH - 3, kind
    assert not fg.clean(room, 1.0).taken[rows("wall")].any()
    assert np.sum(list(found.values()), 0).max() == 1  # each is counted once


def test_the_strength_decides_how_much_and_what_the_pictures_may_lose(room):
    """More is taken, never less; the pictures lose at most what the strength allows, about as much as is told."""
    takes = [fg.clean(room, strength) for strength in (0.0, 0.25, 0.5, 0.75, 1.0)]
    counts = [proposed.taken.sum() for proposed in takes]
    assert counts[0] == 0 and counts == sorted(counts) and counts[-1] > counts[1]
    series = sampled_views(room)[::4]
    whole = pictures(room, series)
    for proposed, allowed in zip(takes[1:], (10**-7.25, 10**-6.5, 10**-5.75, 10**-5.0)):
        left = pictures(room.take(~proposed.taken), series)
        lost = np.mean([np.mean((a - b) ** 2) for a, b in zip(whole, left)])
        assert proposed.loss <= allowed and lost < 3 * allowed


def test_kinds_are_chosen_and_wrong_ones_are_refused(room):
    assert set(fg.clean(room, 1.0, kinds=["haze"]).found) == {"haze"} and not fg.clean(room, 1.0, kinds=[]).found
    assert fg.clean(room, 1.0, kinds=[]).taken.tolist() == [False] * len(room)
    for strength in (-0.1, 1.5, float("nan"), "much"):
        with pytest.raises(fg.FastGSError, match="strength"):
            fg.clean(room, strength)
    with pytest.raises(fg.FastGSError, match="unseen, haze, floaters, colours"):
        fg.clean(room, kinds=["dust"])
    with pytest.raises(fg.FastGSError, match="one model"):
        fg.clean("room")


def test_without_cameras_floaters_and_colours_alone_are_judged():
    blind = fg.clean(dirty_room(fg, cameras=False), 1.0)
    assert blind.unjudged == ("unseen", "haze") and blind.loss is None and set(blind.found) == {"floaters", "colours"}
    assert blind.found["floaters"][rows("floaters")].any() and blind.found["colours"][rows("colours")].all()
    assert not blind.taken[rows("wall")].any()
    assert fg.clean(dirty_room(fg, cameras=False), kinds=["colours"]).unjudged == ()
    assert len(fg.clean(dirty_room(fg, cameras=False), kinds=["haze"]).taken) == WALL + 4 * EACH


def test_the_backdrop_is_left_alone(room):
    inside = dataclasses.replace(room, surroundings=dataclasses.replace(room.surroundings, backdrop=fg.Backdrop((0, 0, 0), 1.8)))
    far = inside.surroundings.backdrop.distance(room.position) > 1
    assert far[rows("floaters")].all() and fg.clean(room, 1.0).taken[far].any() and not fg.clean(inside, 1.0).taken[far].any()


def test_the_cost_of_each_is_what_the_pictures_change_by_without_it(room):
    """The expectation of its square of a sum of random signs: right in the mean over many Gaussians, each in opaque and in faint places."""
    found, series = sightings(room), sampled_views(room)[::4]
    whole, some = pictures(room, series), np.r_[WALL // 2:WALL // 2 + 25, WALL + EACH:WALL + 2 * EACH]
    true = np.array([np.mean([np.mean((a - b) ** 2) for a, b in zip(whole, pictures(room.take(np.arange(len(room)) != k), series))])
                     for k in some])
    assert 0.5 < found.cost[some].sum() / true.sum() < 2


def test_what_cameras_saw(room):
    found = sightings(room)
    assert not found.seen[rows("unseen")].any() and found.best[rows("unseen")].max() < 0.01
    assert found.seen[rows("wall")].max() == 8 and (found.chances == 8).all()
    assert np.abs(found.before[rows("wall")] - 1).max() < 0.05
    assert found.before[rows("haze")].max() < 0.7 and (found.before[rows("unseen")] > 1).all()
    # one Gaussian alone before one camera: all of its light arrives
    one = room.take(np.array([WALL // 2]))
    assert sightings(one).best[0] == pytest.approx(sightings(one).area[0], rel=0.1)


def test_what_lives_shortly_is_not_taken_for_unseen():
    """Gaussians that no picture of theirs meets while they live have had no chance, and are left."""
    model = random_model(np.random.default_rng(3), 200, basis=fg.Fourier(1), temporal="radial")
    model = dataclasses.replace(model, temporal=np.full((200, 1), 14.0), mu_tau=np.linspace(0, 1, 200), opacity=np.full(200, 2.0))
    cameras = (viewpoint_of(fg.Camera(64, 48, 60, 60, 32, 24, fg.look_at((0, -6, 0), (0, 0, 0)))),)
    model = dataclasses.replace(model, surroundings=fg.Surroundings(cameras=cameras))
    found = sightings(model)
    assert len(sampled_views(model)) == sights.PICTURES and (found.chances == 0).any()
    assert not fg.clean(model, 1.0).found["unseen"][found.chances == 0].any()


def test_a_clip_is_looked_at_all_over_by_each_camera(room):
    assert [view.number for view in sampled_views(room)] == sorted(list(range(8)) * 4)
    moving = random_model(np.random.default_rng(0), 10, basis=fg.Fourier(2), temporal="radial")
    moving = dataclasses.replace(moving, surroundings=room.surroundings)
    times = np.sort([view.t for view in sampled_views(moving)])
    assert len(times) == sights.PICTURES and np.diff(times, prepend=0, append=1).max() < 0.1
    assert max(max(view.camera.width, view.camera.height) for view in sampled_views(moving)) <= sights.SIDE


def test_strays():
    """In a plane all are alike; one above it is alone, one of another colour has its tint, and a border between two colours has not."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(20.0), np.arange(20.0)))
    place = np.concatenate([np.stack([x, y, 0 * x], 1), [[9.5, 9.5, 8.0]]])
    rgb = np.where(place[:, :1] < 10, (0.2, 0.2, 0.2), (0.9, 0.2, 0.2))
    rgb[210] = (0.2, 0.9, 0.2)
    model = fg.GaussianModel(position=place, rotation=np.tile([1.0, 0, 0, 0], (401, 1)), scale=np.full((401, 3), np.log(0.3)),
                             opacity=np.full(401, 3.0), features=rgb)
    found = strays(model)
    assert found.alone[400] > 5 and found.alone[:400].max() < 2
    assert found.tint[210] > 0.5 and np.delete(found.tint, 210).max() < 0.5
    few = strays(model.take(np.arange(3)))
    assert (few.alone == 1).all() and not few.tint.any()


@pytest.mark.parametrize("count", [0, 1, 12])
def test_models_of_hardly_any_gaussians(room, count):
    assert fg.clean(room.take(np.arange(count)), 1.0).taken.shape == (count,)


def test_numbers_that_are_none_do_no_harm(room):
    """A file may hold Gaussians that lie nowhere or are larger than any room."""
    odd = dataclasses.replace(room, position=room.position.copy(), scale=room.scale.copy())
    odd.position[0], odd.scale[1], odd.position[2] = 1e30, 80.0, camera_of(room.surroundings.cameras[0]).world_to_camera[:3, 3]
    with np.errstate(all="raise", under="ignore"):
        found = fg.clean(odd, 1.0)
    assert not found.taken[3:WALL].any() and np.isfinite(found.loss)


def test_the_work_can_be_stopped_and_is_done_once(room):
    shares = []
    fresh = dataclasses.replace(room, clip=fg.Clip(2, 24.0))

    def stop(share):
        shares.append(share)
        raise InterruptedError

    with pytest.raises(InterruptedError):
        fg.clean(fresh, progress=stop)
    assert 0 < shares[0] < 1
    fg.clean(fresh, 0.3)
    fg.clean(fresh, 0.8, progress=stop)  # is not called any more
    assert len(shares) == 1


def test_the_command(run, tmp_path, room):
    source, out = tmp_path / "room.safetensors", tmp_path / "clean.ply"
    fg.save(room, source)
    code, text, _ = run("clean", source, out, "--strength", "1")
    expected = fg.clean(fg.load(source), 1.0)
    assert code == 0 and len(fg.load(out)) == len(room) - expected.taken.sum()
    table = {line.split()[0]: line.split()[1] for line in text.splitlines()}
    assert table["unseen"] == str(expected.found["unseen"].sum()) and table["left"] == str(len(room) - expected.taken.sum())
    assert "dB between" in text
    before = out.read_bytes()
    code, _, error = run("clean", source, out)
    assert code == 2 and "is there already" in error and out.read_bytes() == before
    code, text, _ = run("clean", source, out, "--overwrite", "--json", "--kinds", "haze,colours", "--strength", "1")
    told = json.loads(text)
    assert code == 0 and set(told["found"]) == {"haze", "colours"} and told["left"] == len(fg.load(out)) and told["unjudged"] == []
    assert 50 <= told["psnr_of_change"] < 90
    for wrong in (("--strength", "2"), ("--kinds", "dust"), ("--kinds", ""), ("--threads", "0")):
        code, _, error = run("clean", source, tmp_path / "no.ply", *wrong)
        assert code == 2 and error.count("\n") == 1 and not (tmp_path / "no.ply").exists()


def test_the_command_misses_a_folder_before_it_looks(run, tmp_path, room, monkeypatch):
    monkeypatch.setattr(sights, "render", lambda *_, **__: pytest.fail("it has looked at pictures first"))
    fg.save(room, tmp_path / "room.safetensors")
    code, _, error = run("clean", tmp_path / "room.safetensors", tmp_path / "missing" / "clean.ply")
    assert code == 2 and "missing" in error and "folder" in error and error.count("\n") == 1


def test_the_command_says_what_it_cannot_judge(run, tmp_path):
    source = tmp_path / "blind.safetensors"
    fg.save(dirty_room(fg, cameras=False), source)
    code, text, error = run("clean", source, tmp_path / "out.safetensors", "--strength", "1")
    assert code == 0 and "unseen and haze" in error and "fastgs annotate" in error and "dB" not in text
    left = fg.load(tmp_path / "out.safetensors")
    assert len(left) == WALL + 4 * EACH - fg.clean(fg.load(source), 1.0).taken.sum()
    assert run("clean", source, tmp_path / "same.safetensors", "--kinds", "haze")[0] == 0
    assert len(fg.load(tmp_path / "same.safetensors")) == WALL + 4 * EACH

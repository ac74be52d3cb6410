# SPDX-License-Identifier: GPL-3.0-or-later
"""Long captures in segments: how they are cut, and how the joined model plays."""
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import toy_captures
from hypothesis import given
from hypothesis import strategies as st
from toy_captures import toy_capture

import fastgs_blender as fg
from fastgs_blender.captures.capture import Points
from fastgs_blender.training.core import settings
from fastgs_blender.training.core.spans import Span, spans
from fastgs_blender.training.run.segments import joined_clip


@given(st.integers(1, 2000), st.integers(4, 300), st.integers(0, 20))
def test_segments_cover_the_clip_overlap_and_are_equally_long(frames, most, overlap):
    cuts = spans(frames, most, overlap)
    assert cuts[0].first == 0 and cuts[-1].first + cuts[-1].count == frames
    assert len({cut.count for cut in cuts}) == 1 and cuts[0].count <= max(most, frames if len(cuts) == 1 else 0)
    for before, after in pairwise(cuts):
        assert before.first < after.first <= before.first + before.count - min(overlap, most - 1)
    assert (len(cuts) == 1) == (frames <= most)


def test_published_clips_are_cut_into_spans_that_share_nothing():
    """Spacetime Gaussians trains frames 0 to 49, 50 to 99 ... of the 300 that are measured, each for itself (pre_n3d.py)."""
    chosen = settings.settings("stg")
    assert spans(300, chosen.segment_frames, chosen.segment_overlap) == [Span(first, 50) for first in range(0, 300, 50)]


def test_segments_that_share_no_frame_change_over_between_two(rng, make_model):
    """Each frame is one segment's, and between two frames nothing shines through."""
    cuts, clip = spans(30, 10, 0), fg.Clip(30)
    first = make_model(rng, 60, "paper", "line", "radial", "stg", motion=0.0, size=0.6)
    first = replace(first, opacity=np.full(60, 6.0), temporal=np.full((60, 1), -9.0))
    joined = joined_clip(lambda i: replace(first, clip=fg.Clip(10)), cuts, clip, {}).joined()
    for frame in np.arange(0, 29.01, 0.125):
        shown = fg.slice_model(joined, frame / 30, cull=False).opacity.reshape(3, 60)[:, 0]
        assert shown.max() > 0.99, frame
        if frame == int(frame):
            assert shown[int(frame) // 10] > 0.99 and np.delete(shown, int(frame) // 10).max() < 1 / 255, frame


def test_segments_can_be_switched_off():
    assert spans(1000, 0, 8) == [Span(0, 1000)]


def test_a_part_has_its_own_time():
    capture, _, points = toy_capture(frames=10)
    capture.points = Points(points.xyz, points.rgb, np.linspace(0, 0.9, len(points)))
    cut = capture.part(4, 5)
    assert cut.clip == fg.Clip(5, 24.0, 5) and len(cut.shots) == 25
    np.testing.assert_allclose([shot.t for shot in cut.shots], np.repeat(np.arange(5) / 5, 5), atol=1e-12)
    assert all(a.image is b.image and a.camera is b.camera for a, b in zip(cut.shots, capture.shots[20:]))
    kept = (capture.points.t >= 0.4) & (capture.points.t < 0.9)
    assert np.array_equal(cut.points.xyz, points.xyz[kept]) and cut.points.t.min() >= 0 and cut.points.t.max() < 1


@pytest.mark.parametrize("basis", ["cosine", "paper", "cubic"])
def test_what_is_joined_shows_each_segment_and_fades_without_a_gap(rng, make_model, basis):
    """Opaque models of one picture: at every time, between all frames too, it is covered."""
    cuts, clip = spans(50, 20, 6), fg.Clip(50, 25.0)
    first = make_model(rng, 60, basis, "line", "radial", "sigmoid", motion=0.0, size=0.6)
    first = replace(first, opacity=np.full(60, 6.0), temporal=np.full((60, 1), -9.0))
    models = [replace(first, clip=fg.Clip(cut.count, 25.0)) for cut in cuts]
    joined = joined_clip(models.__getitem__, cuts, clip, {"a": "b"}).joined()
    assert joined.clip == clip and joined.provenance == {"a": "b"} and len(joined) == 60 * len(cuts)
    camera = fg.Camera(24, 24, 30, 30, 12, 12, [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]])
    alone = fg.render(first, camera, 0.5, ("alpha",))["alpha"]
    for frame in np.arange(0, 49.01, 0.25):
        shown = fg.slice_model(joined, frame / 50, cull=False).opacity.reshape(len(cuts), 60)[:, 0]
        assert shown.max() > 0.99 and (shown > 0.01).sum() <= 2
        assert (fg.render(joined, camera, frame / 50, ("alpha",))["alpha"] >= alone - 0.02).all()


def test_a_long_capture_becomes_one_file(tmp_path, monkeypatch):
    from fastgs_blender.training.run import plan, session

    capture, store, points = toy_capture(frames=14, views=3)
    monkeypatch.setattr("fastgs_blender.training.initial.starting_points.initial_points", lambda *rest: (points, rest[1]))
    options = dict(iterations=80, max_gaussians=120, warm_up=(), segment_frames=8, segment_overlap=3, backdrop=0.0, preview_every=0,
                   position_rate=1e-3, motion_rate=2e-3, init_scale=1.0, init_duration=0.1)
    chosen = plan.begin(tmp_path, options, lambda wanted: settings.settings(**wanted), False, False)
    report = session.run(capture, store, chosen, tmp_path, quiet=True)
    model = fg.load(tmp_path / "model.safetensors")
    assert model.clip == capture.clip and len(model) == report["gaussians"] and report["held_out_psnr"] > 13
    assert sorted(p.name for p in (tmp_path / "segments").iterdir()) == ["000", "001", "002"]
    before = (tmp_path / "model.safetensors").read_bytes()
    (tmp_path / "model.safetensors").unlink()
    (tmp_path / "segments" / "001" / "segment.safetensors").unlink()
    session.run(capture, store, plan.begin(tmp_path, {}, None, True, False), tmp_path, quiet=True)
    assert (tmp_path / "model.safetensors").read_bytes() == before


@pytest.fixture(scope="module")
def filmed():
    """(capture, store, points) of 24 frames in which 6 small blobs move before 60 that stand."""
    with pytest.MonkeyPatch.context() as patch:
        whole, cameras = toy_captures.toy_scene, toy_captures.toy_cameras

        def scene(frames):
            model = whole(frames).take(np.arange(66))
            model.position[60:] *= 0.5
            model.motion[60:] *= 0.5
            return model

        patch.setattr(toy_captures, "SIZE", (72, 54))
        patch.setattr(toy_captures, "toy_scene", scene)
        patch.setattr(toy_captures, "toy_cameras", lambda views: [replace(each, fx=67.5, fy=67.5) for each in cameras(views)])
        capture, store, points = toy_capture(frames=24)
    shots = [replace(shot, camera=replace(shot.camera)) for shot in capture.shots]  # pictures are told by cameras: parts count frames anew
    by_camera = {id(shot.camera): store.pictures[shot.view, shot.frame] for shot in shots}
    store.pixels = lambda shot: by_camera[id(shot.camera)]
    return replace(capture, shots=shots), store, points


def trained(filmed, out, monkeypatch, **options):
    """(the clip's model, its report, the models of its segments) of a run in segments."""
    from fastgs_blender.training.run import plan, session

    capture, store, points = filmed
    monkeypatch.setattr("fastgs_blender.training.initial.starting_points.initial_points", lambda *rest: (points, rest[1]))
    options = dict(iterations=300, max_gaussians=200, warm_up=(), segment_frames=12, segment_overlap=3, backdrop=0.0, preview_every=0,
                   position_rate=1e-3, motion_rate=2e-3, init_scale=1.0, exposures="off", clocks="off", poses="off") | options
    chosen = plan.begin(out, options, lambda wanted: settings.settings(**wanted), False, False)
    report = session.run(capture, store, chosen, out, quiet=True)
    models = [fg.load(path) for path in sorted(out.glob("segments/*/segment.safetensors"))]
    return fg.open_source(out / "model.safetensors"), report, models


@pytest.mark.slow
def test_a_segment_begins_from_the_one_before(filmed, tmp_path, monkeypatch):
    """What stands still is the same to the bit and stored once, and the clip is as good as of segments that are trained for themselves."""
    from fastgs_blender.training.initial.continued import stands

    clip, report, models = trained(filmed, tmp_path / "on", monkeypatch)
    alone, before, each = trained(filmed, tmp_path / "alone", monkeypatch, segment_steps=0.0)
    assert isinstance(clip, fg.Chapters) and report["held_out_psnr"] > before["held_out_psnr"] - 0.2
    kept = [{row.tobytes() for row in model.take(stands(model)).position} for model in models]
    assert min(len(rows) for rows in kept) > 50 and len(kept[0] & kept[1] & kept[2]) > 45
    assert len(clip) < sum(map(len, models)) - 90 and len(clip) < 0.75 * len(alone) and not any(stands(model).any() for model in each)
    capture, store, _ = filmed
    films = np.stack([store.pixels(shot).rgb for shot in capture.held_out])
    changes = np.ptp(films, axis=0).max(-1)
    moving = np.max([np.roll(changes, (i, j), (0, 1)) for i in range(-4, 5) for j in range(-4, 5)], 0) > 1 / 255

    def flicker(source):
        """The largest change of still pixels where segments change over, and between their frames."""
        pictures = [fg.render(source, capture.held_out[0].camera, frame / 24)["rgb"] for frame in range(24)]
        return np.abs(np.diff(pictures, axis=0)).max(-1)[6:19][:, ~moving].max()

    assert flicker(clip) < 1 / 255 < flicker(alone)


@pytest.mark.parametrize("density", ["default", "mcmc"])
def test_what_is_held_stays_and_is_counted_in_checkpoints(filmed, density):
    from fastgs_blender.training.core.start import Start
    from fastgs_blender.training.core.trainer import Trainer
    from fastgs_blender.training.initial.first_model import model_from_points

    capture, store, points = filmed
    chosen = settings.settings(iterations=20, densify_from=0.0, densify_every=5, densify_threshold=0.0, prune_opacity=0.4, warm_up=(),
                               density=density, max_gaussians=150, backdrop=0.0, exposures="off", clocks="off", poses="off")
    first = model_from_points(points, chosen, capture.clip, capture.axes, capture.extent)
    first.opacity[:5] = -3.0
    trainer = Trainer(capture, store, chosen, Start(first, frozen=40))
    for _ in range(12):
        trainer.step()
    after = trainer.model()
    assert len(after) != len(first) and not np.array_equal(after.position[40:60], first.position[40:60])
    for name, array in first.arrays.items():
        np.testing.assert_array_equal(after.arrays[name][:40], array[:40], err_msg=name)
    again = Trainer(capture, store, chosen)
    again.restore(*trainer.state())
    again.step()
    np.testing.assert_array_equal(again.model().features[:40], first.features[:40])


def test_a_next_segment_keeps_what_rests_and_adds_points_where_something_moves(filmed, monkeypatch):
    from fastgs_blender.training.initial import continued
    from fastgs_blender.training.initial.first_model import model_from_points

    capture, store, points = filmed
    chosen = settings.settings(max_gaussians=200, backdrop=0.0, exposures="off", clocks="off", poses="off")
    timed = replace(points, t=np.zeros(len(points)))  # of both, 60 that rest and then 6 that move
    monkeypatch.setattr(continued.starting_points, "initial_points", lambda *rest: (timed, store))
    earlier = capture.part(0, 12)
    before = model_from_points(points, chosen, earlier.clip, capture.axes, capture.extent)
    start = continued.start_after(before, earlier, 0.75, capture.part(9, 12), store, chosen, say=str)
    new = {row.tobytes() for row in start.model.position[len(before):]}
    kept = [row.tobytes() in new for row in before.position]
    goes_on = start.model.mu_tau[:len(before)] == 0.5  # for all times
    assert all(kept[60:]) and np.mean(kept[:60]) < 0.4 and not goes_on[60:].any() and np.mean(goes_on[:60]) > 0.9
    assert chosen.warm_up and chosen.of_segment(0).warm_up and not chosen.of_segment(1).warm_up


def test_films_with_masks_tell_what_stands_still(filmed):
    """Whole masks change nothing, and where the model is to show nothing, nothing moves; cameras that move tell nothing."""
    from types import SimpleNamespace

    from fastgs_blender.captures.pixels.store import Pixels
    from fastgs_blender.training.initial.continued import _calm

    capture, store, points = filmed
    chosen, sizes = settings.settings(), np.full(len(points.xyz), 0.1)

    def calm(mask=None, capture=capture):
        shown = SimpleNamespace(pixels=lambda shot: Pixels(store.pixels(shot).rgb, mask))
        return _calm(points.xyz, sizes, capture, shown, chosen)

    plain = calm()
    assert (plain[60:] < 0.6).all() and plain[:60].mean() > 0.7
    np.testing.assert_array_equal(calm(np.ones((54, 72), np.float32)), plain)
    assert (calm(np.zeros((54, 72), np.float32)) == 1).all()
    moved = [replace(shot, camera=replace(shot.camera, fx=shot.camera.fx + shot.frame)) for shot in capture.shots]
    pictures = {id(after.camera): store.pixels(shot) for shot, after in zip(capture.shots, moved)}
    told = SimpleNamespace(pixels=lambda shot: pictures[id(shot.camera)])
    assert not _calm(points.xyz, sizes, replace(capture, shots=moved), told, chosen).any()

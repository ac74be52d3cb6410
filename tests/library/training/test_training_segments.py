# SPDX-License-Identifier: GPL-3.0-or-later
"""Long captures in segments: how they are cut, and how the joined model plays."""
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from toy_captures import toy_capture

import fastgs_blender as fg
from fastgs_blender.captures.capture import Points
from fastgs_blender.training.core import settings
from fastgs_blender.training.run.segments import Span, joined_model, spans


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
    joined = joined_model([replace(first, clip=fg.Clip(10))] * 3, cuts, clip, {})
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
    joined = joined_model(models, cuts, clip, {"a": "b"})
    assert joined.clip == clip and joined.provenance == {"a": "b"} and len(joined) == 60 * len(cuts)
    camera = fg.Camera(24, 24, 30, 30, 12, 12, [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]])
    alone = fg.render(first, camera, 0.5, ("alpha",))["alpha"]
    for frame in np.arange(0, 49.01, 0.25):
        shown = fg.slice_model(joined, frame / 50, cull=False).opacity.reshape(len(cuts), 60)[:, 0]
        assert shown.max() > 0.99 and (shown > 0.01).sum() <= 2
        assert (fg.render(joined, camera, frame / 50, ("alpha",))["alpha"] >= alone - 0.02).all()


def test_a_long_capture_becomes_one_file(tmp_path, monkeypatch):
    pytest.importorskip("torch")
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

# SPDX-License-Identifier: GPL-3.0-or-later
"""Long clips in chapters: pictures of the whole model, a bounded part in memory, what stays once, and damaged files."""
from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import mutations
import numpy as np
import pytest
from random_models import APPEARANCES, BASES, TEMPORALS, random_model

import fastgs_blender as fg
from fastgs_blender.model import sequence

CAMERA = fg.Camera(40, 30, 40, 40, 20, 15, [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]])
TIMES = np.linspace(-0.1, 1.1, 13)


def long_model(rng, n=120, frames=120, **kinds) -> fg.GaussianModel:
    return random_model(rng, n, extent=2.0, clip=fg.Clip(frames, 24.0), **{"basis": "line", "temporal": "window"} | kinds)


def opened(source, path) -> fg.Chapters:
    fg.save(source, path)
    found = fg.open_source(path)
    assert isinstance(found, fg.Chapters)
    return found


def same_pictures(whole, source, exactly=True, times=TIMES, **options):
    for t in times:
        one, other = (fg.render(each, CAMERA, t, **options)["rgb"] for each in (whole, source))
        if exactly:
            np.testing.assert_array_equal(one, other)
        np.testing.assert_allclose(one, other, atol=1e-6)


@pytest.mark.parametrize(("basis", "temporal", "appearance"), [
    *((basis, "window", "sh1") for basis in BASES), *(("cosine", temporal, "sigmoid") for temporal in TEMPORALS),
    *(("line", "radial", appearance) for appearance in APPEARANCES)])
def test_pictures_are_those_of_the_whole_model(rng, tmp_path, basis, temporal, appearance):
    model = long_model(rng, basis=basis, rotation_basis=basis, temporal=temporal, appearance=appearance)
    source = opened(fg.chapters(model, frames=10), tmp_path / "m.safetensors")
    whole = fg.load(tmp_path / "m.safetensors")
    assert source.clip == model.clip and len(source.chapters) == 12 and len(source) == len(whole) == len(model)
    same_pictures(whole, source)
    same_pictures(model, source, exactly=False)
    if temporal == "window":
        assert max(len(source.frame(i)) for i in range(12)) < 0.95 * len(model)


def test_a_look_that_brightens_and_a_shutter_see_the_same_across_a_seam(rng, tmp_path):
    """What is too faint to be seen as it is, and what begins within half a frame."""
    model = long_model(rng, temporal="radial-window")
    source = opened(fg.chapters(model, frames=10), tmp_path / "m.safetensors")
    whole = fg.load(tmp_path / "m.safetensors")
    look = fg.ObjectSettings(opacity=100.0)
    for frame in (9.5, 9.99, 10.0, 10.2, 59.9, 60.1):
        one, other = (fg.render([(each, np.eye(4), frame / 120, look)], CAMERA)["rgb"] for each in (whole, source))
        np.testing.assert_array_equal(one, other)
        same_pictures(whole, source, times=[frame / 120], exposure=fg.Exposure(-0.5, 0.5, steps=4))


@pytest.mark.parametrize("appearance", ["sh1", fg.Changing(fg.SH(0), fg.Keyframes(tuple(np.linspace(0, 1, 80))))])
@pytest.mark.parametrize("interpolation", ["linear", "catmull-rom"])
def test_a_table_as_long_as_the_clip_is_kept_in_parts(rng, tmp_path, interpolation, appearance):
    table = fg.Keyframes(tuple(np.linspace(0, 1, 181)), interpolation)
    model = long_model(rng, 40, 180, basis=table, rotation_basis=table, appearance=appearance)
    model.motion[::2], model.rotation_motion[::2] = 0, 0
    source = opened(fg.chapters(model, frames=15), tmp_path / "m.safetensors")
    assert max(source.frame(i).basis.terms for i in range(12)) <= 22
    same_pictures(model, source, exactly=False)
    with pytest.raises(fg.FastGSError, match="open_source"):
        fg.load(tmp_path / "m.safetensors")


def test_memory_is_that_of_what_is_shown(rng, tmp_path, monkeypatch):
    """However long the clip: what is in memory is bounded, the next chapter is there before it is shown, and so is the one before when
    time goes backwards."""
    monkeypatch.setattr(sequence.cache, "limit", 60_000)
    most = []
    for frames in (60, 600):
        n = 4 * frames
        model = long_model(rng, n, frames)
        begin = np.linspace(0, 1, n)
        model = replace(model, temporal=np.stack([begin, begin + 10 / frames, *np.full((2, n), np.log(1 / frames))], -1))
        source = opened(fg.chapters(model, frames=10), tmp_path / "m.safetensors")
        held = []
        for frame in range(frames):
            source.moment(frame / frames)
            [task.result() for task in source._ahead]
            held.append(source.nbytes)
            source.moment(((frame + 10) % frames) / frames, read=False)
        most.append(max(held))
        source.moment(0.5), source.moment(0.499)
        [task.result() for task in source._ahead]
        source.moment(0.5 - 12 / frames, read=False)
    assert most[1] < 60_000 + 10_000 and most[1] < 1.3 * most[0] and model.nbytes > 2 * most[1]


def test_no_jump_at_a_seam(rng, tmp_path):
    model = long_model(rng, 200, temporal="radial")
    source = opened(fg.chapters(model, frames=10), tmp_path / "m.safetensors")
    pictures = [fg.render(source, CAMERA, frame / 120)["rgb"] for frame in np.arange(0, 120, 0.5)]
    steps = np.array([np.abs(after - before).max() for before, after in pairwise(pictures)])
    seams = np.arange(19, len(steps), 20)
    assert steps[seams].max() <= steps.max() * 1.0001 and np.median(steps[seams]) < 1.5 * np.median(np.delete(steps, seams))


def test_what_stays_is_stored_once(rng, tmp_path):
    """Ten times the length of a mostly still scene: at most four times the bytes, by cutting and by joining."""
    still = random_model(rng, 2000, extent=2.0, temporal="always")
    sizes = []
    for times in (1, 10):
        parts = [fg.concatenate([replace(still, clip=fg.Clip(60)), random_model(np.random.default_rng(i), 400, basis="line", extent=2.0)])
                 for i in range(times)]
        source = opened(fg.chapters(*parts, frames=30), tmp_path / "m.safetensors")
        assert source.clip.frame_count == 60 * times and len(source.chapters) == 2 * times
        sizes.append((tmp_path / "m.safetensors").stat().st_size)
        for i, part in enumerate(parts):
            for f in (0, 30.5, 59.9):
                one = fg.render(part, CAMERA, f / 60)["rgb"]
                np.testing.assert_allclose(fg.render(source, CAMERA, (60 * i + f) / (60 * times))["rgb"], one, atol=1e-6)
    assert sizes[1] < 4 * sizes[0]
    assert len(source) == 2000 + 10 * 400


def test_models_follow_each_other_in_their_own_time_and_kinds(rng, tmp_path):
    first, second = long_model(rng, 30, 50), long_model(rng, 40, 80, basis="cosine", temporal="radial", appearance="sigmoid")
    second = replace(second, clip=fg.Clip(80, 48.0))
    source = opened(fg.chapters(first, second, fg.chapters(first, frames=20)), tmp_path / "m.safetensors")
    assert source.clip == fg.Clip(50 + 40 + 50, 24.0) and [chapter.begin for chapter in source.chapters] == [0, 50, 80, 90, 110, 130]
    for model, begin, length in ((first, 0, 50), (second, 50, 40), (first, 90, 50)):
        for share in (0.0, 0.3, 0.97):
            one = fg.render(model, CAMERA, share)["rgb"]
            np.testing.assert_allclose(fg.render(source, CAMERA, (begin + share * length) / 140)["rgb"], one, atol=1e-6)
    with pytest.raises(fg.FastGSError, match="axes"):
        fg.chapters(first, replace(second, axes="RUB"))
    with pytest.raises(fg.FastGSError, match="models"):
        fg.chapters()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::fastgs_blender.LossWarning")
def test_compressed_pieces_and_parts(rng, tmp_path, few_pictures):
    model = long_model(rng, 300, appearance="sigmoid")
    model = replace(model, parts=fg.Parts.of({"Hat": np.arange(300) < 100}))
    fg.save(fg.chapters(model, frames=30), tmp_path / "plain.safetensors")
    fg.save(fg.chapters(model, frames=30), tmp_path / "m.safetensors", "fine")
    assert (tmp_path / "m.safetensors").stat().st_size < 0.8 * (tmp_path / "plain.safetensors").stat().st_size
    assert fg.load(tmp_path / "plain.safetensors").parts["Hat"].sum() == 100
    assert 50 < fg.load(tmp_path / "m.safetensors").parts["Hat"].sum() <= 100
    for t in np.linspace(0, 1, 11):
        one, other = (fg.render(fg.open_source(tmp_path / f"{name}.safetensors"), CAMERA, t)["rgb"] for name in ("m", "plain"))
        assert np.sqrt(np.square(one - other).mean()) < 0.01


def test_what_cannot_be_written_and_what_has_changed(rng, tmp_path):
    model = long_model(rng)
    with pytest.raises(fg.FastGSError, match=r"\.safetensors"):
        fg.save(fg.chapters(model), tmp_path / "m.ply")
    with pytest.raises(fg.FastGSError, match="chapter"):
        fg.chapters(model, frames=0)
    source = opened(fg.chapters(model, frames=10), tmp_path / "m.safetensors")
    before = (tmp_path / "m.safetensors").read_bytes()
    fg.save(fg.chapters(model, frames=10), tmp_path / "m.safetensors")
    assert (tmp_path / "m.safetensors").read_bytes() == before
    fg.save(fg.chapters(model, frames=20), tmp_path / "m.safetensors")
    with pytest.raises(fg.FastGSError, match="changed"):
        source.frame(5)


def test_surroundings_are_written_into_a_clip_in_chapters(rng, tmp_path):
    from fastgs_blender.formats.annotate import annotate

    source = opened(fg.chapters(long_model(rng), frames=30), tmp_path / "m.safetensors")
    annotate(tmp_path / "m.safetensors", backdrop=fg.Backdrop((0, 0, 0), 50.0))
    after = fg.open_source(tmp_path / "m.safetensors")
    assert isinstance(after, fg.Chapters) and len(after.chapters) == len(source.chapters) == 4
    assert after.surroundings.backdrop == after.frame(2).surroundings.backdrop == fg.Backdrop((0, 0, 0), 50.0)


def test_damaged_files(rng, tmp_path):
    seeds = {}
    for name, kinds in (("plain", {"appearance": "sigmoid"}), ("tables", {"basis": fg.Keyframes(tuple(np.linspace(0, 1, 70)))})):
        first = long_model(rng, 12, 20, **kinds)
        fg.save(fg.chapters(first, replace(first, clip=fg.Clip(30)), frames=10), tmp_path / "m.safetensors")
        seeds[name] = {"m.safetensors": (tmp_path / "m.safetensors").read_bytes()}
    told = mutations.campaign("chapters", mutations.shows("m.safetensors"), seeds, tmp_path)
    assert told["refused"] > 0.2 * sum(told.values())

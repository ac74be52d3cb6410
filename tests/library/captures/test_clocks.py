# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras whose clocks differ: sync.json, the moments of their pictures, and the offsets found by motion, by a flash and by sound."""
from __future__ import annotations

import json
import shutil
from dataclasses import replace

import av
import mutations
import numpy as np
import pytest
import tiny_captures
from PIL import Image
from toy_captures import toy_scene
from uneven_captures import write_uneven

from fastgs_blender.captures import open_capture
from fastgs_blender.captures.clocks import epipolar, find, lags
from fastgs_blender.captures.clocks.curves import curves
from fastgs_blender.captures.clocks.files import FILE, Clocks, read_clocks, write_clocks
from fastgs_blender.captures.clocks.find import CHANCE, by_epipolar_planes, find_offsets
from fastgs_blender.captures.clocks.sound import onsets
from fastgs_blender.captures.evidence import differs
from fastgs_blender.evaluation.evaluate import evaluate
from fastgs_blender.evaluation.training_record import record
from fastgs_blender.training.core.schedule import Views
from fastgs_blender.util.errors import FastGSError

FRAMES = 40


@pytest.fixture(scope="module")
def shifted(tmp_path_factory):
    """A capture with two clocks that are wrong."""
    return write_uneven(tmp_path_factory.mktemp("shifted"), FRAMES, 5, {"cam02": 7.3, "cam03": -3.6}, zoom=3)


def times(capture, view):
    """{picture's file number: (frame, t in frames)} of a view."""
    return {int(shot.image.path.stem): (shot.frame, shot.t * capture.clip.frame_count) for shot in capture.shots if shot.view == view}


def test_offsets_are_found_by_motion(shifted):
    found = find_offsets(open_capture(shifted, offsets={}))
    assert found.clocks.found_by == "motion" and not found.lost
    assert found.clocks.offsets == pytest.approx({"cam00": 0, "cam01": 0, "cam02": 7.3, "cam03": -3.6, "cam04": 0}, abs=0.1)
    assert all(0.02 < deviation < 0.12 for deviation in found.clocks.uncertainty.values())


def test_offsets_are_against_those_that_the_capture_has(shifted):
    """As after a satellite's time: what it knows already is not found once more, fractions neither."""
    found = find_offsets(open_capture(shifted, offsets={"cam02": 7.3, "cam03": -2.4}))
    assert found.measured == pytest.approx({"cam00": 0, "cam01": 0, "cam02": 0, "cam03": -1.2, "cam04": 0}, abs=0.15)
    assert {view for view, offset in found.clocks.offsets.items() if offset} == {"cam03"}


def test_without_poses_curves_of_motion_tell_large_offsets_alone(shifted, tmp_path):
    """Curves of genlocked cameras differ by a frame or two, so that such offsets are taken for nothing."""
    for view in range(5):
        shutil.copytree(shifted / f"cam{view:02}", tmp_path / f"cam{view:02}")
    found = find_offsets(open_capture(tmp_path))
    assert found.clocks.offsets == pytest.approx({"cam00": 0, "cam01": 0, "cam02": 7.3, "cam03": -3.6, "cam04": 0}, abs=0.25)
    assert found.curves.change.shape == (5, FRAMES - 1)
    slight = write_uneven(tmp_path / "slight", FRAMES, 5, {"cam02": 1.5})
    (slight / "cameras.json").unlink()
    assert set(find_offsets(open_capture(slight)).clocks.offsets.values()) == {0.0}


@pytest.mark.parametrize("frames", [16, FRAMES])
def test_a_genlocked_capture_stays_as_it_is(frames, tmp_path):
    found = find_offsets(open_capture(write_uneven(tmp_path, frames, 4, zoom=3)))
    assert set(found.clocks.offsets.values()) == {0.0} and not found.lost
    assert max(map(abs, found.measured.values())) < 0.1


def test_cameras_that_take_turns_tell_no_clocks(shifted):
    """One camera a moment, as in D-NeRF's splits: what moves in the frames between is not known."""
    capture = open_capture(shifted, offsets={})
    turns = [shot for shot in capture.shots if shot.frame % len(capture.views) == capture.views.index(shot.view)]
    assert by_epipolar_planes(replace(capture, shots=turns)) is None
    half = [shot for shot in capture.shots if shot.frame % 2 == 0 or shot.view != "cam02"]  # a camera of another rate
    found = by_epipolar_planes(replace(capture, shots=half))
    assert found is not None and found.measured["cam02"] == pytest.approx(7.3, abs=0.7)


@pytest.mark.slow
@pytest.mark.parametrize(("late", "speed"), [(-2.75, 1), (-0.5, 1), (0.3, 1), (3.0, 1), (-1.25, 2), (0.4, 4)])
def test_fractions_are_found_or_called_unsure(late, speed, tmp_path):
    """Edges of fast things come into a plane at whole frames: the fraction is in how many of them come one frame later."""
    found = find_offsets(open_capture(write_uneven(tmp_path, 24, 4, {"cam01": late}, zoom=3, speed=speed), offsets={}))
    for view in ("cam00", "cam02", "cam03"):
        assert found.clocks.offsets[view] == pytest.approx(0, abs=0.1)
    assert "cam01" in found.lost or found.clocks.offsets["cam01"] == pytest.approx(late, abs=0.1)
    assert len(found.lost) < 2


def test_vague_offsets_are_unsure(shifted, monkeypatch):
    """As of a camera whose pose is wrong: its planes show other things than those of the others."""
    capture = open_capture(shifted, offsets={})
    for error, lost in ((0.05, ()), (1.0, ("cam04",))):
        pairs = [lags.Pair(i, j, 6.0 * (j == 4), error if j == 4 else 0.05, 0.5) for j in range(5) for i in range(j)]
        monkeypatch.setattr(epipolar, "pairs", lambda *_, pairs=pairs: (capture.views, pairs))
        found = by_epipolar_planes(capture)
        assert found.lost == lost and found.clocks.offsets["cam04"] == pytest.approx(0.0 if lost else 6.0, abs=0.1)


def test_cameras_that_see_different_things_are_unsure(tmp_path):
    """In two cameras only, squares move of which the other cameras know nothing."""
    folder = write_uneven(tmp_path, 30, 5, zoom=3)
    rng = np.random.default_rng(1)
    for view in (3, 4):
        for frame, (x, y) in enumerate(rng.uniform(0, 80, (30, 2)).astype(int)):
            path = folder / f"cam{view:02}" / f"{frame + 1:04}.png"
            picture = np.full_like(np.array(Image.open(path)), 90)
            picture[y:y + 20, x:x + 20] = 255
            Image.fromarray(picture).save(path)
    found = find_offsets(open_capture(folder))
    assert set(found.lost) == {"cam03", "cam04"} and set(found.clocks.offsets.values()) == {0.0}


def test_curves_that_are_alike_by_chance_tell_no_offsets(tmp_path):
    """Sixteen pictures in which each camera sees something else that moves: some shift always fits."""
    rng = np.random.default_rng(1)
    folder = write_uneven(tmp_path, 16, 10, speed=0.0)
    for view in range(10):
        place = 0.0
        for frame in range(16):
            path = folder / f"cam{view:02}" / f"{frame + 1:04}.png"
            picture = np.array(Image.open(path))
            place += rng.uniform(0.2, 3)
            picture[10:20, int(place):int(place) + 12] = 255
            Image.fromarray(picture).save(path)
    with pytest.raises(FastGSError, match="too different"):
        find_offsets(open_capture(folder))


def test_pictures_are_placed_at_their_moments(shifted, tmp_path):
    bare = open_capture(shifted, offsets={})
    assert times(bare, "cam02")[1] == (0, 0)
    capture = open_capture(shifted, offsets={"cam02": 7.3, "cam03": -3.6})
    late, early = times(capture, "cam02"), times(capture, "cam03")
    count = FRAMES - 7 - 4  # cam02 begins 7 frames late, cam03 ends 4 early
    assert capture.clip.frame_count == count and capture.clip.start_frame == bare.clip.start_frame + 7
    assert late[1] == (0, pytest.approx(0.3)) and late[count] == (count - 1, pytest.approx(count - 0.7)) and len(late) == count
    assert min(early) == 12 and early[12] == (0, pytest.approx(0.4)) and early[FRAMES] == (count - 1, pytest.approx(count - 0.6))
    assert times(capture, "cam01")[8] == (0, 0)
    assert [note for note in capture.notes if "cam02 +7.3, cam03 -3.6" in note] and not capture.faults
    assert [note for note in capture.notes if "cam02 begins with 8; cam03 ends with" in note]
    groups = Views(capture.training, 0).moments
    assert len(groups) == count and {capture.training[i].frame for i in groups[9]} == {9}
    segment = capture.part(3, 20)
    assert times(segment, "cam02")[4] == (0, pytest.approx(0.3))


def test_a_part_of_the_clip_takes_the_pictures_of_its_moments(shifted):
    capture = open_capture(shifted, frames=slice(10, 20, 2), offsets={"cam02": 7.3})
    assert times(capture, "cam02") == {4: (0, pytest.approx(0.15)), 6: (1, pytest.approx(1.15)), 8: (2, pytest.approx(2.15)),
                                       10: (3, pytest.approx(3.15)), 12: (4, pytest.approx(4.15))}


def test_stated_times_move_too(tmp_path):
    write_uneven(tmp_path, 6, 2)
    (tmp_path / "cameras.json").unlink()
    pose = np.diag([1.0, -1, -1, 1])
    frames = [{"file_path": f"cam{v:02}/{f + 1:04}.png", "time": f / 6} for v in range(2) for f in range(6)]
    for frame in frames:
        matrix = pose.copy()
        matrix[0, 3] = 0.2 * int(frame["file_path"][4])
        frame["transform_matrix"] = matrix.tolist()
    (tmp_path / "transforms.json").write_text(json.dumps({"fl_x": 45, "fl_y": 45, "cx": 24, "cy": 18, "w": 48, "h": 36, "frames": frames}))
    write_clocks(tmp_path, Clocks({"cam01": 1.25}))
    capture = open_capture(tmp_path)
    assert times(capture, "cam01") == {n: (n, pytest.approx(n + 0.25)) for n in range(1, 6)}
    assert times(capture, "cam00")[1] == (0, 0)


def test_the_file_beside_the_capture_is_used(shifted, tmp_path):
    folder = write_uneven(tmp_path / "capture", 6, 2)
    assert read_clocks(folder) is None
    path = write_clocks(folder / "cameras.json", Clocks({"cam01": 0.5}, {"cam01": 0.02}, "sound"))
    assert path == folder / FILE and read_clocks(folder) == Clocks({"cam01": 0.5}, {"cam01": 0.02}, "sound")
    assert times(open_capture(folder), "cam01")[1] == (0, pytest.approx(-0.5))
    assert times(open_capture(folder, offsets={}), "cam01")[1] == (0, 0)


@pytest.mark.parametrize(("text", "wrong"), [
    ("{}", "format"), ('{"format": "fast-gs sync", "version": 9, "offsets": {}}', "newer"), ('{"format": "fast-gs sync"}', "offsets"),
    ('{"format": "fast-gs sync", "offsets": {"a": "x"}}', "'a'"), ('{"format": "fast-gs sync", "offsets": {"a": 1e9}}', "between"),
    ("[", "JSON")])
def test_a_file_that_cannot_be_understood_is_told(text, wrong, tmp_path):
    write_uneven(tmp_path, 2, 2)
    (tmp_path / FILE).write_text(text)
    with pytest.raises(FastGSError, match=wrong) as error:
        open_capture(tmp_path)
    assert FILE in str(error.value)


def test_damaged_files(tmp_path):
    folder = write_uneven(tmp_path / "made", 2, 2)
    write_clocks(folder, Clocks({"cam00": 0.5, "cam01": -1.25}, {"cam00": 0.1}, "motion"))
    seed = tiny_captures.contents(folder)

    def read(folder):
        capture = open_capture(folder)
        assert len(capture) and np.isfinite([shot.t for shot in capture.shots]).all()

    mutations.campaign("sync.json", read, {"two cameras": seed}, tmp_path, fixed=set(seed) - {FILE})


def test_nothing_that_moves_and_one_camera_are_told(tmp_path):
    folder = write_uneven(tmp_path, 14, 3, speed=0.0)
    with pytest.raises(FastGSError, match="nothing moves"):
        find_offsets(open_capture(folder))
    capture = open_capture(folder)
    with pytest.raises(FastGSError, match="one camera"):
        find_offsets(replace(capture, shots=[shot for shot in capture.shots if shot.view == "cam01"]))
    with pytest.raises(FastGSError, match="no sound"):
        find_offsets(capture, "sound")
    with pytest.raises(FastGSError, match="no flash"):
        find_offsets(capture, "flash")


def test_a_flash_aligns_cameras_that_see_nothing_else_alike(tmp_path):
    folder = write_uneven(tmp_path, 30, 4, speed=0.0)
    for v, late in enumerate((0, 0, 4, -3)):
        path = folder / f"cam{v:02}" / f"{15 - late:04}.png"
        Image.fromarray(np.uint8(np.minimum(np.asarray(Image.open(path)) + 90.0, 255))).save(path)
    found = find_offsets(open_capture(folder), "flash")
    assert found.clocks.found_by == "flash"
    assert found.clocks.offsets == pytest.approx({"cam00": 0, "cam01": 0, "cam02": 4, "cam03": -3}, abs=0.3)


def film(path, seconds, late, clicks, rate=16_000, codec="aac", delay=0.0):
    """A video of 25 frames a second with sound: clicks at these seconds of an event that the film joins `late` seconds after its begin.

    delay  seconds by which the time stamps of the sound lie behind those of the pictures
    """
    rng = np.random.default_rng(ord(path.name[0]))
    sound = rng.normal(0, 0.01, int(seconds * rate))
    for at in clicks:
        first = round((at - late) * rate)
        if 0 <= first < len(sound) - 400:
            sound[first:first + 400] += 0.5 * rng.normal(0, 1, 400) * np.exp(-np.arange(400) / 80)
    with av.open(str(path), "w") as container:
        pictures = container.add_stream("libx264", rate=25)
        pictures.width, pictures.height, pictures.pix_fmt = 32, 24, "yuv420p"
        audio = container.add_stream(codec, rate=rate, layout="mono")
        for _ in range(int(seconds * 25)):
            container.mux(pictures.encode(av.VideoFrame.from_ndarray(np.full((24, 32, 3), 90, np.uint8), format="rgb24")))
        container.mux(pictures.encode(None))
        size = min(1024, len(sound))
        for k in range(0, len(sound) - size + 1, size):
            frame = av.AudioFrame.from_ndarray(np.float32(sound[None, k:k + size]), format="fltp", layout="mono")
            frame.sample_rate, frame.pts = rate, k + round(delay * rate)
            container.mux(audio.encode(frame))
        container.mux(audio.encode(None))


def test_sound_aligns_videos(tmp_path):
    clicks = np.random.default_rng(3).uniform(0.5, 5.5, 12)
    for name, late in (("a", 0.0), ("b", 0.212), ("c", 0.0)):
        film(tmp_path / f"{name}.mp4", 6, late, clicks)
    found = find_offsets(open_capture(tmp_path))
    assert found.clocks.found_by == "sound"
    assert found.clocks.offsets == pytest.approx({"a": 0, "b": 0.212 * 25, "c": 0}, abs=0.05)


@pytest.mark.parametrize("wrong", [{"rate": 100}, {"delay": 4e6}], ids=str)
def test_sound_that_would_fill_the_memory_is_none(tmp_path, wrong):
    """A rate of 100 samples a second, and sound that begins 46 days after the pictures."""
    film(tmp_path / "a.mkv", 2, 0.0, [], codec="pcm_f32le", **wrong)
    assert onsets(tmp_path / "a.mkv") is None


def test_videos_without_sound_in_common_are_told(tmp_path):
    for name in "ab":
        tiny_captures.video(tmp_path / f"{name}.mp4", 14)
    with pytest.raises(FastGSError, match="no sound"):
        find_offsets(open_capture(tmp_path), "sound")


def test_labels_of_evaluation_do_not_depend_on_clocks(shifted):
    """A picture was trained on whatever the time is that its camera's clock gives it."""
    capture = open_capture(shifted, offsets={"cam02": 0.4}, frames=slice(0, 3))
    model = replace(toy_scene(3), clip=capture.clip, provenance=record(capture, whole=False))
    result = evaluate(model, capture, views=["cam00", "cam02"], lpips=False)
    assert [row["trained_on"] for row in result["rows"]] == [False] * 3 + [True] * 3
    assert result["rows"][3]["t"] == pytest.approx(0.4 / 3)
    whole = open_capture(shifted, offsets={"cam02": 0.4})
    result = evaluate(model, whole, views=["cam02"], frames=[0, 2, 3], lpips=False)
    assert [row["trained_on"] for row in result["rows"]] == [True, True, False]


def test_one_wrong_pair_does_no_harm():
    pairs = [lags.Pair(i, j, (0.0, 1.0, -2.0, 0.0)[j] - (0.0, 1.0, -2.0, 0.0)[i], 0.9, 0.5) for i in range(4) for j in range(i + 1, 4)]
    pairs[0] = replace(pairs[0], lag=9.0)
    offsets, _ = lags.offsets_from_pairs(5, pairs)
    assert offsets[:4] == pytest.approx([0, 1, -2, 0], abs=0.01) and np.isnan(offsets[4])


@pytest.mark.parametrize("vague", [0.3, 0.07])
def test_one_exact_pair_beside_vague_ones_is_alone(vague):
    """The camera at a row's end, to which one neighbour alone is near."""
    pairs = [lags.Pair(i, j, 0.25 * (j == 4), (vague if i < 3 else 0.07) if j == 4 else 0.05, 0.5) for j in range(5) for i in range(j)]
    offsets, deviations = lags.offsets_from_pairs(5, pairs)
    assert offsets == pytest.approx([0, 0, 0, 0, 0.25], abs=0.01)
    assert list(differs(offsets, deviations, find.LEAST)) == [False] * 4 + [vague < 0.1]


def test_what_grows_along_a_rig_is_no_clock(tmp_path, monkeypatch, rng):
    """A thing that turns shows its sides to one camera after the other; three cameras with a clock of their own stand out of that."""
    capture = open_capture(write_uneven(tmp_path, 12, 12, zoom=3), offsets={})
    places = np.array([next(shot.camera.centre for shot in capture.shots if shot.view == view) for view in capture.views])
    slope = places @ [0.3, 0.1, -0.2] / np.ptp(places, axis=0).max()
    for grows, clocks in (1.0, {}), (0.0, {2: 1.5, 7: -0.8, 10: 0.3}), (1.0, {2: 2.5}):
        true = grows * slope + [clocks.get(k, 0.0) for k in range(12)]
        pairs = [lags.Pair(i, j, true[j] - true[i] + rng.normal(0, 0.02), 0.05, 0.5) for i in range(12) for j in range(i + 1, 12)]
        monkeypatch.setattr(epipolar, "pairs", lambda *_, pairs=pairs: (capture.views, pairs))
        found = by_epipolar_planes(capture)
        assert {capture.views.index(view) for view, offset in found.clocks.offsets.items() if offset} == set(clocks)
        assert bool(found.lost) == bool(grows)
    few = lags.grown(np.array([0.0, 1.0, 2.0, np.nan]), places[:4])
    assert (few == 0).all()


def test_values_between_samples():
    values = np.arange(6.0) ** 2
    assert lags.between(values, np.array([2.5, 3.0])) == pytest.approx([6.25, 9.0])


def test_two_cameras_that_are_alike_are_not_against_all_others(shifted, monkeypatch):
    capture, two = open_capture(shifted, offsets={}), [lags.Pair(0, 2, 7.3, 1.0, 0.5, 0.95, 40.0)]
    monkeypatch.setattr(find, "compared", lambda lines, i, j, most, error: two[0] if (i, j) == (0, 2) else None)
    with pytest.raises(FastGSError, match="too different"):
        find._by_curves(capture, curves(capture))


def test_slow_curves_have_fewer_samples_of_their_own(rng):
    """Curves that know nothing of each other: where they change slowly, some shift makes them as alike as fast ones never are."""
    kinds = {"fast": np.array([1.0]), "slow": np.hanning(11)[1:-1]}
    for kind, weights in kinds.items():
        lines = [np.convolve(rng.normal(0, 1, 60), weights, "same")[10:50] for _ in range(24)]
        pairs = [lags.compared(lines, i, i + 1, 20, 1.0) for i in range(0, 24, 2)]
        taken = [pair for pair in pairs if pair.alike >= np.tanh(CHANCE / np.sqrt(max(pair.common - 3, 1e-6)))]
        assert not taken
        assert kind == "fast" or max(pair.alike * 20**0.5 for pair in pairs) > 3.5  # what counted once
        share = np.mean([pair.common for pair in pairs]) / 40
        assert share > 0.6 if kind == "fast" else share < 0.4

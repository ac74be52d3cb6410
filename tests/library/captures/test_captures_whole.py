# SPDX-License-Identifier: GPL-3.0-or-later
"""What is missing or damaged is left out, films of other lengths are cut, and the rest is the list of what is wrong with a capture."""
from __future__ import annotations

import shutil
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from fastgs_blender.captures import open_capture
from fastgs_blender.captures.pixels.checks import check, problems
from fastgs_blender.captures.pixels.store import FrameStore
from fastgs_blender.util.errors import FastGSError

WIDTH, HEIGHT = 40, 30


def test_nothing_wrong(capture):
    assert problems(capture) == []
    check(capture)


def test_everything_wrong_is_told_at_once(capture):
    folder = capture.path
    (folder / "cam0" / "0003.png").unlink()
    (folder / "cam0" / "0004.png").unlink()
    (folder / "cam1" / "0002.png").write_bytes(b"")
    (folder / "cam1" / "0005.png").write_bytes(b"no picture")
    Image.fromarray(np.zeros((20, 20, 3), np.uint8)).save(folder / "cam2" / "0006.png")
    (folder / "masks" / "cam0").mkdir(parents=True)
    Image.fromarray(np.zeros((9, 9), np.uint8)).save(folder / "masks" / "cam0" / "0001.png")
    found = open_capture(folder)
    (told,) = found.notes
    for words in ("4 of 24 pictures", "cam0 lacks 2 frames: 3-4", f"{Path('cam1/0002.png')}: the picture is empty",
                  f"{Path('cam1/0005.png')}: the picture cannot be read (it is no PNG or JPEG)"):
        assert words in told
    assert len(found) == 20 and str(folder) not in told
    found = "\n".join(problems(found))
    for words in ("cam2 has pictures of 20 x 20 pixels where its calibration is for 40 x 30 (frames 6)", "masks of 9 x 9",
                  "cam0 has masks for some of its frames only"):
        assert words in found
    with pytest.raises(FastGSError, match="there are 3 problems") as error:
        check(open_capture(folder))
    assert str(error.value).startswith(str(folder)) and "\n" not in str(error.value)
    assert not open_capture(folder, frames=slice(6, None)).faults  # the part asked for is whole


@pytest.mark.parametrize(("count", "refused"), [(8, False), (9, True)])
def test_up_to_a_third_of_the_pictures_may_be_damaged(capture, count, refused):
    for shot in capture.shots[3:3 + count]:
        shot.image.path.write_bytes(b"x")
    found = open_capture(capture.path)
    assert len(found) == 24 - count and f"and {count - 6} more" in (found.faults if refused else found.notes)[0]
    assert bool(problems(found)) == refused


@pytest.mark.parametrize(("ending", "more"), [("png", b""), ("jpg", b""), ("jpg", b"what some cameras append")])
def test_a_picture_that_ends_early_is_left_out_before_it_is_decoded(capture, cache, ending, more):
    path = capture.shots[4].image.path
    noise = Image.fromarray(np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8))
    whole = path.with_suffix(f".{ending}")
    path.unlink()
    noise.save(whole)
    whole.write_bytes(whole.read_bytes() + more)
    assert not open_capture(capture.path).notes
    whole.write_bytes(whole.read_bytes()[:-25 - len(more)])
    damaged = open_capture(capture.path)
    assert "1 of 24 pictures" in damaged.notes[0] and f"{Path('cam1', whole.name)}: " in damaged.notes[0]
    check(damaged)
    FrameStore(damaged, folder=cache).fill()
    assert [shot.frame for shot in damaged.shots if shot.view == "cam1"] == [0, 2, 3, 4, 5, 6, 7], "the others keep their moments"


def test_a_picture_that_is_damaged_inside_is_found_while_filling(capture, cache):
    path = capture.shots[4].image.path
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)).save(path)
    path.write_bytes(path.read_bytes()[:900] + path.read_bytes()[-12:])
    damaged = open_capture(capture.path)
    assert not problems(damaged)
    store = FrameStore(damaged, folder=cache)
    with pytest.raises(FastGSError, match=path.name) as error:
        store.fill()
    assert "a problem" in str(error.value)
    assert store.missing() == [damaged.shots[4]]


def test_whole_cameras_that_are_missing(capture):
    shutil.rmtree(capture.path / "cam1")
    found = open_capture(capture.path)
    assert not problems(found) and found.views == ["cam0", "cam2"] and "cam1 lacks 8 frames: 1-8" in found.notes[0]
    shutil.rmtree(capture.path / "cam2")
    assert "16 of its 24 pictures are missing" in problems(open_capture(capture.path))[0]


def write_videos(folder, *videos):
    """Films of 32 x 32 pixels: (name, rate, number of frames) each."""
    for name, rate, count in videos:
        with av.open(str(folder / f"{name}.mp4"), "w") as container:
            stream = container.add_stream("mpeg4", rate=rate)
            stream.width, stream.height = 32, 32
            for _ in range(count):
                container.mux(stream.encode(av.VideoFrame(32, 32, "yuv420p")))
            container.mux(stream.encode(None))


def test_videos_of_different_length_and_rate(tmp_path):
    write_videos(tmp_path, ("a", 25, 10), ("b", 30, 10), ("c", 25, 7))
    (tmp_path / "d.mp4").write_bytes(b"x")
    capture = open_capture(tmp_path)
    assert not problems(capture) and "25, 30" in capture.notes[0], "by their time stamps"
    assert any("d.mp4" in text and "(Invalid data" in text for text in capture.notes), "one of four is left out"


def test_the_frames_that_all_films_have_are_used(tmp_path):
    """Films end at different times, and begin at different ones where sync.json says so."""
    write_videos(tmp_path, ("a", 25, 20), ("b", 25, 18), ("c", 25, 20))
    capture = open_capture(tmp_path)
    assert capture.clip.frame_count == 18 and len(capture) == 54 and not problems(capture)
    assert capture.notes == ["the frames 0-17 are used, which all cameras have: b ends with 17"]
    (tmp_path / "sync.json").write_text('{"format": "fast-gs sync", "version": 1, "offsets": {"a": 0, "b": 0, "c": 4}}')
    capture = open_capture(tmp_path)
    assert (capture.clip.frame_count, capture.clip.start_frame, len(capture)) == (14, 4, 42) and not problems(capture)
    assert [shot.image.frame for shot in capture.at_frame(0)] == [4, 4, 0], "each its own picture of that moment"
    assert any("frames 4-17" in note and "c begins with 4; b ends with 17" in note for note in capture.notes)
    part = open_capture(tmp_path, frames=slice(2, 12, 3))  # 2, 5, 8, 11
    assert [shot.image.frame for shot in part.shots if shot.view == "c"] == [1, 4, 7] and part.clip.start_frame == 5
    assert len(open_capture(tmp_path, frames=slice(5, 9)).notes) == 1, "all of what was asked for is there"
    (tmp_path / "sync.json").write_text('{"format": "fast-gs sync", "version": 1, "offsets": {"a": 0, "b": 0, "c": 11}}')
    (problem,) = problems(open_capture(tmp_path))
    assert "7 of 20 frames" in problem and "c begins with 11" in problem


def test_offsets_come_on_top_of_time_stamps(tmp_path):
    """Phones film at 24 or 30 frames per second, whatever they were told; clocks are in frames of the time line."""
    write_videos(tmp_path, ("a", 30, 20), ("b", 24, 16))
    (tmp_path / "sync.json").write_text('{"format": "fast-gs sync", "version": 1, "offsets": {"a": 0.0, "b": 2.25}}')
    capture = open_capture(tmp_path)
    assert not problems(capture) and capture.clip.fps == 30 and capture.clip.frame_count >= 17
    for shot in capture.shots:
        moment = shot.t * capture.clip.frame_count + capture.clip.start_frame
        assert moment == pytest.approx(shot.image.frame if shot.view == "a" else shot.image.frame * 30 / 24 + 2.25, abs=0.02)


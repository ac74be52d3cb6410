# SPDX-License-Identifier: GPL-3.0-or-later
"""The timecode of films is the first clock of their cameras, where it can be one."""
from __future__ import annotations

import numpy as np
import pytest

from fastgs_blender.captures import first_clocks, open_capture
from fastgs_blender.captures.clocks.files import Clocks, write_clocks
from fastgs_blender.captures.clocks.find import find_offsets
from fastgs_blender.captures.clocks.timecode import frame_of


def write_films(folder, begun, frames=48, ending="mov"):
    """Films of a square that darts about: name -> (timecode or None, moment of the first frame)."""
    av = pytest.importorskip("av")
    steps = np.random.default_rng(3).uniform(0, 6, 400)
    for name, (timecode, first) in begun.items():
        with av.open(str(folder / f"{name}.{ending}"), "w") as container:
            stream = container.add_stream("libx264", rate=30)
            stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
            if timecode:
                stream.metadata["timecode"] = timecode
            for moment in range(first, first + frames):
                picture = np.full((48, 64, 3), 60, np.uint8)
                x = int(20 + 18 * np.sin(steps[:moment].sum() / 7))
                picture[10:30, x:x + 14] = 220
                container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            container.mux(stream.encode(None))


@pytest.mark.parametrize(("timecode", "fps", "frame"), [
    ("00:00:01:05", 30, 35), ("01:00:00:00", 25, 90000), ("00:01:00;02", 29.97, 1800), ("00:10:00;00", 29.97, 17982),
    ("00:01:00;04", 59.94, 3600), ("00:00:59;29", 29.97, 1799), ("noon", 30, None)])
def test_frames_that_timecodes_name(timecode, fps, frame):
    assert frame_of(timecode, fps) == frame


@pytest.mark.parametrize("ending", ["mov", "mp4"])
def test_films_are_aligned_by_their_timecode(tmp_path, ending):
    write_films(tmp_path, {"a": ("10:00:00:00", 0), "b": ("10:00:00:00", 0), "c": ("10:00:00:11", 11)}, ending=ending)
    assert first_clocks(tmp_path) == {"a": 0, "b": 0, "c": 11}
    capture = open_capture(tmp_path)
    assert capture.clip.frame_count == 37 and [shot.image.frame for shot in capture.at_frame(0)] == [11, 11, 0]
    assert "timecode" in capture.notes[-1] and not open_capture(tmp_path, offsets={}).notes
    assert find_offsets(capture).measured == pytest.approx({"a": 0, "b": 0, "c": 0}, abs=1e-6), "the pictures agree"
    write_clocks(tmp_path, Clocks({"c": 10.5}))
    assert not any("timecode" in note for note in open_capture(tmp_path).notes), "sync.json knows better"


@pytest.mark.parametrize("third", ["10:00:01:00", "10:01:00:00", None])
def test_timecodes_that_are_no_clock(tmp_path, third):
    """A film that has none, or whose clock nobody set: less than half of it would be common.  Past midnight is no day."""
    write_films(tmp_path, {"a": ("10:00:00:00", 0), "b": ("10:00:00:02", 0), "c": (third, 0)})
    assert first_clocks(tmp_path) == {}
    write_films(tmp_path, {"a": ("23:59:59:29", 0), "b": ("00:00:00:01", 2), "c": ("00:00:00:00", 1)})
    assert first_clocks(tmp_path) == {"a": -1, "b": 1, "c": 0}

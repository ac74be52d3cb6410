# SPDX-License-Identifier: GPL-3.0-or-later
"""Films as phones write them: varying and different rates, turned, HDR; each picture is at the moment at which it was taken."""
import struct
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from fastgs_blender.cameras.lens import Lens
from fastgs_blender.cameras.opencv import Calibrated
from fastgs_blender.captures import film_times, open_capture
from fastgs_blender.captures.layouts.fastgs import write_cameras
from fastgs_blender.captures.pixels import video
from fastgs_blender.captures.pixels.checks import problems
from fastgs_blender.util.errors import FastGSError

av = pytest.importorskip("av")
BASE = Fraction(1, 90_000)


def film(path, seconds, draw, size=(48, 32), **colours):
    """A film whose pictures are draw(time), [h, w] grey."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"qp": "0"})
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        stream.codec_context.time_base = stream.time_base = BASE
        for name, value in colours.items():
            setattr(stream.codec_context, name, value)
        for time in seconds:
            frame = av.VideoFrame.from_ndarray(np.repeat(draw(time)[..., None], 3, 2).astype(np.uint8), format="rgb24")
            frame.pts, frame.time_base = round(float(time / BASE)), BASE
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def turn_tag(path, quarters):
    """Players turn the film's pictures clockwise by so many quarters from now on."""
    data = bytearray(path.read_bytes())
    at = data.find(b"tkhd") + 8 + 20 + 16
    cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarters]
    data[at:at + 36] = struct.pack(">9i", cos << 16, sin << 16, 0, -sin << 16, cos << 16, 0, 0, 0, 1 << 30)
    path.write_bytes(bytes(data))


def brightness(time):
    return np.full((32, 48), 40 + 150 * time)


def test_pictures_are_at_the_moments_of_their_time_stamps(tmp_path):
    """One film at 30 frames a second, one that varies, as phones do, one at 60, one at 29.97 that drops two pictures."""
    rng = np.random.default_rng(4)
    even = np.arange(30) / 30
    film(tmp_path / "a.mp4", even, brightness)
    film(tmp_path / "b.mp4", np.r_[0, np.cumsum(rng.uniform(0.025, 0.041, 29))], brightness)
    film(tmp_path / "c.mp4", np.arange(60) / 60, brightness)
    film(tmp_path / "d.mp4", np.delete(np.arange(30) / 29.97, [11, 12]), brightness)
    capture = open_capture(tmp_path)
    assert not problems(capture) and any("time stamps" in note and "60" in note for note in capture.notes)
    assert capture.clip.fps == pytest.approx(30, abs=0.1) and 27 <= capture.clip.frame_count <= 30
    late = []
    for shot in capture.shots:
        ((_, picture),) = video.frames(shot.image.path, [shot.image.frame])
        when = capture.clip.frame_count * shot.t / capture.clip.fps
        late.append((picture.mean() - 40) / 150 - when)
    assert np.abs(late).max() < 0.015, "brightness has 256 steps, 7 ms each"
    assert not [shot for shot in capture.shots if shot.view == "d" and shot.frame in (11, 12)], "nobody else's picture stands in"


def test_films_of_one_even_rate_stay_frame_by_frame(tmp_path):
    for name in "ab":
        film(tmp_path / f"{name}.mp4", np.arange(8) / 25, brightness)
    capture = open_capture(tmp_path)
    assert [(shot.frame, shot.image.frame) for shot in capture.shots if shot.view == "b"] == [(k, k) for k in range(8)]
    assert not capture.notes and {shot.t for shot in capture.shots} == {k / 8 for k in range(8)}


def test_time_stamps_that_jump_far_end_in_a_sentence(tmp_path, monkeypatch):
    for name in "ab":
        film(tmp_path / f"{name}.mp4", np.arange(8) / 25, brightness)

    def damaged(path):
        known = video.index(path)
        return known if path.stem == "a" else replace(known, stamps=(*known.stamps[:-1], 1 << 50), constant=False)

    monkeypatch.setattr(film_times, "index", damaged)
    with pytest.raises(FastGSError, match=r"b\.mp4.*constant frame rate"):
        open_capture(tmp_path)


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_turned_film_is_read_as_players_show_it(tmp_path, quarters):
    shown = np.zeros((32, 48))
    shown[:8, :12] = 220  # the upper left corner
    stored = np.rot90(shown, quarters)
    path = film(tmp_path / "v.mp4", [0, 0.04], lambda time: stored, stored.shape[::-1])
    turn_tag(path, quarters)
    found = video.index(path)
    ((_, picture),) = video.frames(path, [1])
    assert (found.width, found.height) == (48, 32) and picture.shape == (32, 48, 3)
    assert picture[2:6, 2:10].min() > 200 and picture[16:].max() < 20 and picture[:, 24:].max() < 20


@pytest.mark.parametrize(("quarters", "words"), [(1, "display_rotation 0"), (2, "")])
def test_a_calibration_of_unturned_pictures_is_told(tmp_path, quarters, words):
    """Films are read upright, which is said: by a quarter turn sizes show that the calibration is not, by half a turn nothing does."""
    cameras = [dict(name=name, width=48, height=32, fx=40, fy=40, cx=24, cy=16, world_to_camera=np.eye(4)) for name in "ab"]
    write_cameras(tmp_path, cameras, frame_count=2, fps=25)
    for name in "ab":
        turn_tag(film(tmp_path / f"{name}.MP4", [0, 0.04], brightness), quarters)
    capture = open_capture(tmp_path)
    assert len(capture.notes) == 1 and "of a, b" in capture.notes[0] and "turned" in capture.notes[0]
    found = problems(capture)
    assert len(found) == (2 if words else 0) and all(words in problem for problem in found)
    camera = Calibrated("a", np.eye(3), Lens(), np.eye(4), (48, 32))
    with pytest.raises(FastGSError, match="display_rotation 0"):
        camera.intrinsics((32, 48), "a.mp4")
    with pytest.raises(FastGSError, match="cropped"):
        camera.intrinsics((48, 20), "a.mp4")


def test_hdr_films_beside_others_are_told(tmp_path):
    for name, transfer in (("a", 1), ("b", 16), ("c", 1)):
        film(tmp_path / f"{name}.mp4", np.arange(4) / 25, brightness, color_trc=transfer)
    notes = open_capture(tmp_path).notes
    assert len(notes) == 1 and "of b are HDR" in notes[0] and "SDR" in notes[0]
    for name in "ac":
        (tmp_path / f"{name}.mp4").unlink()
        film(tmp_path / f"{name}.mp4", np.arange(4) / 25, brightness, color_trc=16)
    assert not open_capture(tmp_path).notes, "all of them alike"

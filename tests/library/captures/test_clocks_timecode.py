# SPDX-License-Identifier: GPL-3.0-or-later
"""The GPS time or the timecode of films is the first clock of their cameras, where it can be one."""
from __future__ import annotations

import struct
from fractions import Fraction

import av
import numpy as np
import pytest

from fastgs_blender.captures import first_clocks, open_capture
from fastgs_blender.captures.clocks.files import Clocks, write_clocks
from fastgs_blender.captures.clocks.find import find_offsets
from fastgs_blender.captures.clocks.gpmf import first_frame_utc
from fastgs_blender.captures.clocks.timecode import frame_of


def write_films(folder, begun, frames=48, ending="mov", telemetry=lambda name: []):
    """Films of a square that darts about: name -> (timecode or None, moment of the first frame), with payloads of GPMF by the second."""
    steps = np.random.default_rng(3).uniform(0, 6, 400)
    for name, (timecode, first) in begun.items():
        with av.open(str(folder / f"{name}.{ending}"), "w") as container:
            stream = container.add_stream("libx264", rate=30)
            stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
            if timecode:
                stream.metadata["timecode"] = timecode
            if payloads := telemetry(name):
                data = container.add_data_stream("bin_data")  # which the muxer calls gpmd
                data.time_base = Fraction(1, 1000)
            for second, payload in enumerate(payloads):
                packet = av.Packet(payload)
                packet.stream, packet.time_base, packet.pts, packet.dts = data, data.time_base, 1000 * second, 1000 * second
                container.mux(packet)
            for moment in range(first, first + frames):
                picture = np.full((48, 64, 3), 60, np.uint8)
                x = int(20 + 18 * np.sin(steps[:moment].sum() / 7))
                picture[10:30, x:x + 14] = 220
                container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            container.mux(stream.encode(None))


def entry(key, kind, size, values):
    """An entry of GPMF: key, type, size of a value, count of values; padded to 4 bytes."""
    return struct.pack(">4scBH", key, kind, size, len(values) // size) + values + bytes(-len(values) % 4)


def payload(milliseconds, fix=3, ninth=False):
    """A payload of a GoPro (HERO5 to 10; ninth: HERO11 and 13) so many milliseconds after noon of the 1st of March 2026."""
    noon, days = 12 * 3_600_000, 9556
    if ninth:
        places = entry(b"GPS9", b"?", 32, struct.pack(">7l2H", 0, 0, 0, 0, 0, days, noon + milliseconds, 154, fix))
    else:
        second, rest = divmod(milliseconds, 1000)
        places = (entry(b"GPSF", b"L", 4, struct.pack(">L", fix)) + entry(b"GPSP", b"S", 2, struct.pack(">H", 154))
                  + entry(b"GPSU", b"U", 16, b"2603011200%02d.%03d" % (second, rest)))
    other = entry(b"STRM", b"\0", 1, entry(b"STNM", b"c", 1, b"gyroscope"))
    return entry(b"DEVC", b"\0", 1, entry(b"DVID", b"L", 4, bytes(4)) + other + entry(b"STRM", b"\0", 1, places))


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


@pytest.mark.parametrize("ninth", [False, True])
def test_satellites_know_better_than_the_cameras_clock(tmp_path, ninth):
    """The third film begins 11 frames later by GPS.  Its timecode is wrong, and so is the first payload of each film, as real ones are."""
    late = {"a": 0, "b": 0, "c": 11}

    def telemetry(name):
        begun = 5000 + round(1000 * late[name] / 30)
        return [payload(begun - 1500, ninth=ninth), *(payload(begun + 1000 * k + 30 * (k % 2), ninth=ninth) for k in range(1, 5))]

    films = {"a": ("10:00:00:00", 0), "b": ("10:00:00:00", 0), "c": ("10:00:00:05", 11)}
    write_films(tmp_path, films, ending="mp4", telemetry=telemetry)
    assert first_clocks(tmp_path) == late and "GPS time" in open_capture(tmp_path).notes[-1]
    write_films(tmp_path, films, ending="mp4", telemetry=lambda name: telemetry(name) if name != "b" else [payload(5000, fix=0)] * 5)
    assert first_clocks(tmp_path) == {"a": 0, "b": 0, "c": 5}, "one film without satellites: all go by timecode"


@pytest.mark.parametrize("damaged", [b"DEVC", payload(5000)[:-6], b"DEVC\0\xff\xff\xff" + bytes(40),
                                     payload(5000).replace(b"2603", b"26xx")])
def test_damaged_telemetry_is_no_clock(tmp_path, damaged):
    write_films(tmp_path, {"a": (None, 0)}, ending="mp4", telemetry=lambda name: [damaged] * 4)
    assert first_frame_utc(tmp_path / "a.mp4") is None

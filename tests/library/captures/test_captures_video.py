# SPDX-License-Identifier: GPL-3.0-or-later
"""Videos are decoded frame-exactly: every frame carries its number, and is found by it."""
from __future__ import annotations

import contextlib
from fractions import Fraction
from itertools import islice

import av
import numpy as np
import pytest

from fastgs_blender.captures.pixels import video
from fastgs_blender.util.errors import FastGSError

SIZE = 64, 48
COUNT = 90


def picture(number: int) -> np.ndarray:
    """Twelve blocks, black or white: the number's bits."""
    bits = (number >> np.arange(12)) & 1
    return np.repeat(np.kron(bits.reshape(3, 4), np.ones((16, 16))).astype(np.uint8)[..., None] * 255, 3, 2)


def number_in(rgb: np.ndarray) -> int:
    bits = rgb[8::16, 8::16].mean(-1) > 128
    return int((bits.ravel() << np.arange(12)).sum())


def write(path, codec="libx264", stamps=None, container_options=None, count=COUNT, base=Fraction(1, 1000), title="", **options):
    """A video whose frames carry their numbers; stamps: their times in units of base."""
    with av.open(str(path), "w", options=container_options or {}) as container:
        container.metadata["title"] = title
        stream = container.add_stream(codec, rate=25, options={"qp": "0"} | options if codec == "libx264" else options)
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        if stamps is not None:
            stream.codec_context.time_base = stream.time_base = base
        for i in range(count):
            frame = av.VideoFrame.from_ndarray(picture(i), format="rgb24")
            if stamps is not None:
                frame.pts, frame.time_base = stamps[i], base
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


UNEVEN = np.cumsum([40, 20, 80, 33, 47] * (COUNT // 5)).tolist()
KINDS = {
    "key frames only": dict(g="1"),
    "B-frames and few key frames": dict(bf="3", g="30"),
    "open groups of pictures": {"bf": "3", "g": "15", "x264-params": "open-gop=1:b-pyramid=2", "sc_threshold": "0"},
    "one key frame": dict(bf="2", g="1000", sc_threshold="0"),
    "varying frame rate": dict(bf="2", g="20", stamps=UNEVEN),
    "a first time stamp above 0": dict(bf="2", g="20", stamps=[5000 + 40 * i for i in range(COUNT)]),
    "MPEG-4": dict(codec="mpeg4", bf="2", g="12", **{"q:v": "2"}),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("suffix", ["mp4", "mkv"])
def test_every_frame_is_found_by_its_number(tmp_path, kind, suffix):
    path = write(tmp_path / f"v.{suffix}", **KINDS[kind])
    found = video.index(path)
    assert (found.count, found.width, found.height) == (COUNT, *SIZE)
    assert [(i, number_in(rgb)) for i, rgb in video.frames(path, range(COUNT))] == [(i, i) for i in range(COUNT)]
    some = [3, 4, 71, 89]  # a jump in between
    assert [(i, number_in(rgb)) for i, rgb in video.frames(path, some)] == [(i, i) for i in some]
    for i in (0, 1, 16, 31, 45, 88):
        assert [number_in(rgb) for _, rgb in video.frames(path, [i])] == [i]


def test_edit_list_that_hides_the_first_frames(tmp_path):
    """Frames that a player does not show are no frames of the video."""
    path, cut = write(tmp_path / "v.mp4", bf="0", g="10"), tmp_path / "cut.mp4"
    with av.open(str(path)) as source, av.open(str(cut), "w") as target:
        stream = source.streams.video[0]
        copy = target.add_stream_from_template(stream)
        seven = int(7 / stream.average_rate / stream.time_base)
        for packet in source.demux(stream):
            if packet.dts is not None:
                packet.pts -= seven
                packet.dts = packet.pts
                packet.stream = copy
                target.mux(packet)
    with av.open(str(cut)) as container:
        shown = [number_in(frame.to_ndarray(format="rgb24")) for frame in container.decode(video=0)]
    assert video.index(cut).count == len(shown) < COUNT
    assert [number_in(rgb) for _, rgb in video.frames(cut, range(len(shown)))] == shown
    assert [number_in(rgb) for _, rgb in video.frames(cut, [20, 40])] == [shown[20], shown[40]]


def test_stream_without_time_stamps(tmp_path):
    path = write(tmp_path / "v.h264", bf="0", g="10")
    assert [number_in(rgb) for _, rgb in video.frames(path, [0, 33, 89])] == [0, 33, 89]


def test_rate_and_evenness(tmp_path):
    even, uneven = video.index(write(tmp_path / "a.mkv")), video.index(write(tmp_path / "b.mkv", stamps=UNEVEN))
    assert (even.fps, even.constant, uneven.constant) == (25, True, False)
    assert video.index(write(tmp_path / "c.mp4", stamps=[5000 + 40 * i for i in range(COUNT)])).count == COUNT


def test_what_cannot_be_read_is_one_sentence(tmp_path):
    whole = write(tmp_path / "v.mkv", bf="2", g="30")
    (tmp_path / "empty.mp4").write_bytes(b"")
    (tmp_path / "text.mp4").write_text("no video")
    (tmp_path / "header.mkv").write_bytes(whole.read_bytes()[:200])
    for name in ("empty.mp4", "text.mp4", "header.mkv", "none.mp4"):
        with pytest.raises(FastGSError, match=name) as error:
            video.index(tmp_path / name)
        assert "\n" not in str(error.value)
    with pytest.raises(FastGSError, match="no frame 90"):
        list(video.frames(whole, [90]))


def test_a_title_that_is_no_utf_8(tmp_path):
    """As older cameras and programs write it.  It was refused, and the file stayed open until Python collected what it no longer needs."""
    path = write(tmp_path / "a.mp4", count=2, title="Cafe")
    path.write_bytes(path.read_bytes().replace(b"Cafe", b"Caf\xe9"))
    assert video.index(path).count == 2


def test_damage_within_a_video_never_gives_wrong_frames(tmp_path):
    path = write(tmp_path / "v.mp4", bf="2", g="10")
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle:middle + 800] = bytes(800)
    path.write_bytes(data)
    numbers = []
    with contextlib.suppress(FastGSError):
        for number, _ in video.frames(path, range(COUNT)):
            numbers.append(number)
    assert numbers == list(range(len(numbers))) and len(numbers) > 20


def test_a_video_cut_short_tells_it(tmp_path):
    path = write(tmp_path / "v.mkv", bf="2", g="10")
    short = tmp_path / "short.mkv"
    short.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    found = video.index(short)
    assert 0 < found.count < COUNT
    assert [number_in(rgb) for _, rgb in video.frames(short, range(found.count - 2))] == list(range(found.count - 2))


@pytest.mark.parametrize("packets", [20, 21, 22, 23])
def test_a_film_that_was_cut_without_decoding_has_no_torn_end(tmp_path, packets):
    """Packets lie in the order of decoding: the last ones of a cut film are shown after frames that are gone."""
    write(tmp_path / "whole.mp4", codec="mpeg4", count=40, bf="2", g="12", **{"q:v": "2"})
    with av.open(str(tmp_path / "whole.mp4")) as source, av.open(str(tmp_path / "cut.mp4"), "w") as container:
        stream = container.add_stream_from_template(source.streams.video[0])
        for packet in islice((each for each in source.demux(video=0) if each.dts is not None), packets):
            packet.stream = stream
            container.mux(packet)
    known = video.index(tmp_path / "cut.mp4")
    assert packets - 5 <= known.count <= packets and known.constant and known.fps == 25
    shown = [(number, number_in(rgb)) for number, rgb in video.frames(tmp_path / "cut.mp4", range(known.count))]
    assert shown == [(number, number) for number in range(known.count)]

# SPDX-License-Identifier: GPL-3.0-or-later
"""Videos, frame by frame: frame i is the i-th that a player shows, whatever its time stamp and however the file orders its packets.

Time stamps come from the packets without decoding.  Reading begins at the key frame before the wanted frame; a file without time
stamps, or whose decoder drops frames after a jump, is read from its beginning.
"""
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from ...util.errors import FastGSError
from ...util.reading import open_file, reading
from .limits import check_size

MOST_FRAMES = 1_000_000
MOST_PIXELS_A_BYTE = 1 << 13
"""A video of a few black frames has some 3000."""
TORN = 16
"""Frames at the end of a film among which some may be missing: a cut, or a file that ends early, takes away what comes last in the file,
which is not what is shown last.  Those behind the first gap are left out."""
HDR = (16, 18)
"""Transfer characteristics of ITU-T H.273: PQ and HLG."""
MARGIN = 1 << 16
"""Pixels beyond its size that a decoder may need for whole blocks at the edges: codecs round a side up to 64 or 128."""
OPTIONS = {"format_whitelist": "mov,matroska,avi,mpeg,mpegts,mpegvideo,h264,hevc,m4v", "protocol_whitelist": "file"}
"""Containers of VIDEOS alone: a playlist, which FFmpeg knows as well, would open other files and addresses."""


@dataclass(frozen=True)
class Index:
    """The frames of a video: their number, size as shown, frames per second, and time stamps in order (None: the file has none).

    first      seconds of the first frame
    constant   whether all frames are equally far apart
    timecode   of the first frame, HH:MM:SS:FF, or empty
    turns      quarter turns counterclockwise by which players show its pictures, as phones that film upright ask for
    base       seconds of a unit of the time stamps
    wide       whether its brightness is that of HDR (PQ or HLG), which looks pale beside other films
    """

    count: int
    width: int
    height: int
    fps: float
    first: float
    constant: bool
    stamps: tuple[int, ...] | None
    timecode: str = ""
    turns: int = 0
    wide: bool = False
    base: float = 0.0

    @property
    def seconds(self) -> np.ndarray | None:
        """Times of the frames [count] after the first; None where the file has no time stamps."""
        return None if self.stamps is None else self.base * (np.array(self.stamps, np.float64) - self.stamps[0])


def index(path: Path) -> Index:
    """The index of a video; raises FastGSError where it cannot be read or has no frames."""
    with reading(path):
        stat = path.stat()
    return _index(path, (stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns, stat.st_ino))


@lru_cache(maxsize=512)
def _index(path: Path, _version: tuple) -> Index:
    with _opened(path) as container:
        stream = container.streams.video[0]
        size = stream.codec_context.width, stream.codec_context.height
        check_size(path, *size, path.stat().st_size * MOST_PIXELS_A_BYTE)
        packets = (packet.pts for packet in container.demux(stream) if packet.size and not packet.is_discard)
        stamps = list(islice(packets, MOST_FRAMES + 1))
        base, rate = stream.time_base, stream.average_rate or stream.guessed_rate
        if not stamps:
            raise FastGSError(f"{path}: the video holds no frames; it is damaged or was cut short.")
        if len(stamps) > MOST_FRAMES:
            raise FastGSError(f"{path}: the video has more than the {MOST_FRAMES} frames that are read; cut it into shorter ones.")
        timecode = next((text for each in (stream, container, *container.streams.data) if (text := each.metadata.get("timecode"))), "")
        turns, wide = _turns(path, size), stream.codec_context.color_trc in HDR
        return replace(_timed(stamps, base, rate, size[::-1] if turns % 2 else size), timecode=timecode, turns=turns, wide=wide)


def _turns(path: Path, size: tuple[int, int]) -> int:
    """Index.turns: PyAV tells them with a picture; 0 where the first cannot be decoded, which is said when it is asked for."""
    try:
        with _opened(path) as container:
            stream = container.streams.video[0]
            stream.codec_context.options = {"max_pixels": str(size[0] * size[1] + MARGIN)}
            frame = next(container.decode(stream), None)
            return round(getattr(frame, "rotation", 0) / 90) % 4
    except Exception:  # noqa: BLE001 (a decoder raises anything)
        return 0


def _timed(stamps: list, base: Fraction | None, rate: Fraction | None, size: tuple[int, int]) -> Index:
    """The index of frames with these time stamps, in units of `base` seconds."""
    if base is None or None in stamps or len(set(stamps)) < len(stamps):
        return Index(len(stamps), *size, float(rate or 30), 0.0, True, None)
    stamps.sort()
    gaps = np.diff(np.array(stamps, np.float64)) * float(base)
    wide = np.flatnonzero(gaps > 1.5 * np.median(gaps)) if len(gaps) else np.zeros(0, int)
    if len(wide) and wide[0] >= max(len(gaps) - TORN, 1):  # all before it are even
        stamps, gaps = stamps[:wide[0] + 1], gaps[:wide[0]]
    fps = 1 / gaps.mean() if len(gaps) else float(rate or 30)
    if rate and abs(gaps.sum() - len(gaps) / float(rate)) <= 2 * float(base) + 0.001 * gaps.sum():  # stamps are rounded
        fps = float(rate)
    constant = not len(gaps) or float(np.abs(gaps - np.median(gaps)).max()) <= max(0.1 / fps, 1.5 * float(base))
    return Index(len(stamps), *size, fps, float(stamps[0] * base), constant, tuple(stamps), base=float(base))


def telemetry(path: Path, begin: bytes, most: int) -> list[tuple[float, bytes]]:
    """(seconds after the first frame, bytes) of the first packets of a film's track of data whose packets begin so; none without one.

    Raises FastGSError where the film cannot be read.
    """
    first = index(path).first
    with _opened(path) as container:
        for stream in container.streams.data:
            found = []
            for packet in container.demux(stream):
                if packet.size and not (data := bytes(packet)).startswith(begin):
                    break
                if packet.size and packet.pts is not None:
                    found.append((float(packet.pts * packet.time_base) - first, data))
                if len(found) == most:
                    break
            if found:
                return found
            container.seek(0)
    return []


def frames(path: Path, wanted: Sequence[int]) -> Iterator[tuple[int, np.ndarray]]:
    """(number, pixels [H, W, 3] uint8 RGB) of the wanted frames, in rising order, in one pass over the part that they lie in.

    Raises FastGSError for a frame that cannot be decoded.
    """
    known = index(path)
    wanted = sorted(set(wanted))
    if wanted and not 0 <= wanted[0] <= wanted[-1] < known.count:
        raise FastGSError(f"{path}: the video has {known.count} frames, so there is no frame {wanted[-1]}.")
    for run in _runs(wanted):
        given = 0
        for number, pixels in _decode(path, known, run, from_start=known.stamps is None):
            yield number, pixels
            given += 1
        if given < len(run) and known.stamps is not None:
            yield from _decode(path, known, run[given:], from_start=True)
            continue
        if given < len(run):
            raise _undecodable(path, run[given])


def _runs(wanted: Sequence[int], gap: int = 60) -> Iterator[list[int]]:
    """The numbers in pieces worth jumping between."""
    run: list[int] = []
    for number in wanted:
        if run and number - run[-1] > gap:
            yield run
            run = []
        run.append(number)
    if run:
        yield run


def _decode(path: Path, known: Index, run: Sequence[int], from_start: bool) -> Iterator[tuple[int, np.ndarray]]:
    """The frames of a run as far as they come in order; after a jump the first one that is missing ends it quietly."""

    place = {stamp: i for i, stamp in enumerate(known.stamps)} if known.stamps else None
    left = iter(run)
    want, count = next(left), -1
    with _opened(path) as container:
        stream = container.streams.video[0]
        stream.codec_context.options = {"max_pixels": str(known.width * known.height + MARGIN)}
        stream.thread_type, stream.codec_context.thread_count = "AUTO", 2  # more cost memory: several videos are read at once
        if known.stamps and not from_start:
            container.seek(known.stamps[want], stream=stream, backward=True, any_frame=False)
        try:
            for frame in container.decode(stream):
                count += 1
                number = count if place is None else place.get(frame.pts)
                if number is None or number < want:
                    continue
                if number > want:
                    break
                yield number, np.ascontiguousarray(np.rot90(frame.to_ndarray(format="rgb24"), known.turns))
                want = next(left, -1)
                if want < 0:
                    return
        except Exception as error:  # a decoder raises anything on damaged films; frames() then decodes from the beginning
            if from_start:
                raise _undecodable(path, want) from error
    if from_start:
        raise _undecodable(path, want)


def _undecodable(path: Path, number: int) -> FastGSError:
    return FastGSError(f"{path}: frame {number} of the video cannot be decoded; the file is damaged or was cut short, so copy it again "
                       f"or leave that part out with a range of frames.")


@contextmanager
def _bounded(path: Path) -> Iterator[None]:
    """FFmpeg says that there is too little memory also for what it never asks for: a count in the file beyond its own limits."""
    try:
        yield
    except MemoryError:
        raise FastGSError(f"{path}: the video claims more than FFmpeg has memory for; it is damaged, so copy it again.") from None


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A PyAV container whose first video stream has a decoder; raises FastGSError for whatever PyAV raises while it is open."""
    try:
        import av
    except ImportError as error:
        raise FastGSError(f"{path}: reading a video needs PyAV; install it with: pip install av.") from error
    open_file(path).close()  # FFmpeg opens it by name: a pipe must not get that far
    with reading(path, "the video is damaged, cut short or of an unknown kind"), _bounded(path), \
            av.open(f"file:{path}", options=OPTIONS, metadata_errors="replace") as container:  # older cameras write other texts than UTF-8
        if not container.streams.video:
            raise FastGSError(f"{path}: there is no video in this file.")
        if container.streams.video[0].codec_context is None:
            raise FastGSError(f"{path}: no decoder is known for the video in this file; convert it to H.264.")
        yield container

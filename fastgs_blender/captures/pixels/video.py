# SPDX-License-Identifier: GPL-3.0-or-later
"""Videos, frame by frame: frame i is the i-th that a player shows, whatever its time stamp and however the file orders its packets.

Time stamps come from the packets without decoding.  Reading begins at the key frame before the wanted frame; a file without time
stamps, or whose decoder drops frames after a jump, is read from its beginning.
"""
from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from ...util.errors import FastGSError


@dataclass(frozen=True)
class Index:
    """What a video holds: frames, their size as shown, frames per second, and their time stamps in order (None: the file has none).

    first      seconds of the first frame
    constant   whether all frames are equally far apart
    """

    count: int
    width: int
    height: int
    fps: float
    first: float
    constant: bool
    stamps: tuple[int, ...] | None


def index(path: Path) -> Index:
    """The index of a video; raises FastGSError where it cannot be read or has no frames."""
    try:
        stat = path.stat()
    except OSError as error:
        raise FastGSError(f"{path}: the video cannot be read ({error.strerror}).") from error
    return _index(path, stat.st_size, stat.st_mtime_ns)


@lru_cache(maxsize=512)
def _index(path: Path, _size: int, _changed: int) -> Index:
    with _opened(path) as container:
        stream = container.streams.video[0]
        stamps = [packet.pts for packet in container.demux(stream) if packet.size and not packet.is_discard]
        base, rate = stream.time_base, stream.average_rate or stream.guessed_rate
        size = _shown_size(stream)
    if not stamps:
        raise FastGSError(f"{path}: the video holds no frames; it is damaged or was cut short.")
    if base is None or None in stamps or len(set(stamps)) < len(stamps):
        return Index(len(stamps), *size, float(rate or 30), 0.0, True, None)
    stamps.sort()
    gaps = np.diff(stamps) * float(base)
    fps = 1 / gaps.mean() if len(gaps) else float(rate or 30)
    if rate and abs(gaps.sum() - len(gaps) / float(rate)) <= 2 * float(base) + 0.001 * gaps.sum():  # stamps are rounded
        fps = float(rate)
    constant = not len(gaps) or float(np.abs(gaps - np.median(gaps)).max()) <= max(0.1 / fps, 1.5 * float(base))
    return Index(len(stamps), *size, fps, float(stamps[0] * base), constant, tuple(stamps))


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


def _runs(wanted, gap=60) -> Iterator[list[int]]:
    """The numbers in pieces worth jumping between."""
    run: list[int] = []
    for number in wanted:
        if run and number - run[-1] > gap:
            yield run
            run = []
        run.append(number)
    if run:
        yield run


def _decode(path, known, run, from_start) -> Iterator[tuple[int, np.ndarray]]:
    """The frames of a run as far as they come in order; after a jump the first one that is missing ends it quietly."""
    import av

    place = {stamp: i for i, stamp in enumerate(known.stamps)} if known.stamps else None
    left = iter(run)
    want, count = next(left), -1
    with _opened(path) as container:
        stream = container.streams.video[0]
        stream.thread_type, stream.codec_context.thread_count = "AUTO", 2  # more cost memory: several videos are read at once
        if not from_start:
            container.seek(known.stamps[want], stream=stream, backward=True, any_frame=False)
        try:
            for frame in container.decode(stream):
                count += 1
                number = count if place is None else place.get(frame.pts)
                if number is None or number < want:
                    continue
                if number > want:
                    break
                yield number, frame.to_ndarray(format="rgb24")
                want = next(left, None)
                if want is None:
                    return
        except (av.FFmpegError, ValueError) as error:
            if from_start:
                raise _undecodable(path, want) from error
    if from_start:
        raise _undecodable(path, want)


def _undecodable(path, number) -> FastGSError:
    return FastGSError(f"{path}: frame {number} of the video cannot be decoded; the file is damaged or was cut short, so copy it again "
                       f"or leave that part out with a range of frames.")


def _shown_size(stream) -> tuple[int, int]:
    context = stream.codec_context
    return context.width, context.height


@contextmanager
def _opened(path: Path):
    try:
        import av
    except ImportError as error:
        raise FastGSError(f"{path}: reading a video needs PyAV; install it with: pip install av.") from error
    try:
        with av.open(str(path)) as container:
            if not container.streams.video:
                raise FastGSError(f"{path}: there is no video in this file.")
            yield container
    except (av.FFmpegError, OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise FastGSError(f"{path}: the video cannot be read ({reason}); it is damaged, cut short or of an unknown kind.") from error

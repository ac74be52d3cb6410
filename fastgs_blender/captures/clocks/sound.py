# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures the onset strength of a video's sound over time, to align cameras by sound."""
from pathlib import Path

import numpy as np

from ...util.reading import reading
from ..pixels import video
from .curves import smoothed
from .lags import Pair

RATE, PIECE = 8000, 8
"""Samples a second that are listened to, and samples in a piece of which one loudness is kept: a millisecond."""
MOST_SECONDS = 600
LEAST_SECONDS = 0.5
LEAST_RATE = 2000
"""Samples a second of the slowest sound that is listened to: a file that says 1 would be made 8000 times as long."""
ERROR = 0.003
"""Standard deviation of a clear shift, in seconds: sound travels a metre in that time."""
CLEAR = 8.0
"""How far the best shift of two sounds must stand out, in standard deviations over all shifts."""


def onsets(path: Path) -> np.ndarray | None:
    """How suddenly it gets loud, for every millisecond [n] from the video's first picture on; None where there is no sound.

    Sound that begins more than MOST_SECONDS before or after the pictures is none.  Raises FastGSError where the file cannot be read.
    """
    first = video.index(path).first
    with video._opened(path) as container, reading(path):
        if not container.streams.audio:
            return None
        import av

        stream = container.streams.audio[0]
        resampler = av.AudioResampler(format="flt", layout="mono", rate=RATE)
        parts, start, length = [], None, 0
        for frame in container.decode(stream):
            if frame.sample_rate < LEAST_RATE:
                return None
            for heard in resampler.resample(frame):
                if start is None:
                    start = 0.0 if frame.pts is None else float(frame.pts * frame.time_base)
                parts.append(heard.to_ndarray().reshape(-1))
                length += len(parts[-1])
            if length > MOST_SECONDS * RATE:
                break
    if start is None:
        return None
    samples = np.concatenate(parts).astype(np.float64)
    begin = round((first - start) * RATE)  # sound before the first picture is left out
    if abs(begin) > MOST_SECONDS * RATE:  # the two never meet
        return None
    samples = samples[begin:] if begin >= 0 else np.r_[np.zeros(-begin), samples]
    samples = samples[:len(samples) // PIECE * PIECE].reshape(-1, PIECE)
    if len(samples) < 1000 * LEAST_SECONDS:
        return None
    loud = np.log(np.sqrt(np.square(samples).mean(1)) + 1e-4)
    return np.maximum(loud - smoothed(loud, 251), 0.0)


def heard(curves: list[np.ndarray], i: int, j: int) -> Pair | None:
    """The shift of two curves of onsets, in seconds, where it is clear; None where it is not."""
    a, b = (curve - curve.mean() for curve in (curves[i], curves[j]))
    size = 1 << (len(a) + len(b)).bit_length()
    product = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
    spread = product.std()
    best = int(np.argmax(product))
    if not spread > 0 or product[best] < CLEAR * spread:
        return None
    around = product[[(best - 1) % size, best, (best + 1) % size]]
    bend = around[0] - 2 * around[1] + around[2]
    top = best + (0.5 * (around[0] - around[2]) / bend if bend < 0 else 0.0)
    lag = top - size if top > size / 2 else top
    alike = product[best] / max(np.sqrt((a @ a) * (b @ b)), 1e-12)
    return Pair(i, j, lag * PIECE / RATE, ERROR, float(product[best] / spread), float(min(alike, 1.0)))

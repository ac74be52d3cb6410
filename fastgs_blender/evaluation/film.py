# SPDX-License-Identifier: GPL-3.0-or-later
"""Films of pictures, frame by frame, as H.264 in MP4 through PyAV."""
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ..util.errors import FastGSError
from ..util.outputs import replacing

ENCODERS = (("libx264", {"crf": "16", "preset": "medium"}), ("libopenh264", {"b": "12M"}), ("mpeg4", {"qscale": "2"}))
"""The first that this PyAV has writes the film."""

BT709 = 1


@contextmanager
def film(path: Path, width: int, height: int, fps: float) -> Iterator:
    """Gives add(picture): uint8 [height, width, 3], sides even.  The file appears when the block ends well.

    Raises FastGSError where PyAV is missing or the file cannot be written.
    """
    try:
        import av
    except ImportError as error:
        raise FastGSError(f"{path}: a film needs PyAV: pip install av.") from error
    try:
        with replacing([path]) as (part,), av.open(f"file:{part}", "w", format="mp4") as container:
            stream = _stream(av, container, Fraction(fps).limit_denominator(1001))
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            for name in ("colorspace", "color_primaries", "color_trc"):
                setattr(stream.codec_context, name, BT709)

            def add(picture: np.ndarray) -> None:
                frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
                container.mux(stream.encode(frame.reformat(format="yuv420p", dst_colorspace="ITU709")))

            yield add
            container.mux(stream.encode(None))
    except (OSError, av.FFmpegError) as error:
        raise FastGSError(f"{path}: the film cannot be written ({getattr(error, 'strerror', None) or error}).") from error


def available() -> bool:
    """Whether films can be written here."""
    with suppress(ImportError):
        import av

        return bool(_encoder(av))
    return False


def _encoder(av: ModuleType) -> tuple[str, dict[str, str]] | None:
    return next(((name, options) for name, options in ENCODERS if name in av.codecs_available), None)


def _stream(av: ModuleType, container: Any, rate: Any) -> Any:
    found = _encoder(av)
    if found is None:
        raise FastGSError("this PyAV writes neither H.264 nor MPEG-4; install another: pip install --upgrade av.")
    name, options = found
    return container.add_stream(name, rate=rate, options=options)

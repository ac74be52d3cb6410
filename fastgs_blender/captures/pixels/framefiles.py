# SPDX-License-Identifier: GPL-3.0-or-later
"""The cache of decoded frames on disk: its folder, the names of its files, reading and writing one.

A file is a header of 24 bytes (8 of MAGIC, then height, width, channels and bytes per number as little-endian uint32) and the numbers.
"""
import contextlib
import hashlib
import math
import os
import re
import secrets
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike

from ...kernels.cpu.cache import base_folder
from ...util.errors import FastGSError
from ...util.identity import status_of
from ..capture import Capture, Shot

VERSION = 1
"""Number of the decoding; to be raised when decoding gives other pixels."""
MAGIC = b"fgsframe"
HEADER = 24


def default_folder(capture: Capture) -> Path:
    """The cache of a capture: under $FASTGS_CACHE_DIR, or the system's place for caches."""
    place = Path(capture.path).resolve()
    readable = re.sub("[^A-Za-z0-9_-]+", "-", place.name)[:40]
    return base_folder() / "frames" / f"{readable}-{hashlib.sha256(os.fsencode(place)).hexdigest()[:10]}"


def digest(shot: Shot, scale: float) -> str:
    """Of everything that a shot's pixels depend on."""
    parts: list = [VERSION]
    for source in (shot.image, shot.mask):
        if source is None:
            parts.append(None)
            continue
        parts += [repr(replace(source, path=source.path.absolute())), *status_of(str(source.path))]
    camera = shot.camera
    parts.append(scale if camera is None else (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy))
    return hashlib.sha256(repr(parts).encode("utf-8", "surrogateescape")).hexdigest()[:32]


def _header(array: np.ndarray) -> bytes:
    height, width, channels = array.shape
    return MAGIC + np.array([height, width, channels, array.itemsize], "<u4").tobytes()


def read(path: Path, shape: tuple[int, int, int], kind: DTypeLike) -> np.ndarray | None:
    """The numbers in a cached file; None where it is absent or is not what it should be."""
    try:
        with open(path, "rb", buffering=0) as stream:
            if os.fstat(stream.fileno()).st_size != HEADER + math.prod(shape) * np.dtype(kind).itemsize:
                return None
            array = np.empty(shape, kind)
            head = stream.read(HEADER)
            view, got = array.data.cast("B"), 0
            while got < len(view):
                count = stream.readinto(view[got:])
                if not count:
                    return None
                got += count
    except OSError as error:
        if isinstance(error, FileNotFoundError) or (os.name == "nt" and isinstance(error, PermissionError)):  # being put in its place there
            return None
        raise FastGSError(f"{path}: the cached frame cannot be read ({error.strerror}); remove it and start again.") from error
    return array if head == _header(array) else None


def write(path: Path, array: np.ndarray) -> None:
    """Write a cached file aside and rename it.  Raises OSError; what was there before is still there then."""
    part = path.with_name(f".fastgs-{secrets.token_hex(6)}.tmp")
    try:
        with open(part, "wb", buffering=0) as stream:
            for piece in (memoryview(_header(array)), array.data.cast("B")):
                written = 0
                while written < len(piece):
                    written += stream.write(piece[written:])
        try:
            os.replace(part, path)
        except PermissionError:  # Windows: another process reads the same frame
            if not path.exists():
                raise
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)

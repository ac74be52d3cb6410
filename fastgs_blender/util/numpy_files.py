# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays of numbers in NumPy's .npy and .npz files, read without running a pickle and within bounds of memory."""
import math
import os
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from .errors import FastGSError
from .reading import open_file, reading
from .zip_files import opened_zip

LARGEST_ARRAY = 4 * 2**30
"""Bytes of the largest array that is read."""
LARGEST_RATIO = 100
"""How many times larger than its file all that is packed in an .npz may be; measured numbers pack to a half at best."""
SMALL = 2**24
"""Bytes that may be unpacked from any file."""
PIECE = 2**20
DAMAGED = "the file is damaged or another one, so copy it again"


@dataclass(frozen=True)
class PackedArray:
    """An array in an .npz file: known by shape and type, not yet read."""

    path: Path
    name: str
    shape: tuple[int, ...]
    dtype: np.dtype

    def read(self) -> np.ndarray:
        """Its numbers, as the file has them; raises FastGSError."""
        return read_array(self.path, self.name)


def read_array(path: Path, name: str | None = None) -> np.ndarray:
    """The array of numbers in an .npy file, or the one of that name in an .npz file; raises FastGSError."""
    advice = DAMAGED if name is None else f"{DAMAGED} (its array {name!r} is wanted)"
    with reading(path, advice):
        if name is None:
            with open_file(path) as stream:
                return _read(stream, os.fstat(stream.fileno()).st_size)
        with _archive(path) as archive:
            member = archive.getinfo(f"{name}.npy")
            with archive.open(member) as stream:
                return _read(stream, member.file_size)


def packed_arrays(path: Path) -> Mapping[str, PackedArray]:
    """The arrays of numbers in an .npz file by name; raises FastGSError.

    What an array's header claims and what the zip's table says is the same.  Arrays of anything but numbers and truth values are
    ignored.
    """
    found = {}
    with reading(path), _archive(path) as archive:
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            if name == member.filename:
                continue
            if name in found:
                raise FastGSError(f"{path}: the array {name!r} is in it twice; the file is damaged, so copy or export it again.")
            with archive.open(member) as stream:
                shape, _, dtype = _header(stream)
                begin = stream.tell()
            if dtype.kind not in "fiub" or dtype.hasobject:
                continue
            if math.prod(shape) * dtype.itemsize + begin != member.file_size:
                raise FastGSError(f"{path}: its array {name!r} has not the size that its header says; copy or export it again.")
            found[name] = PackedArray(path, name, shape, dtype)
    return found


@contextmanager
def _archive(path: Path) -> Iterator[zipfile.ZipFile]:
    """An .npz file whose arrays together unpack to no more than the limits."""
    with opened_zip(path) as archive:
        members = archive.infolist()
        whole = sum(member.file_size for member in members)
        if whole > max(SMALL, LARGEST_RATIO * os.path.getsize(path)):
            raise ValueError(f"its arrays would unpack to {whole} bytes, more than {LARGEST_RATIO} times the file")
        yield archive


def _header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, whether its order is Fortran's, and type of an .npy stream."""
    version = np.lib.format.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"version {version} of the .npy format is not read")
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that Python 2 wrote it is no trouble
        shape, fortran, dtype = read(stream)
    shape = tuple(int(n) for n in shape)
    if min(shape, default=0) < 0:
        raise ValueError(f"its header says the shape {shape}")
    return shape, fortran, dtype


def _read(stream: Any, length: int) -> np.ndarray:
    """The array of an .npy stream of at most `length` bytes; nothing is allocated on the word of its header."""
    shape, fortran, dtype = _header(stream)
    if dtype.kind not in "fiub" or dtype.hasobject:
        raise ValueError("it holds no numbers")
    size = math.prod(shape) * dtype.itemsize
    if size > min(LARGEST_ARRAY, length):
        raise ValueError(f"its array would have {size} bytes, more than the file holds or than the {LARGEST_ARRAY} that are read")
    array = np.empty(shape[::-1] if fortran else shape, dtype)
    view, at = array.reshape(-1).view(np.uint8).data, 0
    while at < size:
        got = stream.readinto(view[at:at + PIECE])
        if not got:
            raise ValueError("it is cut short")
        at += got
    return array.T if fortran else array

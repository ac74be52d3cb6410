# SPDX-License-Identifier: GPL-3.0-or-later
"""numpy's own files, read without ever running what they hold."""
from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .errors import FastGSError
from .reading import open_file, reading

LARGEST_ARRAY = 4 * 2**30
STEP = 1 << 20
"""Bytes that are unpacked at a time to see how many there are."""
DENSEST = 1032
"""How many times its packed size a deflated member can have at most."""


def read_array(path: Path, name: str | None = None) -> np.ndarray:
    """The array of an .npy file, or the one of that name in an .npz file, of numbers; raises FastGSError."""
    try:
        if path.stat().st_size > LARGEST_ARRAY:
            raise ValueError(f"it has {path.stat().st_size} bytes")
        if name is not None:
            _check_unpacked(path, name)
        with path.open("rb") as stream:
            found = np.load(stream, allow_pickle=False)
            array = found if name is None else found[name]
            if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
                raise ValueError("it holds no numbers")
            return array
    except FileNotFoundError as error:
        raise FastGSError(f"{path}: this file of the capture is missing; copy it again.") from error
    except (OSError, ValueError, KeyError, EOFError, SyntaxError, MemoryError, zipfile.BadZipFile) as error:
        part = "" if name is None else f" {name!r}"
        raise FastGSError(f"{path}: the array{part} cannot be read ({error or type(error).__name__}); the file is damaged or another "
                          "one, so copy it again.") from error


def _check_unpacked(path, name):
    with zipfile.ZipFile(path) as archive:
        for entry in archive.infolist():
            if entry.filename == f"{name}.npy" and entry.file_size > LARGEST_ARRAY:
                raise ValueError(f"{name} would have {entry.file_size} bytes")


@dataclass(frozen=True)
class PackedArray:
    """An array in an .npz file: known by shape and type, not yet read."""

    path: Path
    name: str
    shape: tuple[int, ...]
    dtype: np.dtype

    def read(self) -> np.ndarray:
        """Its numbers, as the file has them; raises FastGSError."""
        with reading(self.path), _archive(self.path) as archive, archive.open(f"{self.name}.npy") as stream:
            return np.lib.format.read_array(stream, allow_pickle=False)


def packed_arrays(path: Path) -> Mapping[str, PackedArray]:
    """The arrays of numbers in an .npz file by name; raises FastGSError.

    Sizes are true: what a header claims, the zip's table says and, where that is far more than the file has, unpacking gives, is
    the same.  Arrays of anything but numbers and truth values are passed over.
    """
    found = {}
    with reading(path), _archive(path) as archive:
        whole = path.stat().st_size
        for entry in archive.infolist():
            name = entry.filename.removesuffix(".npy")
            if name == entry.filename:
                continue
            if name in found:
                raise FastGSError(f"{path}: the array {name!r} is in it twice; the file is damaged, so copy or export it again.")
            with archive.open(entry) as stream:
                shape, _, dtype = _header(stream)
                begin = stream.tell()
            if dtype.kind not in "fiub" or dtype.hasobject:
                continue
            size = int(np.prod([int(n) for n in shape], dtype=object)) * dtype.itemsize
            if size + begin != entry.file_size or entry.file_size > min(LARGEST_ARRAY, DENSEST * entry.compress_size + begin):
                raise FastGSError(f"{path}: its array {name!r} has not the size that its header says; copy or export it again.")
            if entry.file_size > 4 * whole:
                _count(archive, entry)
            found[name] = PackedArray(path, name, tuple(int(n) for n in shape), dtype)
    return found


@contextmanager
def _archive(path: Path) -> Iterator[zipfile.ZipFile]:
    with open_file(path) as stream, zipfile.ZipFile(stream) as archive:
        yield archive


def _header(stream):
    """Shape, order and type of an .npy stream."""
    version = np.lib.format.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"it is of version {version} of numpy's format")
    return (np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0)(stream)


def _count(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> None:
    """Unpack a member and keep nothing; raises ValueError where it is not as long as the table says."""
    count = 0
    with archive.open(entry) as stream:
        while piece := stream.read(STEP):
            count += len(piece)
    if count != entry.file_size:
        raise ValueError(f"{entry.filename} has {count} bytes, not {entry.file_size}")

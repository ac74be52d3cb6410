# SPDX-License-Identifier: GPL-3.0-or-later
"""Safetensors files: named arrays and texts, read into memory of our own after every claim of the header is checked.

Eight bytes of length, a JSON table {name: {dtype, shape, data_offsets}} with texts under __metadata__, the arrays end to end.
Nothing is mapped: a mapped file that another program shortens ends the process (SIGBUS), whatever was unsaved in it.
"""
from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .errors import FastGSError
from .reading import open_file, reading

MAX_HEADER = 16 << 20
SIZES = {"BOOL": 1, "U8": 1, "I8": 1, "F8_E5M2": 1, "F8_E4M3": 1, "I16": 2, "U16": 2, "F16": 2, "BF16": 2, "I32": 4, "U32": 4, "F32": 4,
         "I64": 8, "U64": 8, "F64": 8}
"""Bytes of each type of the format."""
DTYPES = {"BOOL": "?", "U8": "u1", "I8": "i1", "I16": "<i2", "U16": "<u2", "F16": "<f2", "I32": "<i4", "U32": "<u4", "F32": "<f4",
          "I64": "<i8", "U64": "<u8", "F64": "<f8"}
"""Those that NumPy has."""
DAMAGED = "copy or export it again"


@dataclass(frozen=True)
class Entry:
    """An array in the file: its type's name, its shape, and where its bytes begin and end, counted from the file's beginning."""

    dtype: str
    shape: tuple[int, ...]
    begin: int
    end: int


@dataclass(frozen=True)
class TensorFile:
    """An open safetensors file whose header has been checked against the file's length."""

    stream: Any
    metadata: dict[str, str]
    entries: dict[str, Entry]

    def read(self, name: str) -> np.ndarray:
        """The array of that name, in memory of its own; raises FastGSError where the file has become shorter or has no such array."""
        entry = self.entries.get(name)
        if entry is None:
            raise FastGSError(f"its array {name!r} is missing; the file is damaged.")
        if entry.dtype not in DTYPES:
            raise FastGSError(f"its array {name!r} is of the type {entry.dtype}, which is not supported.")
        array = np.empty(entry.shape, DTYPES[entry.dtype])
        self.stream.seek(entry.begin)
        if array.size and self.stream.readinto(array.reshape(-1).view(np.uint8).data) != array.nbytes:
            raise FastGSError(f"the file is cut short within its array {name!r}; {DAMAGED}.")
        return array

    def below(self, prefix: str) -> TensorFile:
        """The arrays whose names begin so, by the rest of their names."""
        return replace(self, entries={name[len(prefix):]: entry for name, entry in self.entries.items() if name.startswith(prefix)})


@contextmanager
def open_tensors(path: str | os.PathLike) -> Iterator[TensorFile]:
    """The safetensors file at `path`, open while the block lasts; raises FastGSError for a damaged one."""
    with reading(path), open_file(path) as stream:
        length = os.fstat(stream.fileno()).st_size
        size = int.from_bytes(stream.read(8), "little")
        if not 2 <= size <= min(MAX_HEADER, length - 8):
            raise FastGSError(f"the file is cut short or damaged (its header would have {size} bytes); {DAMAGED}.")
        try:
            table = json.loads(stream.read(size))
        except (ValueError, RecursionError) as error:
            raise FastGSError(f"the JSON in its header is cut short or damaged; {DAMAGED}.") from error
        yield TensorFile(stream, *_checked(table, 8 + size, length))


def _checked(table: Any, begin: int, length: int) -> tuple[dict[str, str], dict[str, Entry]]:
    """The header's texts and arrays; arrays must lie end to end from `begin` to the file's end, as the format wants it."""
    if not isinstance(table, dict):
        raise FastGSError(f"its header is no table; {DAMAGED}.")
    metadata = table.pop("__metadata__", None)
    if metadata is None:
        metadata = {}
    if not isinstance(metadata, dict) or not all(isinstance(text, str) for text in metadata.values()):
        raise FastGSError(f"the metadata in its header are no texts; {DAMAGED}.")
    entries = {name: _entry(name, about, begin) for name, about in table.items()}
    at = begin
    for name, entry in sorted(entries.items(), key=lambda item: (item[1].begin, item[1].end)):
        if entry.begin != at:
            raise FastGSError(f"its array {name!r} does not begin where the one before it ends; the file is damaged, so {DAMAGED}.")
        at = entry.end
    if at != length:
        raise FastGSError(f"the file is {'cut short' if at > length else 'longer than its header says'} or damaged "
                          f"({length} bytes instead of {at}); {DAMAGED}.")
    return metadata, entries


def _entry(name: str, about: Any, begin: int) -> Entry:
    found: list[Any] = [about.get(key) if isinstance(about, dict) else None for key in ("dtype", "shape", "data_offsets")]
    dtype, shape, span = found
    numbers = [*shape, *span] if isinstance(shape, list) and isinstance(span, list) and len(span) == 2 and len(shape) <= 32 else [-1]
    if not isinstance(dtype, str) or dtype not in SIZES or not all(type(n) is int and 0 <= n < 2**53 for n in numbers):
        raise FastGSError(f"its header does not say what its array {name!r} is; {DAMAGED}.")
    count = 1
    for n in shape:
        count *= n
    size = span[1] - span[0]
    if size != count * SIZES[dtype]:
        raise FastGSError(f"its array {name!r} has {size} bytes instead of the {count * SIZES[dtype]} of its shape; {DAMAGED}.")
    return Entry(dtype, tuple(shape), begin + span[0], begin + span[1])


def write_tensors(path: Path, arrays: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> None:
    """Write a safetensors file; raises OSError, and FastGSError where the safetensors library is not installed.

    One key of metadata: the library writes several in random order, and the same content must give the same bytes.
    """
    try:
        from safetensors import SafetensorError
        from safetensors.numpy import save_file
    except ImportError as error:
        raise FastGSError("the safetensors library, which writes this format, is not installed.") from error
    try:
        save_file(dict(arrays), path, dict(metadata))
    except SafetensorError as error:
        number = re.search(r"os error (\d+)", str(error))
        raise (OSError(int(number[1]), os.strerror(int(number[1]))) if number else OSError(str(error))) from error


@contextmanager
def streamed_tensors(path: Path) -> Iterator[tuple[Callable[[str, np.ndarray], None], dict[str, str]]]:
    """add(name, array), which writes an array at once, and the file's texts, to be filled in the block.  The arrays are first written to a
    file without a name beside `path`, because the header, which comes before them, lists them all.  Raises OSError."""
    entries: dict[str, dict] = {}
    metadata: dict[str, str] = {}
    types = {np.dtype(kind): name for name, kind in DTYPES.items()}
    with tempfile.TemporaryFile(dir=path.parent) as data:
        def add(name: str, array: np.ndarray) -> None:
            begin = data.tell()
            data.write(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
            entries[name] = {"dtype": types[array.dtype], "shape": list(array.shape), "data_offsets": [begin, data.tell()]}

        yield add, metadata
        text = json.dumps({"__metadata__": metadata, **entries}, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 8)
        if len(text) > MAX_HEADER:
            raise FastGSError("the file would hold too many arrays; make its pieces longer.")
        data.seek(0)
        with open(path, "wb") as stream:
            stream.write(len(text).to_bytes(8, "little") + text)
            shutil.copyfileobj(data, stream, 1 << 20)

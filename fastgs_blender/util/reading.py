# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading files from outside.  One place opens them, bounds what they may cost, and turns whatever fails into FastGSError.

Every reader of models, captures, cameras, checkpoints, job and status files goes through here:

    with reading(path, "export it again"):         # any exception within becomes one sentence about `path`
        data = read_bytes(path, limit=LARGEST)     # regular files only, never more than `limit` bytes
"""
import errno
import io
import json
import logging
import os
import stat
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, BinaryIO

from .errors import FastGSError

log = logging.getLogger(__name__)
FOLDER = "this is a folder, not a file; give the name of a file in it"
NOT_ORDINARY = "this is a pipe or a device, not an ordinary file; copy what it gives into a file first"
LARGEST_JSON = 512 * 2**20
"""Bytes of the largest JSON file that is read."""
DAMAGED = "the file is damaged or of another kind, so copy or export it again"


@contextmanager
def reading(path: object, advice: str = DAMAGED) -> Iterator[None]:
    """Turn whatever fails in the block into FastGSError that names `path`, gives the reason and ends with the advice.

    A FastGSError passes through as it is: it says more.  Libraries that parse files raise nearly anything on damaged ones, so
    everything but an interruption is caught here.  (captures/pixels/video.py also catches all that its decoder raises, because
    decoding from the film's beginning may succeed.)
    """
    try:
        yield
    except (FastGSError, Warning):  # a warning is raised where the caller wants warnings to be errors
        raise
    except FileNotFoundError as error:
        raise FastGSError(f"{path}: there is no such file; check the name and the folder.") from error
    except MemoryError as error:
        raise FastGSError(f"{path}: there is too little memory to read it, or {advice}.") from error
    except OSError as error:
        raise FastGSError(f"{path}: it cannot be read ({error.strerror or error}); check the file and its permissions.") from error
    except Exception as error:
        log.debug("%s cannot be read", path, exc_info=error)  # a mistake in a reader looks like a damaged file: developers see its place
        raise FastGSError(f"{path}: it cannot be read ({_reason(error)}); {advice}.") from error


def _reason(error: Exception) -> str:
    """What Python's own errors say of data that end early, or are of another kind than their reader takes them for."""
    text = " ".join(str(getattr(error, "strerror", None) or error).split())[:200]  # FFmpeg's errors have a strerror
    if isinstance(error, (struct.error, EOFError)) or text.startswith(("buffer is smaller", "offset must be")):
        return "it is cut short"
    if isinstance(error, KeyError):
        return f"its {text} is missing"
    if isinstance(error, (IndexError, TypeError, AttributeError)):
        return f"something in it is not what it should be: {text}"
    return text or type(error).__name__


def open_file(path: str | os.PathLike) -> io.BufferedReader:
    """A regular file, opened for reading bytes; raises FastGSError for anything else.

    A pipe or a device would make its reader wait for ever; opening it without blocking, and looking before reading, does not.
    """
    with reading(path):
        return os.fdopen(regular_file(path, os.O_RDONLY | getattr(os, "O_BINARY", 0)), "rb")


def regular_file(path: str | os.PathLike, flags: int) -> int:
    """A handle of a regular file, opened with os.open()'s flags; raises FastGSError for anything else, and OSError."""
    try:
        handle = os.open(path, flags | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0), 0o666)
    except OSError as error:
        if error.errno == errno.ENXIO:  # a pipe that nobody reads, opened to be written
            raise FastGSError(f"{path}: {NOT_ORDINARY}.") from error
        if os.path.isdir(path):  # which Windows does not open
            raise FastGSError(f"{path}: {FOLDER}.") from error
        raise
    try:
        mode = os.fstat(handle).st_mode
        if stat.S_ISDIR(mode):
            raise FastGSError(f"{path}: {FOLDER}.")
        if not stat.S_ISREG(mode):
            raise FastGSError(f"{path}: {NOT_ORDINARY}.")
    except BaseException:
        os.close(handle)
        raise
    return handle


def damaged_if(wrong: object, what: str) -> None:
    """Raises FastGSError that says what is wrong in a file, with the remedy of damaged ones."""
    if wrong:
        raise FastGSError(f"{what}; copy or export the file again.")


def exactly(stream: BinaryIO, size: int) -> bytes:
    """The next `size` bytes of a file; raises EOFError, before memory is taken, where there are not so many."""
    if size > os.fstat(stream.fileno()).st_size - stream.tell():
        raise EOFError
    return stream.read(size)


def read_bytes(path: str | os.PathLike, limit: int) -> bytes:
    """All bytes of a regular file of at most `limit` bytes; raises FastGSError."""
    with reading(path), open_file(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > limit:
            raise FastGSError(f"{path}: it has {size} bytes, which is more than such a file may have ({limit}); choose another file.")
        return file.read(size)  # not of the limit: a buffer of that size would be made first


def read_text(path: str | os.PathLike, limit: int = LARGEST_JSON) -> str:
    """The text of a UTF-8 file, with or without a byte order mark; raises FastGSError."""
    with reading(path):
        return read_bytes(path, limit).decode("utf-8-sig")


def parse_json(text: str | bytes) -> Any:
    """The JSON value of a text from outside; raises ValueError, also where it is nested deeper than Python can follow."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def read_json(path: str | os.PathLike, limit: int = LARGEST_JSON,
              advice: str = "it is not JSON, or cut short; copy or export it again") -> Any:
    """The JSON value in a file; raises FastGSError."""
    with reading(path, advice):
        return parse_json(read_bytes(path, limit).decode("utf-8-sig"))

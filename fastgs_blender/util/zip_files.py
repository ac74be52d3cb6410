# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads zip files from outside safely.  It refuses files that are not regular, tables of contents that are too large or claim more than the
file holds, and packing methods whose memory the packed data decides."""
import os
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import BinaryIO

from .errors import FastGSError
from .reading import open_file

TAIL = (1 << 16) + 22 + 20
"""Bytes at the end of a file in which the record lies that says how long the table of contents is."""
END, END_64, LOCATOR = b"PK\5\6", b"PK\6\6", b"PK\6\7"
PLAIN = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""LZMA's dictionary, which a damaged file can make 4 GB large, is made before a byte is unpacked; of bzip2, Python unpacks at once all that
a piece of the file gives, which can be a million times as much."""
MAGIC = b"PK\3\4"
SMALL = 1 << 18
SHARE = 8
"""A table of contents of more than SMALL bytes may be at most one part in so many of the file: Python makes 600 bytes of each 46."""


@contextmanager
def opened_zip(path: str | os.PathLike) -> Iterator[zipfile.ZipFile]:
    """A zip file, to be read.  Raises what zipfile raises for broken ones, and FastGSError for one that lists more than it holds."""
    with open_file(path) as stream:
        length, listed = _lengths(stream)
        if listed > max(SMALL, length // SHARE):
            raise FastGSError(f"{path}: its table of contents has {listed} of {length} bytes, which no model's has; unpack it yourself.")
        with zipfile.ZipFile(stream) as archive:
            for member in archive.infolist():
                if member.compress_type not in PLAIN:
                    raise FastGSError(f"{path}: a part of it is packed by LZMA or bzip2; unpack it, and pack it anew as usual.")
                if member.compress_size > length:  # Python makes a buffer of that size
                    raise FastGSError(f"{path}: a part of it would be longer than the file; it is cut short or damaged, so copy it again.")
            yield archive


def members(head: bytes, path: str | os.PathLike) -> frozenset[str]:
    """The names in a zip file, empty for any other file; head: the file's first bytes.  Raises as opened_zip() does."""
    if not head.startswith(MAGIC):
        return frozenset()
    with opened_zip(path) as archive:
        return frozenset(archive.namelist())


def read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """All bytes of a member, which are as many as its entry says, or zipfile.BadZipFile is raised.

    ZipFile.read() unpacks as much as the packed bytes give, up to 2 GB at a time, whatever the entry says.
    """
    with archive.open(member) as stream:
        data = stream.read(member.file_size)
    if len(data) != member.file_size:
        raise zipfile.BadZipFile(f"{member.filename!r} has {len(data)} bytes instead of {member.file_size}")
    return data


def _lengths(stream: BinaryIO) -> tuple[int, int]:
    """Bytes of the file, and of its table of contents as far as it says; 0 where it does not."""
    length = stream.seek(0, os.SEEK_END)
    stream.seek(max(0, length - TAIL))
    tail = stream.read(TAIL)
    stream.seek(0)
    at = tail.rfind(END)
    if at < 0 or at + 20 > len(tail):
        return length, 0
    listed = int.from_bytes(tail[at + 12:at + 16], "little")
    if listed == 0xFFFFFFFF and tail[max(0, at - 20):at].startswith(LOCATOR):  # of a zip file beyond 4 GB
        stream.seek(min(int.from_bytes(tail[at - 12:at - 4], "little"), length))
        record = stream.read(56)
        stream.seek(0)
        listed = int.from_bytes(record[40:48], "little") if record.startswith(END_64) else listed
    return length, listed

# SPDX-License-Identifier: GPL-3.0-or-later
"""Tells whether a file is still the one that was read, also where it was rewritten within one tick of the file system's clock.

Times and sizes alone do not: a clock ticks every few milliseconds on Linux and every two seconds on FAT, and models of as many
Gaussians have files of the same size.  So while a file is young its contents are looked at too (git does this with its index).
"""
from __future__ import annotations

import hashlib
import os
import time
from dataclasses import dataclass, field

from .errors import FastGSError
from .reading import open_file, reading

SETTLED = 3.0
"""Seconds after its last change from which a file's time tells it from any later version: longer than the coarsest tick."""
BLOCK = 4096
BLOCKS = 64
"""Blocks of a file, evenly spread from its first to its last, that its fingerprint is made of; a folder's is made of its names."""


@dataclass
class FileIdentity:
    """What was known of a file when it was read.

    status       modification and change time in ns, size, inode and device
    fingerprint  hash of some of the contents, taken before the file was read
    """

    path: str
    status: tuple[int, int, int, int, int]
    fingerprint: bytes
    _settled: bool = field(default=False, repr=False)

    @classmethod
    def of(cls, path: str) -> FileIdentity:
        """The identity of a file as it is now, to be taken before it is read.  Raises FastGSError where it cannot be opened."""
        return cls(path, status_of(path), _fingerprint(path))

    def same(self) -> bool:
        """Whether the path still leads to the same contents.  Raises FastGSError where there is no file any more.

        One look at the file's status, and while the file is younger than SETTLED seconds at most BLOCKS blocks to read.
        """
        if status_of(self.path) != self.status:
            return False
        if not self._settled:
            now = time.time()  # before the contents are looked at: what is written later has a later time
            if _fingerprint(self.path) != self.fingerprint:
                return False
            self._settled = now - max(self.status[:2]) / 1e9 > SETTLED
        return True


def status_of(path: str) -> tuple[int, int, int, int, int]:
    """Modification and change time in ns, size, inode and device of a file.  Raises FastGSError where there is none."""
    try:
        s = os.stat(path)
    except (OSError, ValueError):  # ValueError: a zero in the name
        raise FastGSError(f"{path}: there is no such file; choose it again or put it back.") from None
    return s.st_mtime_ns, s.st_ctime_ns, s.st_size, s.st_ino, s.st_dev


def _fingerprint(path: str) -> bytes:
    found = hashlib.blake2b(digest_size=16)
    if os.path.isdir(path):
        with reading(path):
            found.update("\0".join(sorted(os.listdir(path))).encode("utf-8", "surrogateescape"))
        return found.digest()
    with reading(path), open_file(path) as file:
        size = os.fstat(file.fileno()).st_size
        last = max(size - BLOCK, 0)
        for at in sorted({last * i // (BLOCKS - 1) for i in range(BLOCKS)}):
            file.seek(at)
            found.update(file.read(BLOCK))
    return found.digest()

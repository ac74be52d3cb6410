# SPDX-License-Identifier: GPL-3.0-or-later
"""Lists the members of a zip file.  Several formats are zip files, and are known by the names of their members."""
from __future__ import annotations

from pathlib import Path

from ..util.errors import FastGSError
from ..util.reading import reading
from ..util.zip_files import opened_zip

MAGIC = b"PK\x03\x04"


def members(head: bytes, path: Path) -> frozenset[str]:
    """The names in a zip file; empty for any other file and for a broken one.  head: the file's first bytes."""
    if not head.startswith(MAGIC):
        return frozenset()
    try:
        with reading(path), opened_zip(path) as archive:
            return frozenset(archive.namelist())
    except FastGSError:
        return frozenset()

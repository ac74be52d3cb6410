# SPDX-License-Identifier: GPL-3.0-or-later
"""Files are written aside and renamed, so that whatever happens there is the old file or the whole new one, never a half."""
from __future__ import annotations

import contextlib
import errno
import os
import time
from pathlib import Path

from .errors import FastGSError

STALE = 60.0
"""Seconds after which a file left aside belongs to nobody: writing one frame takes far less."""


@contextlib.contextmanager
def written_aside(path):
    """Gives the path to write to, in the same folder; at the end of the block it becomes `path`.

    Where the block fails, `path` is as it was and nothing is left beside it.  Raises FastGSError where the system cannot write.
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield part
        os.replace(part, path)
    except OSError as error:
        raise FastGSError(f"{path} could not be written: {_reason(error)}") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink()


def _reason(error: OSError) -> str:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return "the disk is full; free some space and run this again."
    return f"{error.strerror or error}; check the folder and the free space on its disk."


def remove_stale(folder, names: set[str]):
    """Remove what a killed run has left aside in folder for files of these names."""
    for part in Path(folder).glob(".*.part"):
        with contextlib.suppress(OSError):
            if part.name[1:].rsplit(".", 2)[0] in names and time.time() - part.stat().st_mtime > STALE:
                part.unlink()

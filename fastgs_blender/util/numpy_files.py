# SPDX-License-Identifier: GPL-3.0-or-later
"""numpy's own files, read without ever running what they hold."""
from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from .errors import FastGSError

LARGEST_ARRAY = 4 * 2**30


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

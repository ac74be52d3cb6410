# SPDX-License-Identifier: GPL-3.0-or-later
"""Checkpoints: the whole state of a run as one safetensors file, written aside and renamed, so that there is always a whole one."""
from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from ...util.errors import FastGSError
from ...util.outputs import replacing
from ...util.tensor_files import write_tensors

NAME = "checkpoint.safetensors"
VERSION = 1
KEY = "fast-gs checkpoint"


def save(folder, arrays: dict[str, np.ndarray], about: dict) -> None:
    """Replace the folder's checkpoint.  Whatever goes wrong, the previous one is whole; FastGSError says what it was."""
    path = Path(folder) / NAME
    write_aside(path, lambda part: write_tensors(part, arrays, {KEY: json.dumps({"version": VERSION, **about}, allow_nan=False)}))


def load(folder) -> tuple[dict[str, np.ndarray], dict] | None:
    """(arrays, about) of the folder's checkpoint, None if it has none; raises FastGSError if it cannot be used."""
    path = Path(folder) / NAME
    if not path.exists():
        return None
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, "numpy") as file:
            about = json.loads((file.metadata() or {})[KEY])
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (it is no dictionary)
    except (SafetensorError, OSError, KeyError, ValueError, TypeError) as error:
        raise FastGSError(f"{path} is no usable checkpoint ({error}); delete it to train from the beginning.") from error
    if not isinstance(about, dict) or about.get("version") != VERSION:
        raise FastGSError(f"{path} was written by another version of FAST-GS; train from the beginning or use that version.")
    return arrays, about


def write_aside(path: Path, write) -> None:
    """write(temporary file), which then takes the place of `path`; raises FastGSError with the reason where it cannot."""
    try:
        with replacing([Path(path)]) as (part,):
            write(part)
    except (FastGSError, OSError) as error:
        reason = f"{getattr(error, 'strerror', None) or error}".rstrip(".")
        raise FastGSError(f"{path} could not be written: {reason}; what was there before is kept.") from error


def write_json(path: Path, values) -> None:
    """A small JSON file, all of it or what was there before."""
    write_aside(path, lambda part: part.write_text(json.dumps(values, indent=2, allow_nan=False) + "\n", "utf-8"))


def remove_leftovers(folder) -> None:
    """Remove what killed runs have left aside in a folder that only this run writes to."""
    for part in Path(folder).glob(".fastgs-*.tmp"):
        part.unlink(missing_ok=True)

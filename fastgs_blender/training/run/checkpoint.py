# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes and reads checkpoints: the whole state of a run in one safetensors file, never half written (temporary file, then renamed)."""
import json
from pathlib import Path

import numpy as np

from ...util.errors import FastGSError
from ...util.outputs import writing
from ...util.reading import reading
from ...util.tensor_files import open_tensors, write_tensors
from ..core.state import LARGEST_COUNT, LONGEST, is_number
from .files import CHECKPOINT

VERSION = 1
KEY = "fast-gs checkpoint"
ADVICE = "it is no usable checkpoint, so delete it to train from the beginning"


def save(folder: Path, arrays: dict[str, np.ndarray], about: dict) -> None:
    """Replace the folder's checkpoint.  If that fails, the previous one is kept, and FastGSError gives the reason."""
    with writing([Path(folder) / CHECKPOINT]) as (part,):
        write_tensors(part, arrays, {KEY: json.dumps({"version": VERSION, **about}, allow_nan=False)})


def load(folder: Path) -> tuple[dict[str, np.ndarray], dict] | None:
    """(arrays, about) of the folder's checkpoint, None if it has none; raises FastGSError if it cannot be used.

    The file is read as a whole, not mapped: it may be replaced while it is in use.  Names and shapes of the arrays are those that the file
    claims; core/state.py compares them with what a model of the run's kinds has.
    """
    path = Path(folder) / CHECKPOINT
    if not path.exists():
        return None
    with reading(path, ADVICE):
        try:
            with open_tensors(path) as file:
                about = json.loads(file.metadata[KEY])
                arrays = {name: file.read(name) for name in file.entries}
        except FastGSError as error:
            raise FastGSError(f"{path}: {ADVICE} ({str(error).removeprefix(f'{path}: ').rstrip('.')}).") from error
        if not isinstance(about, dict) or about.get("version") != VERSION:
            raise FastGSError(f"{path} was written by another version of FAST-GS; train from the beginning or use that version.")
        if not is_number(about.get("iteration"), 0, LARGEST_COUNT, int) or not is_number(about.get("elapsed", 0.0), 0, LONGEST):
            raise FastGSError(f"{path}: it does not say how far the run is, so it is damaged; delete it to train from the beginning.")
    return arrays, about


def write_json(path: Path, values: object) -> None:
    """A small JSON file, all of it or what was there before."""
    with writing([path]) as (part,):
        part.write_text(json.dumps(values, indent=2, allow_nan=False) + "\n", "utf-8")

# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes the surroundings (the capture's cameras, the backdrop, a good view) into a model's file without changing its Gaussians."""
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..util.errors import FastGSError
from . import identify, load, save
from .native import Native


def annotate(path: str | Path, target: str | Path | None = None, **known: Any) -> None:
    """Write the model in `path` to `target` (None: in its own place) with other surroundings.

    known  members of Surroundings: backdrop, cameras, view.  Those that are not given stay.
    Raises FastGSError where the file is not FAST-GS's own, whose header alone has room for all of them, or cannot be written.
    """
    path, target = Path(path), Path(target or path)
    if not isinstance(identify(path), Native) or target.suffix.lower() not in Native.extensions:
        raise FastGSError(f"{target if target != path else path}: the backdrop, cameras and a good view are kept in {Native.name} files; "
                          "convert the model to one (fastgs convert), then store them there.")
    model = load(path)
    save(replace(model, surroundings=replace(model.surroundings, **known)), target)

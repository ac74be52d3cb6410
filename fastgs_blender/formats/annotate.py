# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes the surroundings (the capture's cameras, the backdrop, a good view) into a model's file without changing its Gaussians."""
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..model.chapters import Chapters
from ..util.errors import FastGSError
from . import identify, load, open_source, save
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
    source = open_source(path)
    around = replace(source.surroundings, **known)
    save(source.with_surroundings(around) if isinstance(source, Chapters) else replace(load(path), surroundings=around), target)

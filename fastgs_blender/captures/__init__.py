# SPDX-License-Identifier: GPL-3.0-or-later
"""Multi-view captures: open_capture() reads any layout in LAYOUTS.

A layout is one module with `name` (as users know it), `recognises(path) -> bool` and `load(path, options) -> Capture`; path is a
folder or a file that exists.  recognises() looks at names and first bytes only and never raises FastGSError; load() raises it.
"""
import contextlib
import importlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType

from ..util.arguments import shown
from ..util.documentation import page
from ..util.errors import FastGSError
from ..util.reading import reading
from .capture import Capture, Options, Points, Shot
from .clocks.files import read_clocks
from .clocks.timecode import RIGHT_TO
from .clocks.timecode import first_clocks as clocks_of_films

LAYOUTS = ("fastgs", "panoptic", "transforms", "immersive", "n3v", "technicolor", "metashape", "qualisys", "toml", "colmap", "opencv",
           "realityscan", "folders")
"""Modules of layouts/, asked in this order."""
__all__ = ["LAYOUTS", "Capture", "Options", "Points", "Shot", "identify", "layout_modules", "open_capture", "recognised"]


def layout_modules() -> list[ModuleType]:
    """All layouts, in the order in which they are asked."""
    return [importlib.import_module(f".layouts.{name}", __name__) for name in LAYOUTS]


def identify(path: str | os.PathLike, layout: str | None = None) -> ModuleType:
    """The layout of a capture, or the one of that name (its module's or the one users know); raises FastGSError."""
    path = _existing(path)
    if layout is not None:
        if not isinstance(layout, str):
            raise FastGSError(f"a layout has a name; there are {', '.join(LAYOUTS)}, not {shown(layout)}.")
        for module in layout_modules():
            if layout in {module.name, module.__name__.rpartition(".")[2]}:
                return module
        raise FastGSError(f"there is no layout {layout!r}; there are {', '.join(LAYOUTS)}.")
    found = recognised(path)
    if found is not None:
        return found
    if path.is_file() and path.suffix.lower() == ".json":
        raise FastGSError(f"{path}: this file describes no capture that is known here; a cameras.json of a capture says \"format\": "
                          f"\"fast-gs capture\", one of 3DGS trainers holds cameras alone ({page('captures')}).")
    raise FastGSError(f"{path}: this is no capture; give a folder with one folder of pictures or one video per camera, or a data set as "
                      f"{page('captures')} lists them.")


def recognised(path: Path) -> ModuleType | None:
    """The first layout that recognises a path that exists; None where none does."""
    for module in layout_modules():
        with contextlib.suppress(OSError, FastGSError):  # a file in it cannot be read, or is a pipe
            if module.recognises(path):
                return module
    return None


def open_capture(path: str | os.PathLike, *, scale: float | None = None, frames: slice | None = None, held_out: Sequence[str] | None = None,
                 layout: str | None = None, offsets: Mapping[str, float] | None = None) -> Capture:
    """The capture in a folder (or in a file of a layout that has one).

    scale, frames, held_out  see Options; layout: its name, where it is not to be found out
    offsets  of the cameras' clocks, in frames (see Options); None: those in sync.json beside the capture or, where there is none, those
             of the films' GPS time or timecode
    Raises FastGSError where the folder is no capture, or its description cannot be read; pixels.checks.check() looks at its pictures.

    Example:
        capture = fg.open_capture("my-capture", scale=0.5, frames=slice(0, 2))
    """
    path = _existing(path)
    clocks = read_clocks(path) if offsets is None else None
    options = Options(scale, frames, held_out, (clocks.offsets if clocks else {}) if offsets is None else offsets)
    with reading(path, "its description is damaged, so copy or export it again"):
        module = identify(path, layout)
        capture = module.load(path, options)
        if offsets is None and clocks is None and (first := clocks_of_films(capture)) is not None:
            capture = module.load(path, replace(options, offsets=first.offsets))
            capture.notes.append(f"these clocks are those of the films' {first.found_by}, right to about {RIGHT_TO[first.found_by]}; "
                                 "fastgs sync refines them")
        return capture


def open_scan(path: str | os.PathLike) -> Capture:
    """The photographs of a place (scan.py) in a folder or file; of a COLMAP workspace those that belong to no film.

    Raises FastGSError as open_capture().
    """
    path = _existing(path)
    with reading(path, "its description is damaged, so copy or export it again"):
        return identify(path, None).load(path, Options(scan=True))


def first_clocks(path: str | os.PathLike, layout: str | None = None) -> Mapping[str, float]:
    """The offsets that the films' GPS time or timecode gives, whatever sync.json says; none where they have neither."""
    found = clocks_of_films(open_capture(path, layout=layout, offsets={}))
    return {} if found is None else found.offsets


def _existing(path: str | os.PathLike) -> Path:
    path = Path(path)
    try:
        if not path.exists():
            raise FastGSError(f"{path}: there is no such capture; check the name and the folder.")
    except (OSError, ValueError) as error:
        raise FastGSError(f"{path}: this cannot be the name of a capture ({error}).") from error
    return path

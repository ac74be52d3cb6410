# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads and writes sync.json, which lies beside a capture of any layout and holds the clock offset of each camera.

    {"format": "fast-gs sync", "version": 1, "found_by": "motion",
     "offsets": {"cam00": 0.0, "cam03": 0.4}, "uncertainty": {"cam00": 0.02, "cam03": 0.03}}

Offsets and uncertainties are in frames of the capture: picture f of a camera shows the moment f + offset of the others.  A camera that
is not listed has the offset 0.
"""
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ...cameras import poses
from ...util.arguments import shown
from ...util.errors import FastGSError
from ...util.outputs import writing
from ...util.reading import read_json

FILE = "sync.json"
FORMAT, VERSION = "fast-gs sync", 1
MOST = 1e6
"""Frames of the largest offset."""


@dataclass(frozen=True)
class Clocks:
    """How far the cameras' clocks are from each other, by name, in frames of the capture.

    offsets      picture f of a camera shows the moment f + offset
    uncertainty  standard deviation of an offset, where it is known
    found_by     what they were found by, in a word

    Example:
        clocks = fg.Clocks({"cam01": 0.4})
        capture = fg.open_capture("my-capture", offsets=clocks.offsets)
    """

    offsets: Mapping[str, float]
    uncertainty: Mapping[str, float] = field(default_factory=dict)
    found_by: str = "hand"


def place_of(capture: str | os.PathLike) -> Path:
    """The sync.json of the capture in a folder or a file."""
    path = Path(capture)
    return (path if path.is_dir() else path.parent) / FILE


def read_clocks(capture: str | os.PathLike) -> Clocks | None:
    """What sync.json beside a capture says, None where there is none; raises FastGSError where it cannot be understood."""
    path = place_of(capture)
    if not path.is_file():
        return None
    values = read_json(path)
    if not isinstance(values, dict) or values.get("format") != FORMAT:
        raise FastGSError(f'{path}: it does not say "format": "{FORMAT}"; remove it, or find the offsets again with fastgs sync.')
    version = poses.integer(values.get("version", VERSION), f"{path}: its version", 1, 10**6)
    if version > VERSION:
        raise FastGSError(f"{path}: its version {version} is newer than this program, which knows version {VERSION}; update it.")
    table = poses.table(values.get("offsets"), f"{path}: its offsets")
    offsets = {name: poses.number(value, f"{path}: the offset of {name!r}", -MOST, MOST) for name, value in table.items()}
    table = poses.table(values.get("uncertainty", {}), f"{path}: its uncertainty")
    uncertainty = {name: poses.number(value, f"{path}: the uncertainty of {name!r}", 0, MOST) for name, value in table.items()}
    return Clocks(offsets, uncertainty, poses.name_of(values.get("found_by", "hand"), f"{path}: its found_by"))


def write_clocks(capture: str | os.PathLike, clocks: Clocks) -> Path:
    """Write sync.json beside a capture: training and all else that opens the capture then know its clocks.  Returns the file's path.

    Raises FastGSError where it cannot be written.

    Example:
        fg.write_clocks("my-capture", fg.Clocks({"cam01": 0.4}))
    """
    if not isinstance(clocks, Clocks):
        raise FastGSError(f"{FILE} is written from Clocks, such as those of find_offsets(), not from {shown(clocks)}.")
    path = place_of(capture)
    values = {"format": FORMAT, "version": VERSION, "found_by": clocks.found_by,
              "offsets": {name: round(float(value), 4) for name, value in clocks.offsets.items()},
              "uncertainty": {name: round(float(value), 4) for name, value in clocks.uncertainty.items()}}
    text = json.dumps(values, indent=1, allow_nan=False) + "\n"
    with writing([path], "copy the capture to another place") as (part,):
        part.write_text(text, encoding="utf-8")
    return path

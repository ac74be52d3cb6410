# SPDX-License-Identifier: GPL-3.0-or-later
"""Folders for captures and runs that the user did not name: beside the .blend, else in the extension's folder."""
from __future__ import annotations

from pathlib import Path

import bpy

from . import store


def fresh(kind: str) -> str:
    """A folder that is not there yet, for a "capture" or a "training"."""
    if bpy.data.filepath:
        blend = Path(bpy.data.filepath)
        base = blend.parent / f"{blend.stem}-{kind}"
    else:
        base = store.folder("training/untitled") / kind
    place, number = base, 1
    while place.exists():
        number += 1
        place = base.with_name(f"{base.name}-{number}")
    return str(place)

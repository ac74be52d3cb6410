# SPDX-License-Identifier: GPL-3.0-or-later
"""Chooses folders for captures and runs that the user did not name: beside the .blend, else in the extension's folder."""
from __future__ import annotations

from pathlib import Path

import bpy

from . import installation


def unused(kind: str) -> str:
    """An unused path for the folder of a new "capture" or "training"."""
    if bpy.data.filepath:
        blend = Path(bpy.data.filepath)
        base = blend.parent / f"{blend.stem}-{kind}"
    else:
        base = installation.folder("training/untitled") / kind
    place, number = base, 1
    while place.exists():
        number += 1
        place = base.with_name(f"{base.name}-{number}")
    return str(place)

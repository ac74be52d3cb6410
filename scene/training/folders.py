# SPDX-License-Identifier: GPL-3.0-or-later
"""Chooses folders for captures and runs: what the user named, or a new one beside the .blend, else in the extension's folder."""
from pathlib import Path

import bpy

from ...fastgs_blender.jobs.job import ENDED
from ...fastgs_blender.jobs.places import Place, next_free, place_for
from . import installation, watch


def unused(kind: str) -> str:
    """An unused path for the folder of a new "capture" or "training"."""
    if bpy.data.filepath:
        blend = Path(bpy.data.filepath)
        base = blend.parent / f"{blend.stem}-{kind}"
    else:
        base = installation.folder("training/untitled") / kind
    return next_free(base, _busy())


def place(out: str, choice: str) -> Place:
    """The Place of a run in the folder that the user named, or in a new one."""
    if not out:
        new = unused("training")
        return Place(new, text=f"The run goes into the new folder {Path(new).name}.")
    return place_for(str(Path(bpy.path.abspath(out)).absolute()), choice, _busy())


def _busy() -> dict[str, str]:
    """The folders of the jobs that have not ended, with the kinds of their states."""
    return {job.out: state.kind for job, state in watch.found() if state.kind not in ENDED}

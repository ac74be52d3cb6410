# SPDX-License-Identifier: GPL-3.0-or-later
"""Chooses the folder of a training run, and decides what happens to a run that the folder already holds.  No bpy here."""
import contextlib
import re
from collections.abc import Container, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..training.run.files import CHECKPOINT, MODEL, RUN, STATUS
from ..training.run.plan import read_plan
from ..util.errors import FastGSError
from .job import read_status


@dataclass(frozen=True)
class ExistingRun:
    """The run that a folder holds.

    finished    whether it has a model
    iteration, iterations   steps that are done, and steps of the whole run; 0 where its files do not say
    psnr        in its held-out views; None where its files do not say
    capture     what it was trained on, "" where its files do not say
    """

    finished: bool
    iteration: int = 0
    iterations: int = 0
    psnr: float | None = None
    capture: str = ""

    @property
    def text(self) -> str:
        """What it is, as part of a sentence."""
        if not self.finished:
            return f"a run that ended at step {self.iteration:,} of {self.iterations:,}" if self.iterations else "an unfinished run"
        about = [f"{self.iterations:,} steps"] if self.iterations else []
        if self.psnr is not None:
            about.append(f"{self.psnr:.2f} dB")
        return f"a finished run ({', '.join(about)})" if about else "a finished run"


def existing_run(out: str | Path) -> ExistingRun | None:
    """The run in a folder; None where there is none."""
    out = Path(out)
    if not any((out / name).exists() for name in (RUN, CHECKPOINT, MODEL)):
        return None
    status, plan = read_status(out / STATUS), None
    with contextlib.suppress(FastGSError):
        plan = read_plan(out)
    whole = plan.settings.iterations if plan else status.get("iterations", 0)
    return ExistingRun((out / MODEL).exists(), status.get("iteration", 0), whole, status.get("held_out_psnr"),
                plan.source.capture or "" if plan else "")


def next_free(folder: str | Path, taken: Container[str] = ()) -> str:
    """The first path of FOLDER, FOLDER-2, FOLDER-3 ... where nothing is and which is not in `taken`; a number at its end is counted on."""
    folder = Path(folder)
    place, number = folder, 1
    if counted := re.fullmatch(r"(.+)-(\d{1,6})", folder.name):
        folder, number = folder.with_name(counted[1]), int(counted[2])
    while place.exists() or str(place) in taken:
        number += 1
        place = folder.with_name(f"{folder.name}-{number}")
    return str(place)


@dataclass(frozen=True)
class Place:
    """The folder of a run, and what happens to a run that it already holds.

    out       its folder
    existing  the option of `fastgs train` for what is there: "", --resume or --overwrite
    text      one sentence that says what will happen
    trouble   one sentence that says why nothing can, "" where it can
    asks      whether a run is there already, so that the user's choice counts
    capture   what a run that continues was trained on, "" where that is not known
    """

    out: str
    existing: str = ""
    text: str = ""
    trouble: str = ""
    asks: bool = False
    capture: str = ""


def place_for(out: str, choice: str, busy: Mapping[str, str] | None = None) -> Place:
    """The Place of a run in a folder, by the choice of the user for a run that it already holds.

    choice  REFUSE a run that is there, RESUME it, OVERWRITE it, or take a NEW folder beside it
    busy  the folders of jobs that have not ended, with the kind of their State
    """
    busy, name, run = busy or {}, Path(out).name, existing_run(out)
    if run is None and out not in busy:
        return Place(out, text=f"The run goes into {name}.")
    what = run.text if run else "a run that has not begun"
    if choice == 'NEW':
        new = next_free(out, busy)
        return Place(new, "", f"The folder {name} keeps {what}; the new run goes into {Path(new).name}.", asks=True)
    if out in busy and not (choice == 'RESUME' and busy[out] == 'PAUSED'):
        return Place(out, trouble=f"{out} belongs to a training job that has not ended; choose another folder, or stop that job first.",
                     asks=True)
    if choice == 'OVERWRITE':
        return Place(out, "--overwrite", f"The folder {name} holds {what}. It is deleted, and a new run begins.", asks=True)
    if choice == 'REFUSE':
        return Place(out, trouble=f"{out} holds {what}; continue it, overwrite it, or choose another folder.", asks=True)
    if run and run.finished:
        return Place(out, trouble=f"{out} holds {what}, and nothing is left to continue; begin anew, or take a new folder.", asks=True)
    return Place(out, "--resume", f"The folder {name} holds {what}. It continues, with its own capture and options.", asks=True,
                 capture=run.capture if run else "")

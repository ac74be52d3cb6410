# SPDX-License-Identifier: GPL-3.0-or-later
"""Holds a training process at a step, for tests alone.  Without the environment variable it does nothing.

FASTGS_BARRIER names a file with a line such as "step 12" or "checkpoint 12":

    step N        after step N has been taken and reported, before its checkpoint
    checkpoint N  while the checkpoint of step N is being written: the temporary file is complete and has not replaced the old one

A process that reaches that place, or a later step of the same kind, writes "step 12 PROCESS" into FILE.reached and waits until
the line in FILE is another one, or the file is gone.
"""
import os
import sys
import time
from pathlib import Path

VARIABLE = "FASTGS_BARRIER"
GUARD = 1800.0
"""Seconds after which a process ends that nobody releases: its test is gone.  Only a guard; no test waits for it."""


def wait(kind: str, step: int) -> None:
    """Wait here if the barrier is set for this kind of place at this step or an earlier one."""
    name = os.environ.get(VARIABLE)
    if not name:
        return
    file = Path(name)
    line = _line(file)
    wanted, _, number = line.partition(" ")
    if wanted != kind or not number.isdigit() or step < int(number):
        return
    reached, aside = Path(f"{name}.reached"), Path(f"{name}.{os.getpid()}.tmp")
    aside.write_text(f"{kind} {step} {os.getpid()}", "ascii")
    os.replace(aside, reached)
    until = time.monotonic() + GUARD
    while _line(file) == line:
        if time.monotonic() > until:
            sys.exit(f"fastgs: nobody has released {file} for {GUARD:.0f} s.")
        time.sleep(0.01)


def _line(file: Path) -> str:
    try:
        return file.read_text("ascii").strip()
    except OSError:
        return ""

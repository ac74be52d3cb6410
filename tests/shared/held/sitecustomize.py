# SPDX-License-Identifier: GPL-3.0-or-later
"""Holds a training process at a step.  Python runs this file at its start if this folder is on PYTHONPATH (see ../held_runs.py).

FASTGS_BARRIER names a file with a line such as "step 12" or "checkpoint 12":

    step N        after step N has been taken and reported, before its checkpoint
    checkpoint N  while the checkpoint of step N is being written: the temporary file is complete and has not replaced the old one

A process that reaches that place, or a later step of the same kind, writes "step 12 PROCESS" into FILE.reached and waits until
the line in FILE is another one, or the file is gone.
"""
from __future__ import annotations

import json
import os
import sys
import time
from functools import wraps
from importlib.machinery import PathFinder
from pathlib import Path

PACKAGE = "fastgs_blender.training.run."
GUARD = 1800.0
"""Seconds after which a process ends that nobody releases: its test is gone.  Only a guard; no test waits for it."""


def wait(kind, step):
    """Wait here if the barrier is set for this kind of place at this step or an earlier one."""
    file = Path(os.environ["FASTGS_BARRIER"])
    line = line_of(file)
    wanted, _, number = line.partition(" ")
    if wanted != kind or not number.isdigit() or step < int(number):
        return
    reached, aside = Path(f"{file}.reached"), Path(f"{file}.{os.getpid()}.tmp")
    aside.write_text(f"{kind} {step} {os.getpid()}", "ascii")
    os.replace(aside, reached)
    until = time.monotonic() + GUARD
    while line_of(file) == line:
        if time.monotonic() > until:
            sys.exit(f"nobody has released {file} for {GUARD:.0f} s.")
        time.sleep(0.01)


def line_of(file):
    try:
        return file.read_text("ascii").strip()
    except OSError:
        return ""


def waiting(function, kind, step):
    """The function, which waits after its work; step(*arguments) says at which step that is."""
    @wraps(function)
    def waits(*arguments):
        function(*arguments)
        wait(kind, step(*arguments))

    return waits


class Finder:
    """Lets the two modules wait in which a run writes checkpoints and reports steps."""

    @staticmethod
    def find_spec(name, path=None, target=None):
        if name not in (PACKAGE + "checkpoint", PACKAGE + "progress"):
            return None
        spec = PathFinder.find_spec(name, path, target)
        execute = spec.loader.exec_module

        def exec_module(module):
            execute(module)
            if name.endswith("checkpoint"):
                module.write_tensors = waiting(module.write_tensors, "checkpoint", lambda part, arrays, texts: json.loads(
                    texts[module.KEY]).get("iteration", 0))
            else:
                module.Reporter.step = waiting(module.Reporter.step, "step", lambda reporter, values: values["iteration"])

        spec.loader.exec_module = exec_module
        return spec


if "FASTGS_BARRIER" in os.environ:
    sys.meta_path.insert(0, Finder)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Holds training processes at a step (held/sitecustomize.py), so that tests know where a run is when they act on it."""
from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

GUARD = 600.0
"""Seconds after which a test that waits gives up.  Only a guard against hanging: no test is right or wrong by it.  What hangs is tried
once more in what CI has left."""

HOOK = Path(__file__).resolve().parent / "held"
"""On PYTHONPATH it makes a process wait."""


def until(done: Callable[[], object], guard: float = GUARD):
    """Wait until done() gives something true, and return that."""
    end = time.monotonic() + guard
    while not (found := done()):
        assert time.monotonic() < end, f"nothing has come for {guard:.0f} s"
        time.sleep(0.05)  # a look reads files, and takes the processor from what it waits for
    return found


class Barrier:
    """A place at which training processes wait."""

    def __init__(self, file: Path):
        self.file, self.reached = Path(file), Path(f"{file}.reached")

    @property
    def variables(self) -> dict[str, str]:
        """Environment variables for the processes that are to be held."""
        return {"FASTGS_BARRIER": str(self.file), "PYTHONPATH": os.pathsep.join([str(HOOK), *filter(None, [os.environ.get("PYTHONPATH")])])}

    def hold_at(self, place: str) -> None:
        """From now on processes wait at "step N" or "checkpoint N", or the first such place after it; those that wait go on."""
        self.reached.unlink(missing_ok=True)
        aside = self.file.with_suffix(".aside")
        aside.write_text(place, "ascii")
        os.replace(aside, self.file)

    def release(self) -> None:
        """No process is held any more."""
        self.file.unlink(missing_ok=True)
        self.reached.unlink(missing_ok=True)

    def wait(self, alive: Callable[[], bool]) -> tuple[int, int]:
        """(step, process) that is held, as soon as one is; alive() tells whether one may still come."""
        def held():
            if self.reached.exists():
                return self.reached.read_text("ascii").split()[1:]
            assert alive(), "the process has ended before it could be held"
            return None

        step, process = until(held)
        return int(step), int(process)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests this machine's GPUs in a process of its own, so that a driver that crashes ends that process alone.  No bpy here."""
import sys
import threading

from ..util.errors import FastGSError
from .command import Command, Watched

TRIES = 4
"""Processes that are begun before it is given up.  A GPU that has ended one is not tested again by the next."""


class Examination(Watched):
    """`fastgs info --devices` in another process, watched by a thread.

    part   of the names of the GPUs that are tested, "": all
    again  also those that have been tested before
    found  what describe_devices() gives, when it has ended; None where it could not
    trouble  why it could not, in a sentence, or ""
    """

    def __init__(self, part: str = "", again: bool = False, python: str = sys.executable) -> None:
        self.trouble = ""
        self.found: dict | None = None
        self._python, self._again, self._arguments = python, again, ["info", "--devices", *(["--device", part] if part else [])]
        self._command: Command | None = None
        self._stopped = False
        self._thread = threading.Thread(target=self._run, name="FAST-GS GPUs", daemon=True)
        self._thread.start()

    @property
    def line(self) -> str:
        """What it is doing."""
        return (self._command.line if self._command else "") or "looking for GPUs"

    def stop(self) -> None:
        """End it."""
        self._stopped = True
        if self._command is not None:
            self._command.stop()
        self._thread.join()

    def _run(self) -> None:
        for number in range(TRIES):
            try:
                self._command = Command(self._python, [*self._arguments, *["--again"] * (self._again and not number)],
                                        "the test of the GPUs", "this machine")
            except FastGSError as error:
                self.trouble = str(error)
                return
            self._command.wait()
            self.found = self._command.values
            if self.found is not None or self._stopped:
                return
        self.trouble = f"the GPUs could not be tested ({self.line})."

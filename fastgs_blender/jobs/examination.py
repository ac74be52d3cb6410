# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests this machine's GPUs in a process of its own, so that a driver that crashes ends that process alone.  No bpy here."""
from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import threading
from pathlib import Path

from .environment import end, environment, hidden

TRIES = 4
"""Processes that are begun before it is given up.  A GPU that has ended one is not tested again by the next."""


class Examination:
    """`fastgs info --devices` in another process, watched by a thread.

    part   of the names of the GPUs that are tested, "": all
    again  also those that have been tested before
    line   what it is doing
    found  what describe_devices() gives, when it has ended; None where it could not
    trouble  why it could not, in a sentence, or ""
    """

    def __init__(self, part: str = "", again: bool = False, python: str = sys.executable):
        self.line, self.trouble = "looking for GPUs", ""
        self.found: dict | None = None
        here = Path(__file__).resolve()
        self._command = [python, str(here.with_name("child.py")), str(here.parents[2]), "", "", "info", "--devices", "--json",
                         *(["--device", part] if part else [])]
        self._again, self._environment = again, environment(python)
        self._process: subprocess.Popen | None = None
        self._stopped = False
        self._thread = threading.Thread(target=self._run, name="FAST-GS GPUs", daemon=True)
        self._thread.start()

    @property
    def done(self) -> bool:
        """Whether it has ended."""
        return not self._thread.is_alive()

    def wait(self, seconds: float | None = None) -> bool:
        """Wait for its end, so long at most; returns whether it has ended."""
        self._thread.join(seconds)
        return self.done

    def stop(self) -> None:
        """End it."""
        self._stopped = True
        if self._process is not None:
            end(self._process)
        self._thread.join()

    def _run(self):
        for number in range(TRIES):
            try:
                text = self._once(self._command + ["--again"] * (self._again and not number))
            except OSError as error:
                self.trouble = f"the GPUs could not be tested ({error.strerror or error})."
                return
            with contextlib.suppress(ValueError):
                self.found = json.loads(text)
            if self.found is not None or self._stopped:
                return
        self.trouble = f"the GPUs could not be tested ({self.line})."

    def _once(self, command: list[str]) -> str:
        """The standard output of one process.  While it runs, `line` is its last remark."""
        self._process = subprocess.Popen(command, env=self._environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                                         stderr=subprocess.PIPE, encoding="utf-8", errors="replace", **hidden())
        with self._process as process:
            reader = threading.Thread(target=self._read, args=(process.stderr,), daemon=True)
            reader.start()
            text = process.stdout.read()
            reader.join()
        return text

    def _read(self, stream):
        for line in stream:
            if line.strip():
                self.line = line.strip().removeprefix("fastgs: ")

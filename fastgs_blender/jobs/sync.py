# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs `fastgs sync` in a process of its own: starts it, reads its progress, stops it, and describes its result."""
from __future__ import annotations

import json
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from ..util.errors import FastGSError
from . import causes
from . import environment as pythons


@dataclass(frozen=True)
class Result:
    """The offsets [frames] of a capture's cameras by name, how sure they are, which were not found, and the files that say so."""

    capture: str
    found_by: str
    offsets: dict[str, float]
    uncertainty: dict[str, float]
    lost: tuple[str, ...]
    file: str
    picture: str

    @property
    def text(self) -> str:
        """A line for each camera."""
        lines = [f"Clocks of {self.capture}, in frames, found by {self.found_by}", ""]
        for view, offset in self.offsets.items():
            sure = "unsure" if view in self.lost else f"+- {self.uncertainty[view]:.2f}" if view in self.uncertainty else ""
            lines.append(f"{view:24} {offset:+8.2f}  {sure}".rstrip())
        return "\n".join([*lines, "", f"Written to {self.file}, with which training uses them.", f"The picture is {self.picture}."])

    @property
    def summary(self) -> str:
        """One sentence."""
        most = max(self.offsets, key=lambda view: abs(self.offsets[view]))
        if abs(self.offsets[most]) < 0.1:
            return "The cameras' clocks agree to a tenth of a frame"
        return f"The clocks differ by up to {abs(self.offsets[most]):.2f} frames ({most}); sync.json says so to training"


class Sync:
    """The process that compares the clocks of a capture."""

    def __init__(self, python: str, capture: str):
        self.capture = capture
        self._out, self._log = (tempfile.TemporaryFile() for _ in range(2))  # noqa: SIM115 -- as long as the process
        here = Path(__file__).resolve()
        command = [python, str(here.with_name("child.py")), str(here.parents[2]), "", "", "sync", capture, "--json"]
        try:
            self._process = subprocess.Popen(command, env=pythons.environment(python), stdin=subprocess.DEVNULL, stdout=self._out,
                                             stderr=self._log)
        except OSError as error:
            raise FastGSError(f"{python}: the training Python cannot be started ({error.strerror}); test it in the preferences.") from error

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    @property
    def doing(self) -> str:
        """The last line that it printed about its progress."""
        lines = [line for line in self._printed(self._log).splitlines() if line.strip()]
        return lines[-1] if lines else "comparing the cameras' clocks"

    def wait(self) -> None:
        """Until it has ended."""
        self._process.wait()

    def end(self) -> None:
        """End it at once; nothing is written then."""
        self._process.kill()
        self._process.wait()

    def result(self) -> Result:
        """What it found; raises FastGSError with its reason where it failed."""
        try:
            values = json.loads(self._printed(self._out))
            return Result(self.capture, values["found_by"], values["offsets"], values["uncertainty"], tuple(values["lost"]), values["file"],
                          values["picture"])
        except (ValueError, KeyError, TypeError) as error:
            raise FastGSError(causes.sentence(None, self._printed(self._log), self._process.returncode, self.capture,
                                                "comparing the clocks")) from error

    @staticmethod
    def _printed(file) -> str:
        file.seek(0)
        return file.read().decode("utf-8", "replace")

# SPDX-License-Identifier: GPL-3.0-or-later
"""`fastgs check` in a process of the training Python, watched by a thread: Blender stays usable meanwhile.  No bpy here."""
from __future__ import annotations

import json
import subprocess
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path

from ..util.errors import FastGSError
from ..util.reading import read_json
from . import causes
from .environment import end, environment, hidden

LARGEST_STATUS = 1 << 16
PROBLEMS = 1
"""Exit code of a check that found something to be put right."""

latest: dict | None = None
"""The values of the check that ended last, for the panel; their "asked" is the path that was given."""


class CaptureCheck:
    """A check of a capture that is running or has ended.

    capture  the folder or file; out: folder for the page, "": beside it; options: further arguments of `fastgs check`
    values   what --json gives when it has ended well, else None; trouble: why not, in a sentence, or ""
    """

    def __init__(self, python: str, capture: str, out: str = "", options: Sequence[str] = ()):
        self.values: dict | None = None
        self.trouble, self._capture, self._stopped = "", capture, False
        self._folder = tempfile.TemporaryDirectory(prefix="fastgs-check-")
        self._status = Path(self._folder.name) / "status.json"
        here = Path(__file__).resolve()
        command = [python, str(here.with_name("child.py")), str(here.parents[2]), "", "", "check", capture, "--json", "--quiet",
                   "--status", str(self._status), *(["--out", out] if out else []), *options]
        try:
            self._process = subprocess.Popen(command, env=environment(python), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                                             stderr=subprocess.PIPE, encoding="utf-8", errors="replace", **hidden())
        except OSError as error:
            self._folder.cleanup()
            raise FastGSError(f"{python}: the training Python does not start ({error.strerror or error}); choose another.") from error
        self._thread = threading.Thread(target=self._run, name="FAST-GS check", daemon=True)
        self._thread.start()

    @property
    def done(self) -> bool:
        """Whether it has ended."""
        return not self._thread.is_alive()

    @property
    def progress(self) -> tuple[str, float]:
        """What it is doing, and the share of the whole that is done, 0..1."""
        try:
            values = read_json(self._status, LARGEST_STATUS)
            return str(values["stage"]), min(max(float(values["share"]), 0.0), 1.0)
        except (FastGSError, LookupError, TypeError, ValueError, OverflowError):  # not written yet, or just now
            return "starting", 0.0

    def wait(self, seconds: float | None = None) -> bool:
        """Wait for its end, so long at most; returns whether it has ended."""
        self._thread.join(seconds)
        return self.done

    def stop(self) -> None:
        """End it, if it has not ended."""
        self._stopped = True
        end(self._process)
        self._thread.join()

    def _run(self) -> None:
        global latest
        printed, errors = self._process.communicate()
        self._folder.cleanup()
        if self._stopped:
            return
        try:
            if self._process.returncode not in (0, PROBLEMS):
                raise ValueError
            self.values = json.loads(printed) | {"asked": self._capture}
            latest = self.values
        except (ValueError, TypeError):
            self.trouble = causes.sentence(None, errors, self._process.returncode, self._capture, "the check")


def text_of(values: dict) -> str:
    """The values of a check as a text: the verdict, the findings and where the page is."""
    lines = [str(values["capture"]), values["verdict"], ""]
    for finding in values["findings"]:
        lines += [f"{finding['severity'].upper()}: {finding['sentence']}", f"    {finding['advice']}", ""]
    return "\n".join([*lines, values["looked_at"], f"The page with pictures: {values['page']}", ""])

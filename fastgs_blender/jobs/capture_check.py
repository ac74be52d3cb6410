# SPDX-License-Identifier: GPL-3.0-or-later
"""`fastgs check` in a process of the training Python, and its result as a text.  No bpy here."""
import tempfile
from collections.abc import Sequence
from pathlib import Path

from ..util.errors import FastGSError
from ..util.reading import read_json
from .command import Command

LARGEST_STATUS = 1 << 16
PROBLEMS = 1
"""Exit code of a check that found something to be put right."""

latest: dict | None = None
"""The values of the check that ended last, for the panel; their "asked" is the path that was given."""


class CaptureCheck(Command):
    """A check of a capture that is running or has ended.

    capture  the folder or file; out: folder for the page, "": beside it; options: further arguments of `fastgs check`
    """

    def __init__(self, python: str, capture: str, out: str = "", options: Sequence[str] = ()) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="fastgs-check-")
        self._status = Path(self._folder.name) / "status.json"
        super().__init__(python, ["check", capture, "--quiet", "--status", str(self._status), *(["--out", out] if out else []), *options],
                         "the check", capture, (0, PROBLEMS))

    @property
    def progress(self) -> tuple[str, float]:
        """What it is doing, and the share of the whole that is done, 0..1."""
        try:
            values = read_json(self._status, LARGEST_STATUS)
            return str(values["stage"]), min(max(float(values["share"]), 0.0), 1.0)
        except (FastGSError, LookupError, TypeError, ValueError, OverflowError):  # not written yet, or just now
            return "starting", 0.0

    def _run(self) -> None:
        global latest
        super()._run()
        self._folder.cleanup()
        if self.values is not None:
            latest = self.values = self.values | {"asked": self._about}


def text_of(values: dict) -> str:
    """The values of a check as a text: the verdict, the findings and where the page is."""
    lines = [str(values["capture"]), values["verdict"], ""]
    for finding in values["findings"]:
        lines += [f"{finding['severity'].upper()}: {finding['sentence']}", f"    {finding['advice']}", ""]
    return "\n".join([*lines, values["looked_at"], f"The page with pictures: {values['page']}", ""])

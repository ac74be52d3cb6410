# SPDX-License-Identifier: GPL-3.0-or-later
"""`fastgs check` in a process of the training Python, and its result as a text.  No bpy here."""
from collections.abc import Sequence

from .command import StagedCommand

PROBLEMS = 1
"""Exit code of a check that found something to be put right."""

latest: dict | None = None
"""The values of the check that ended last, for the panel; their "asked" is the path that was given."""


class CaptureCheck(StagedCommand):
    """A check of a capture that is running or has ended.

    capture  the folder or file; out: folder for the page, "": beside it; options: further arguments of `fastgs check`
    """

    def __init__(self, python: str, capture: str, out: str = "", options: Sequence[str] = ()) -> None:
        super().__init__(python, ["check", capture, "--quiet", *(["--out", out] if out else []), *options], "the check", capture,
                         (0, PROBLEMS))

    def _run(self) -> None:
        global latest
        super()._run()
        if self.values is not None:
            latest = self.values = self.values | {"asked": self._about}


def text_of(values: dict) -> str:
    """The values of a check as a text: the verdict, the findings and where the page is."""
    lines = [str(values["capture"]), values["verdict"], ""]
    for finding in values["findings"]:
        lines += [f"{finding['severity'].upper()}: {finding['sentence']}", f"    {finding['advice']}", ""]
    return "\n".join([*lines, values["looked_at"], f"The page with pictures: {values['page']}", ""])

# SPDX-License-Identifier: GPL-3.0-or-later
"""Remarks to the user on standard error, which a quiet program leaves out.  Errors are no remarks."""
import sys

from .screen import tell

_quiet = False


def be_quiet(quiet: bool) -> None:
    """From now on leave remarks out, or print them."""
    global _quiet
    _quiet = quiet


def remark(text: str) -> None:
    """Print a line, unless this program is quiet."""
    if not _quiet:
        tell(text, sys.stderr)

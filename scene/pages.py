# SPDX-License-Identifier: GPL-3.0-or-later
"""The pages of the documentation that comes with the extension."""
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1] / "docs"
SUFFIX = ".html" if (DOCS / "guide.html").exists() else ".md"
"""The extension's zip holds pages for browsers, a copy of the repository those that they are made of."""


def path(name: str) -> Path:
    """Where the page docs/NAME.md lies, as the installed extension has it."""
    return DOCS / f"{name}{SUFFIX}"

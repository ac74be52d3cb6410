# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/formats.md has a row for every format of the registry, and says of each whether it is written."""
from __future__ import annotations

import re
from pathlib import Path

import pytest

from fastgs_blender.formats import FILES, FORMATS, WRITERS, readable, writable

LINES = (Path(__file__).parents[3] / "docs" / "formats.md").read_text(encoding="utf-8").splitlines()
HEAD, _, *ROWS = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in LINES if line.startswith("|")]


NOT_WRITTEN = ("no", "frames with `--at`")


def words(text: str) -> set[str]:
    return set(re.findall(r"[a-z0-9+]+", text.lower()))


def test_every_row_says_all():
    assert HEAD == ["format", "read", "write", "kept", "lost", "tested against"]
    assert all(len(row) == len(HEAD) and all(row) for row in ROWS)


@pytest.mark.parametrize("known", [*FORMATS, FILES], ids=lambda known: known.name)
def test_every_format_has_its_row(known):
    own = [row for row in ROWS if words(known.name) <= words(row[0])]
    assert own, f"no row of docs/formats.md names {known.name}"
    written = any(writer.name == known.name for writer in WRITERS if writer.extensions)
    assert any((row[2] not in NOT_WRITTEN) == written for row in own), f"docs/formats.md is wrong on whether {known.name} is written"


def test_every_extension_is_in_the_table():
    text = "\n".join(LINES)
    assert [name for name in (*readable(), *writable()) if name not in text] == []

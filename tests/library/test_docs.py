# SPDX-License-Identifier: GPL-3.0-or-later
"""The documentation names files, commands and options that exist."""
from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from fastgs_blender import cli

ROOT = Path(__file__).resolve().parents[2]
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    links = re.findall(r"\]\(([^)#\s]+)", page.read_text("utf-8"))
    assert not [link for link in links if "://" not in link and not (page.parent / link).exists()]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_make_targets_exist(page):
    rules = set(re.findall(r"^([\w.-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    assert set(re.findall(r"`make ([\w.-]+)`|^make ([\w.-]+)", page.read_text("utf-8"), re.MULTILINE)) <= {
        pair for rule in rules for pair in ((rule, ""), ("", rule))}


def test_the_examples_of_the_command_are_understood():
    lines = re.findall(r"^fastgs (.+)$", (ROOT / "README.md").read_text("utf-8"), re.MULTILINE)
    assert len(lines) >= 5
    for line in lines:
        assert cli.parser().parse_args(shlex.split(line, comments=True)).run


def test_the_picture_comes_first():
    first = (ROOT / "README.md").read_text("utf-8").splitlines()[0]
    assert re.fullmatch(r"!\[.+\]\(docs/first-light\.webp\)", first)

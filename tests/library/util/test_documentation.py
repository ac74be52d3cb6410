# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences name pages of docs/; in a build that has a website, its pages."""
from __future__ import annotations

import re
from pathlib import Path

import pytest

import fastgs_blender as fg
from fastgs_blender import captures
from fastgs_blender.util import documentation

ROOT = Path(__file__).resolve().parents[3]


def sentence(path: Path) -> str:
    path.write_bytes(b"no model")
    with pytest.raises(fg.FastGSError) as unread:
        fg.load(path)
    with pytest.raises(fg.FastGSError) as unknown:
        captures.open_capture(path.parent)
    return f"{unread.value} {unknown.value}"


def test_sentences_lead_to_pages_that_exist(tmp_path):
    assert set(re.findall(r"docs/\S+?\.md", sentence(tmp_path / "model.bin"))) == {"docs/formats.md", "docs/captures.md"}
    sources = "".join(path.read_text("utf-8") for path in (ROOT / "fastgs_blender").rglob("*.py"))
    named = set(re.findall(r"\{page\(['\"]([\w-]+)['\"]\)\}", sources))
    assert {"formats", "captures", "passes", "training"} <= named
    assert not [name for name in named if not (ROOT / "docs" / f"{name}.md").is_file()]


def test_with_a_website_they_lead_to_its_pages(tmp_path, monkeypatch):
    monkeypatch.setattr(documentation, "WEBSITE", "https://a.example/b/")
    text = sentence(tmp_path / "model.bin")
    assert "https://a.example/b/docs/formats.html" in text and "https://a.example/b/docs/captures.html" in text and ".md" not in text

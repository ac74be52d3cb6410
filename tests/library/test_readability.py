# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences of the documentation are short: on average under 18 words, and none over 35 (tools/readability.py).  Tests freeze none."""
from __future__ import annotations

import ast
import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MEAN, LONGEST = 18.0, 35


def tool():
    spec = importlib.util.spec_from_file_location("readability", ROOT / "tools" / "readability.py")
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


readability = tool()


@pytest.mark.parametrize("page", readability.pages(),
                         ids=lambda page: page.relative_to(ROOT).as_posix())
def test_sentences_are_short(page):
    mean, every = readability.measure(page)
    assert mean < MEAN
    assert not [" ".join(words) for words in every if len(words) > LONGEST]


def told(file: Path):
    """What a file tells its users: docstrings without their lists, and texts of help=... and description=..."""
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            paragraphs = re.sub(r"^ .*$|^\S+(, \S+)* {2,}.*$", "", ast.get_docstring(node) or "", flags=re.MULTILINE).split("\n\n")
            yield from (" ".join(paragraph.split()) for paragraph in paragraphs)
        if isinstance(node, ast.keyword) and node.arg in ("help", "description"):
            yield "".join(part.value for part in ast.walk(node.value) if isinstance(part, ast.Constant) and isinstance(part.value, str))


@pytest.mark.parametrize("folder", ["fastgs_blender/commands", "operators", "ui"])
def test_help_texts_and_tooltips_have_short_sentences(folder):
    every = [words for file in sorted((ROOT / folder).rglob("*.py")) for text in told(file) for words in readability.sentences(text)]
    assert len(every) > 50 and not [" ".join(words) for words in every if len(words) > LONGEST]


def test_what_counts_as_a_sentence():
    prose, cells = readability.blocks("# A heading\n\nOne two. Three\nfour `five six`.\n* An item\n  of a list\n\n"
                                      "| a | cell of it |\n|---|---|\n\n```\ncode. Code.\n```\n")
    assert prose == ["One two. Three four `five six`.", "An item of a list"] and [cell.strip() for cell in cells] == ["a", "cell of it"]
    assert [len(words) for words in readability.sentences(prose[0])] == [2, 3]
    assert [len(words) for words in readability.sentences("See [the words](of-a-link.md), 0.5 dB. (Then more.)")] == [5, 2]


def demanded(source: str):
    """What a test demands of a message: match=..., a column of parametrize() that goes there, and X of `X in ...`."""
    nodes = list(ast.walk(ast.parse(source)))
    matches = [node.value for node in nodes if isinstance(node, ast.keyword) and node.arg == "match"]
    names = {ast.unparse(value) for value in matches}
    wanted = matches + [node.left for node in nodes if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.In | ast.NotIn)]
    for node in nodes:
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("parametrize") and isinstance(node.args[0], ast.Tuple):
            columns = [i for i, name in enumerate(node.args[0].elts) if name.value in names]
            rows = [row.elts for row in getattr(node.args[1], "elts", ()) if isinstance(row, ast.Tuple)]
            wanted += [row[i] for row in rows for i in columns]
    return [part.value for value in wanted for part in ast.walk(value) if isinstance(part, ast.Constant) and isinstance(part.value, str)]


FROZEN = re.compile(r"[A-Za-z']+( [a-z']+){3,}")  # more than three words in a row


def test_tests_name_things_and_freeze_no_sentence():
    """A copy-editor can change a message that keeps its file, its setting and its remedy."""
    for file in sorted((ROOT / "tests").rglob("*.py")):
        assert not [text for text in demanded(file.read_text("utf-8")) if FROZEN.search(text)], file
    sample = ('parametrize(("a", "words"), [(1, "in one of them")])\nraises(match=words)\n'
              'raises(match="m.ply.*it is not there")\nassert "so it is said" in x and "three plain words" in x')
    assert sum(bool(FROZEN.search(text)) for text in demanded(sample)) == 3

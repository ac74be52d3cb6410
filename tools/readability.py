# SPDX-License-Identifier: GPL-3.0-or-later
"""How long the sentences of the documentation are: for each page the mean and the longest, in words.

    python tools/readability.py [PAGE ...] [--long 35]

Without pages: all of them.  --long prints every sentence that has more words.  Code and headings are left out; a piece of code within a
sentence and a number are one word.  Cells of tables count for the longest sentence, not for the mean.  tests/library/test_readability.py
holds the bounds.
"""
from __future__ import annotations

import argparse
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FENCE = re.compile(r"^ *```.*?^ *```$", re.MULTILINE | re.DOTALL)
ITEM = re.compile(r"^ *(?:[*-]|\d+\.) +")
END = re.compile(r"(?<=[.!?])[)\"*_]*\s+(?=[\"(*_`\[]*[A-Z0-9])")
WORD = re.compile(r"[\w][\w'.,:/%°-]*")


def pages() -> list[Path]:
    """The pages that people write: docs/api.md is made of docstrings."""
    found = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [page for page in found if page.name != "api.md"]


def blocks(text: str) -> tuple[list[str], list[str]]:
    """(paragraphs and items of lists, cells of tables) of a page of Markdown."""
    prose, cells, current = [], [], []
    for line in [*FENCE.sub("\n", text).splitlines(), ""]:
        if line.lstrip().startswith("|"):
            cells += [cell for cell in line.strip().strip("|").split("|") if not re.fullmatch(r"[ :-]*", cell)]
            line = ""
        new = ITEM.match(line)
        if not line.strip() or line.startswith(("#", "![")) or new:
            if current:
                prose.append(" ".join(current))
            current = []
        if line.strip() and not line.startswith(("#", "![")):
            current.append(line[new.end():] if new else line.strip())
    return prose, cells


def sentences(block: str) -> list[list[str]]:
    """The sentences of a block, each as its words."""
    block = re.sub(r"`[^`]*`", "Code", block)
    block = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", block)
    found = [WORD.findall(sentence) for sentence in END.split(block)]
    return [words for words in found if words]


def measure(page: Path) -> tuple[float, list[list[str]]]:
    """(the mean length of a page's sentences, all of them with those in tables)."""
    prose, cells = blocks(page.read_text("utf-8"))
    running = [words for block in prose for words in sentences(block)]
    every = running + [words for cell in cells for words in sentences(cell)]
    return sum(map(len, running)) / max(len(running), 1), every


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="*", type=Path)
    parser.add_argument("--long", type=int, help="print the sentences that have more words")
    options = parser.parse_args()
    print(f"{'page':32}{'sentences':>10}{'mean':>8}{'longest':>9}")
    for page in options.pages or pages():
        mean, every = measure(page)
        name = page.resolve().relative_to(ROOT).as_posix()
        print(f"{name:32}{len(every):10}{mean:8.1f}{max(map(len, every), default=0):9}")
        for words in every:
            if options.long and len(words) > options.long:
                print(f"    {len(words)}: {' '.join(words)}")


if __name__ == "__main__":
    main()

# SPDX-License-Identifier: GPL-3.0-or-later
"""What MkDocs does otherwise than GitHub, so that the same pages read alike on both; and what the first page shows beside README."""
from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path
from urllib.parse import urlencode

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]

from gallery import ENTRIES  # noqa: E402
from html_pages import anchor  # noqa: E402

ITEM = re.compile(r" *([*+-]|\d+\.) +(?=\S)")
FIRST = re.compile(r"!\[(?P<alt>[^\]]*)\]\((?P<src>[^)]*)\)\s+# (?P<title>[^\n]+)\s+(?P<lead>[^.]+\.)(?P<rest>.*)", re.DOTALL)
"""How README begins: its picture, its title, a sentence."""
PLAYED = "<!-- pages of the gallery -->"
"""Where a document has this, the site lists them."""
SYSTEMS = (("windows", "windows-x64", "Windows"), ("apple", "macos-arm64", "macOS, Apple silicon"), ("apple", "macos-x64", "macOS, Intel"),
           ("linux", "linux-x64", "Linux"))
"""Icon, Blender's name of the platform, ours."""


def on_config(config):
    """Headings have GitHub's anchors."""
    config.mdx_configs["toc"]["slugify"] = lambda words, separator: anchor(words)
    return config


def on_page_markdown(markdown, page, config, files, **_):
    """Lists are indented as Python-Markdown wants it.  README becomes the first page."""
    if page.is_homepage:
        first = FIRST.fullmatch(markdown)
        out = Path(os.environ["SITE_OUT"])
        page.meta |= {"template": "home.html", "hide": ["navigation"], **first.groupdict()}
        page.meta |= {"gallery": cards(files), "systems": systems(out / "index.json"), "play": there(files, "play/dancer.html"),
                      "repository": (config.site_url or "") + "index.json" if (out / "index.json").is_file() else ""}
        markdown = first["rest"]
    return reindented(markdown.replace(PLAYED, "\n".join(played(page.file, files))))


def there(files, path: str) -> str:
    """The path, if the site has this file."""
    return path if files.get_file_from_path(path) else ""


def cards(files) -> list[dict]:
    """The gallery's entries that have a picture; with a page and its size, where one was made."""
    return [dict(title=entry.title, words=entry.words, picture=picture, still=there(files, f"docs/gallery/{name}-still.webp"),
                 play=(play := there(files, f"play/{name}.html")), size=megabytes(files, play))
            for name, entry in ENTRIES.items() if (picture := there(files, f"docs/gallery/{name}.webp"))]


def megabytes(files, path: str) -> str:
    """The size of a file of the site; empty without one."""
    return f"{Path(files.get_file_from_path(path).abs_src_path).stat().st_size / 1e6:.1f} MB" if path else ""


def played(here, files) -> list[str]:
    """A list of the gallery's pages, with links from a page of the documents."""
    return [f"* [{card['title']}]({os.path.relpath(card['play'], Path(here.src_path).parent)}), {card['size']}: {card['words']}"
            for card in cards(files) if card["play"]]


def systems(index: Path) -> list[dict]:
    """The systems and the zips for them in a repository's index.  Blender understands their links, if they are dropped into its window."""
    zips = json.loads(index.read_text("utf-8"))["data"] if index.is_file() else []

    def link(entry) -> dict:
        said = {key: entry[key] for key in ("blender_version_min", "blender_version_max") if key in entry}
        python = re.search(r"python(3\.\d+)", entry["archive_url"])
        return dict(link=f"{entry['archive_url']}?{urlencode({'repository': './index.json', **said, 'platforms': entry['platforms'][0]})}",
                    blender=f"with Python {python[1]}" if python else f"{entry['blender_version_min'].removesuffix('.0')} or newer",
                    megabytes=round(entry["archive_size"] / 1e6))

    return [dict(key=platform.split("-")[0], icon=icon, name=name, zips=[link(entry) for entry in zips if platform in entry["platforms"]])
            for icon, platform, name in SYSTEMS]


def reindented(markdown: str) -> str:
    """Lists with four spaces a level and an empty line before the first item; bars in tables' code without their escapes.

    GitHub counts as an item's text what is indented as far as its first word; Python-Markdown wants four spaces.
    """
    lines, inside, fence = [], [], ""
    for line in markdown.splitlines():
        text = line.lstrip()
        indent = len(line) - len(text)
        if text.startswith("|"):  # GitHub wants a bar in a cell's code escaped, and Python-Markdown shows the escape
            text = re.sub("`[^`]+`", lambda code: code[0].replace("\\|", "|"), text)
        listed = bool(inside)
        if text and not fence:
            while inside and indent < inside[-1]:
                inside.pop()
        lines.append(" " * (4 * len(inside) + max(indent - (inside[-1] if inside else 0), 0)) + text if text else "")
        mark = re.match("`{3,}|~{3,}", text)
        if fence:
            fence = "" if text.startswith(fence) else fence
        elif mark:
            fence = mark[0]
        elif item := ITEM.match(line):
            if not listed and len(lines) > 1 and lines[-2]:
                lines.insert(-1, "")
            inside.append(item.end())
    return "\n".join(lines)

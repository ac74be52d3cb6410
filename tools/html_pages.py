# SPDX-License-Identifier: GPL-3.0-or-later
"""Turns a page of Markdown, as in docs/, into one that browsers show."""
from __future__ import annotations

import html
import re
from itertools import pairwise

from markdown_it import MarkdownIt

PAGE = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>
:root {{ color-scheme: light dark; }}
body {{ max-width: 56rem; margin: 2rem auto; padding: 0 1rem; font: 1rem/1.55 system-ui, sans-serif; }}
a {{ color: light-dark(#0b61c4, #7db7ff); }}
img {{ max-width: 100%; height: auto; }}
pre, table {{ overflow-x: auto; display: block; }}
pre {{ padding: .7rem; }}
pre, code {{ background: light-dark(#f0f1f3, #2a2c30); border-radius: .3rem; font-family: ui-monospace, monospace; font-size: .92em; }}
table {{ border-collapse: collapse; }}
th, td {{ padding: .3rem .6rem; border: 1px solid light-dark(#d0d3d8, #4a4d53); text-align: left; vertical-align: top; }}
</style>
{navigation}
{body}
</html>
"""


def page(text: str, home: str = "") -> str:
    """The HTML of a page of Markdown.  Links to other pages of Markdown lead to their HTML, and headings have GitHub's anchors.

    home  where a link above the text leads, to the page that leads through the others; none where it is empty
    """
    markdown = MarkdownIt("commonmark").enable("table")
    tokens = markdown.parse(text)
    title = ""
    for heading, words in pairwise(tokens):
        if heading.type == "heading_open":
            heading.attrSet("id", anchor(words.content))
            title = title or words.content
    for link in (part for token in tokens for part in token.children or () if part.type == "link_open"):
        link.attrSet("href", re.sub(r"^([^:#]+)\.md(#|$)", r"\1.html\2", link.attrs["href"]))
    navigation = f'<nav><a href="{home}">Documentation</a></nav>' if home else ""
    return PAGE.format(title=html.escape(title), navigation=navigation, body=markdown.renderer.render(tokens, markdown.options, {}))


def anchor(heading: str) -> str:
    """What GitHub calls a heading in links to it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")

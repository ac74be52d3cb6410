# SPDX-License-Identifier: GPL-3.0-or-later
"""A page whose file is damaged or cut off says so, wherever that is."""
from __future__ import annotations

import re

import pytest
from conftest import IN_BOTH
from knot_pages import SIZE, sentence, state, visible


def cut(pattern):
    """Cuts a page off behind what the pattern finds."""
    return lambda text: text[:re.search(pattern, text).end() + 100]


def other(pattern, letters):
    """Overwrites what comes behind what the pattern finds."""
    def change(text):
        at = re.search(pattern, text).end()
        return text[:at] + letters + text[at + len(letters):]

    return change


@pytest.mark.parametrize("change", [
    cut('id="model-0">'), cut('id="model_worker">'), cut('id="scene">'), other('id="model-0">.{2000}', "AAAAAAAA"),
    other('id="model-0">.{2000}', "****"), other('id="scene">', "[[[["), other('"version":', "7"), other('"opening":', "null,     "),
    other('"parts":', "null,       "), other('"cameras":', "[],      "), other(r'(?s)id="model_worker">.{9000}', "~"),
])
def test_a_damaged_page_ends_in_a_sentence(opened, page, change):
    page("damaged.html", change=change)
    tab = opened("damaged.html")
    assert state(tab) == "failed"
    assert sentence(tab).startswith("This page is damaged") and sentence(tab).endswith(".")
    assert visible(tab, "poster") and not visible(tab, "bar")


@IN_BOTH
def test_a_page_without_its_style_says_so(opened, page):
    page("damaged.html", change=other("--ink:", "~"))
    tab = opened("damaged.html")
    assert state(tab) == "failed" and sentence(tab).startswith("This page is damaged: its style")


@IN_BOTH
@pytest.mark.parametrize("last", [
    "</style>", 'content="default-src', "<title>A knot", "--ink:", "<body><p id", "player has not", 'id="poster" alt="'])
def test_a_page_that_ends_before_its_player_says_so(browser, page, last):
    page("damaged.html", change=lambda text: text[:text.index(last) + len(last)])
    tab = browser.open("damaged.html", SIZE)
    tab.evaluate("document.getAnimations().forEach((each) => each.finish())")
    said = tab.evaluate("document.body.innerText + getComputedStyle(document.body, '::before').content")
    assert "incomplete" in said or "player has not" in said
    tab.close()


@pytest.mark.parametrize("change", [cut('<script type="module" async>'), other('<script type="module" async>', "broken(")])
def test_a_page_whose_player_is_damaged_says_so_without_it(browser, page, change):
    page("damaged.html", change=change)
    tab = browser.open("damaged.html", SIZE)
    tab.evaluate("document.getAnimations().forEach((each) => each.finish())")
    assert visible(tab, "unstarted") and visible(tab, "poster")
    assert "incomplete or damaged" in tab.evaluate("document.getElementById('unstarted').innerText")
    tab.close()

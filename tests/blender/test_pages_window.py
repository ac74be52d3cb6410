# SPDX-License-Identifier: GPL-3.0-or-later
"""Export Web Page in Blender's window, and a page on two sizes.  The documents' pictures of both are taken here."""
from __future__ import annotations

import json
import re

import pytest
from conftest import EXAMPLE, OUTPUT, ROOT

import fastgs_blender as fg
from fastgs_blender.formats import web


def test_from_the_menu_to_a_page(user, small_model):
    """The dialog's options reach the page."""
    facts = user.story("pages_window.from_menu_to_report", window=True, model=small_model[1])
    assert facts["written"] and facts["frames"] == [1, 6]
    text = (user.folder / "knot.html").read_text("utf-8")
    page = json.loads(re.search(r'<script type="application/json" id="scene">(.*?)</script>', text, re.DOTALL)[1])
    assert page["title"] == "A knot" and page["frames"] == 6 and page["background"] == pytest.approx((0.1, 0.2, 0.4), abs=1e-6)


@pytest.mark.parametrize(("name", "size"), [("desktop", (960, 540)), ("phone", (390, 844))])
def test_the_example_on_a_desktop_and_on_a_phone(browser, name, size):
    """The buttons lie within the window, and a finger finds them."""
    model = fg.load(EXAMPLE)
    web.save_page(web.page_of(model, title="By the fireside"), browser.folder / "looked-at.html", packed={model: EXAMPLE.read_bytes()})
    tab = browser.open("looked-at.html#t=0.6", size, touch=name == "phone")
    tab.evaluate("fastgs.settled()")
    boxes = tab.evaluate("[...document.querySelectorAll('button')].map((each) => each.getBoundingClientRect()).filter(({width}) => width)"
                         ".map(({left, top, right, bottom}) => [left, top, right, bottom])")
    assert len(boxes) > 2
    for left, top, right, bottom in boxes:
        assert left >= 0 and top >= 0 and right <= size[0] and bottom <= size[1]
        assert name == "desktop" or min(right - left, bottom - top) >= 40
    picture = tab.screenshot(OUTPUT / f"page-{name}.png" if ROOT else None)
    assert picture.std() > 20
    tab.close()

# SPDX-License-Identifier: GPL-3.0-or-later
"""A page in the frame of the site's first screen (tools/website): the film before it goes once it draws, and stays where it cannot."""
from __future__ import annotations

import shutil
from pathlib import Path

import models
import pytest
from held_runs import until

from fastgs_blender.formats.web import page_of, save_page

SITE = Path(__file__).resolve().parents[2] / "tools" / "website" / "theme" / "assets"
OUTER = """<!doctype html><html class="js"><link rel="stylesheet" href="site.css"><section class="stage"><img class="stage__picture" alt="">
<iframe class="stage__picture stage__live" src="small.html#play=1"></iframe><button data-stage-hands>Look around</button></section>
<script src="home.js"></script></html>"""
SEEN = "[document.querySelector('.stage').className, getComputedStyle(document.querySelector('.stage__live')).pointerEvents]"
BLIND = "HTMLCanvasElement.prototype.getContext = () => null"


@pytest.fixture(scope="module")
def stage(browser):
    for name in ("site.css", "home.js"):
        shutil.copy(SITE / name, browser.folder)
    save_page(page_of(models.knot(300)), browser.folder / "small.html")
    (browser.folder / "stage.html").write_text(OUTER, "utf-8")
    return browser


def test_the_scene_takes_the_films_place_once_it_draws(stage):
    page = stage.open("stage.html", (480, 360))
    assert page.evaluate(SEEN)[1] == "none"  # the wheel and fingers scroll the page
    page.until("document.querySelector('.stage').classList.contains('stage--live')")
    for hands, pointer in ((True, "auto"), (False, "none")):
        page.evaluate("document.querySelector('[data-stage-hands]').click()")
        name, events = page.evaluate(SEEN)
        assert ("stage--hands" in name, events) == (hands, pointer)
    page.close()


def test_without_graphics_the_film_stays(stage):
    page = stage.open("stage.html", (480, 360), before=f"{BLIND}; addEventListener('message', ({{data}}) => window.heard = data)")
    until(lambda: page.evaluate("window.heard && window.heard.fastgs") == "failed")
    assert "stage--live" not in page.evaluate(SEEN)[0]
    page.close()

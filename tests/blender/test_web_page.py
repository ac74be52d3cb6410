# SPDX-License-Identifier: GPL-3.0-or-later
"""The page that Blender exports plays in a browser; what the example's page weighs."""
from __future__ import annotations

import base64
import re

import page_load
from conftest import EXAMPLE, library_camera
from drawn_pages import decibels, expected, shown

import fastgs_blender as fg
from fastgs_blender.formats import web
from fastgs_blender.formats.web.page import Page, PageObject


def test_blender_exports_a_page(user, browser, small_model):
    """The installed extension writes it, and the browser shows on its third frame what fg.render() draws of the model in it."""
    original, name = small_model
    facts, frames = user.story("background.page", model=name, output="exported.html", frames=6), 6
    text = (user.folder / "exported.html").read_text("utf-8")
    (browser.folder / "exported.html").write_text(text, "utf-8")
    held = browser.folder / "held.safetensors"
    held.write_bytes(base64.b64decode(re.search(r'id="model-0">([^<]*)<', text)[1]))
    model = fg.load(held)
    assert len(model) > 0.9 * len(original)
    tab = browser.open("exported.html#t=0", (320, 240))
    tab.evaluate("fastgs.settled()")
    assert tab.evaluate("fastgs.scene.frames") == frames
    camera = library_camera(facts["camera"])
    tab.rest()
    background = tab.evaluate("JSON.parse(document.getElementById('scene').textContent).background")
    still = Page([PageObject(model)], [camera], frames=model.clip.frame_count, background=background)
    assert decibels(shown(tab, camera, 2), expected(still, camera, 2)) >= 40
    assert not tab.requests and not tab.exceptions
    tab.close()


def test_the_page_of_the_example_is_small_and_soon_ready(browser):
    """Seconds are printed alone: they depend on the machine, and the software renderer's are among them."""
    model = fg.load(EXAMPLE)
    size = web.save_page(web.page_of(model), browser.folder / "timed.html", packed={model: EXAMPLE.read_bytes()})
    before = browser.cpu_seconds()
    tab = browser.open("timed.html", (240, 135))
    tab.evaluate("fastgs.ready")
    print(f"{size / 1e6:.2f} MB, ready after {browser.cpu_seconds() - before:.2f} s of processor")
    assert size < 6e6 and not tab.requests
    tab.close()


def test_many_gaussians_leave_the_main_thread_to_the_hand(browser, tmp_path):
    """Of the main thread a frame takes less than 8 ms of processor beside drawing; 200 frames hold no more memory than 20."""
    tab = page_load.opened(browser, tmp_path)
    first, later = page_load.scrubbed(tab, 20), page_load.scrubbed(tab, 180)
    print(first, later)
    assert later.main < 8
    assert later.textures == first.textures < 150 * page_load.COUNT / 1e6
    assert later.heap < first.heap + 1 and later.heap < 160 * page_load.COUNT / 1e6
    assert not tab.requests and not tab.exceptions
    tab.close()

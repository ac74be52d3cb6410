# SPDX-License-Identifier: GPL-3.0-or-later
"""The page that Blender exports plays in a browser; what the example's page weighs."""
from __future__ import annotations

import json
import shutil

import numpy as np
from conftest import EXAMPLE, library_camera, psnr

import fastgs_blender as fg
from fastgs_blender.formats import web
from fastgs_blender.formats.web.page import Page, PageObject
from fastgs_blender.formats.web.poster import shown


def test_blender_exports_a_page(user, browser, small_model):
    """The installed extension writes it, and the browser shows on its third frame what fg.render() draws."""
    model, name = small_model
    facts, frames = user.story("background.page", model=name, output="exported.html", frames=6), 6
    shutil.copy(user.folder / "exported.html", browser.folder)
    tab = browser.open("exported.html#t=0", (320, 240))
    tab.evaluate("fastgs.settled()")
    assert tab.evaluate("fastgs.scene.frames") == frames
    camera = library_camera(facts["camera"])
    seen = {**{key: getattr(camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy", "near")}, "orthographic": False,
            "pose": np.linalg.inv(camera.world_to_camera).ravel().tolist()}
    tab.evaluate("new Promise((rest) => { fastgs.renderer.onfresh = () => {}; setTimeout(rest, 300); })")
    pixels = tab.array(f"(async () => {{ const {{ renderer }} = fastgs; renderer.draw({json.dumps(seen)}, 2); "
                       "await renderer.settled(); return renderer.pixels(); })()")
    background = tab.evaluate("JSON.parse(document.getElementById('scene').textContent).background")
    still = Page([PageObject(model, times=(model.clip.t_of_frame(2),))], [camera], background=background)
    expected = shown(still, 0, camera)
    assert expected.std() > 0.03
    assert psnr(pixels.reshape(240, 320, 4)[..., :3] / 255, expected) >= 38  # compressed: up to 0.1 dB of the pictures' own quality
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

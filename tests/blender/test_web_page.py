# SPDX-License-Identifier: GPL-3.0-or-later
"""A page's pictures in a browser are those of fg.render(), at five times from five views; what it costs; what it asks for."""
from __future__ import annotations

import models
import numpy as np
import pytest
from conftest import EXAMPLE, psnr

import fastgs_blender as fg
from fastgs_blender.cameras.cameras_json import resized
from fastgs_blender.formats import web
from fastgs_blender.formats.native import Native
from fastgs_blender.formats.web.page import Page, PageObject
from fastgs_blender.formats.web.poster import shown

SIZE = 240, 135
ASLEEP = """new Promise((done) => {
    const next = window.requestAnimationFrame;
    window.requestAnimationFrame = () => 0;
    next.call(window, () => next.call(window, done)); })"""
"""The page draws nothing by itself any more."""
DRAWN = """(async () => {{
    fastgs.clock.pause();
    fastgs.renderer.draw({{pose: new Float64Array({pose}), fx: {fx}, fy: {fy}, cx: {cx}, cy: {cy}, width: {width}, height: {height},
                           orthographic: false}}, {frame});
    await fastgs.renderer.settled();
    return fastgs.renderer.pixels(); }})()"""


def baked():
    """A bend that goes through a sheet of a chequered mesh."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9), indexing="ij"))
    places = np.stack([np.stack([x, y, 0.4 * np.sin(3 * x + s)], -1) for s in np.linspace(0, 3, 9)])
    corner = np.add.outer(9 * np.arange(8), np.arange(8)).ravel()
    quads = np.stack([corner, corner + 9, corner + 10, corner, corner + 10, corner + 1], -1)
    colours = np.repeat(np.where((corner // 9 + corner % 9) % 2, 0.9, 0.2)[:, None] * [[1.0, 0.6, 0.3]], 2, 0)
    return fg.bake(places, quads.reshape(-1, 3), colours, count=3000).model


MODELS = {"bake": baked, "static": lambda: fg.freeze(models.knot(2000), 0.3)}


@pytest.fixture(scope="module", params=MODELS)
def opened(request, browser):
    """(what the page shows, the tab) of each model."""
    model, name = MODELS[request.param](), f"{request.param}.html"
    file = browser.folder / f"{request.param}.safetensors"
    Native().write(model, [file])
    page = web.page_of(model, background=(0.02, 0.05, 0.1))
    web.save_page(page, browser.folder / name, packed={model: file.read_bytes()})
    tab = browser.open(name, SIZE)
    tab.evaluate("fastgs.settled()")
    tab.evaluate(ASLEEP)
    yield page, tab
    tab.close()


def five(page: Page) -> list[tuple[fg.Camera, float]]:
    """Cameras around the opening one, and frames between the clip's first and last."""
    camera, last = resized(page.cameras[0], *SIZE), page.frames - 1
    pose = np.linalg.inv(camera.world_to_camera)
    away = np.linalg.norm(pose[:3, 3] - page.pivot)
    eyes = [pose[:3, 3] + away * (pose[:3, :3] @ step) for step in ((0, 0, 0), (0.1, 0, 0), (-0.1, -0.05, 0), (0, -0.1, 0.1), (0, 0, -0.2))]
    views = [fg.Camera(*SIZE, camera.fx, camera.fy, camera.cx, camera.cy, fg.look_at(eye, page.pivot, page.up)) for eye in eyes]
    return [(view, share * last) for view in views for share in (0.0, 0.21, 0.5, 0.77, 1.0)]


def test_pictures_are_those_of_the_library(opened):
    page, tab = opened
    (each,), found = page.objects, []
    for camera, frame in five(page):
        pose = np.linalg.inv(camera.world_to_camera).ravel().tolist()
        numbers = {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy", "width", "height")}
        pixels = tab.array(DRAWN.format(pose=pose, frame=frame, **numbers)).reshape(SIZE[1], SIZE[0], 4)
        still = Page([PageObject(each.model, times=(frame / page.frames,))], [camera], background=page.background)
        found.append(psnr(pixels[..., :3] / 255, shown(still, 0, camera)))
    print("dB:", np.round(found, 1))
    assert min(found) >= 40
    assert not tab.requests and not tab.exceptions


def test_the_page_of_the_example_is_small_and_soon_ready(browser):
    """Seconds are printed alone: they depend on the machine, and the software renderer's are among them."""
    model = fg.load(EXAMPLE)
    size = web.save_page(web.page_of(model), browser.folder / "timed.html", packed={model: EXAMPLE.read_bytes()})
    before = browser.cpu_seconds()
    tab = browser.open("timed.html", SIZE)
    tab.evaluate("fastgs.ready")
    print(f"{size / 1e6:.2f} MB, ready after {browser.cpu_seconds() - before:.2f} s of processor")
    assert size < 6e6 and not tab.requests
    tab.close()

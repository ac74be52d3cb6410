# SPDX-License-Identifier: GPL-3.0-or-later
"""Pages of a small knot for tests of a user's hands: fixtures that conftest.py offers."""
from __future__ import annotations

import io
import math
import wave
from dataclasses import replace

import models
import numpy as np
import pytest
from PIL import Image

import fastgs_blender as fg
from fastgs_blender.formats.native import Native
from fastgs_blender.formats.rate import LEVELS, Loss
from fastgs_blender.formats.web.page import Page, PageObject, Sound, write_page

SIZE = (480, 270)


def page_text(page, files):
    """The HTML of a page."""
    text = io.StringIO()
    write_page(text, page, files)
    return text.getvalue()


@pytest.fixture(scope="module")
def page(browser):
    """page(name, **what differs): writes a page of a small knot into the browser's folder, and returns its text."""
    model = models.knot(600)
    file = browser.folder / "knot.safetensors"
    writer = Native(Loss(LEVELS["fine"]))
    writer.write(writer.fit(model)[0], [file])
    data = file.read_bytes()
    cameras = [fg.Camera(*SIZE, 300, 300, 240, 135, looking(angle)) for angle in np.linspace(0, 0.5, 40)]
    picture = io.BytesIO()
    Image.new("RGB", SIZE, (250, 40, 160)).save(picture, "PNG")
    first = Page([PageObject(model)], cameras[:1], "A knot & a disc", 40, 20.0, poster=picture.getvalue(), pivot=(0, 0, 0.8))

    def write(name, moves=False, change=lambda text: text, **facts):
        facts |= {"cameras": cameras} if moves else {}
        text = change(page_text(replace(first, **facts), [data]))
        (browser.folder / name).write_text(text, "utf-8")
        return text

    write("knot.html")
    write("move.html", moves=True)
    write("loud.html", sound=Sound(tone(), "audio/wav"))
    return write


def looking(angle: float) -> np.ndarray:
    """World to camera, from five units away."""
    eye = np.array([5 * math.sin(angle), -5 * math.cos(angle), 2.0])
    forward = np.array([0, 0, 0.8]) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(forward, right), forward, eye], 1)
    return np.linalg.inv(pose)


def tone() -> bytes:
    """Two seconds of a WAV file."""
    data = io.BytesIO()
    with wave.open(data, "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(8000)
        file.writeframes((3000 * np.sin(np.arange(16000) / 3)).astype("<i2").tobytes())
    return data.getvalue()


@pytest.fixture
def opened(browser, page):
    """opened(name, size, **options): a tab whose page has come to its end: ready, waiting or failed.  Still pages keep their time."""
    tabs = []

    def open_page(name="knot.html", size=SIZE, **options):
        tabs.append(browser.open(name, size, **{"reduced_motion": True} | options))
        tabs[-1].until("/ready|waiting|failed/.test(document.body.dataset.state)")
        return tabs[-1]

    yield open_page
    for tab in tabs:
        assert tab.requests == []
        tab.close()


def state(tab):
    """What the page says it is: waiting, ready, failed."""
    return tab.evaluate("document.body.dataset.state")


def sentence(tab):
    """What its notice says."""
    return tab.evaluate("document.querySelector('#notice').innerText")


def visible(tab, name):
    """Whether an element is seen."""
    return tab.evaluate(f"""(() => {{ const e = document.getElementById("{name}"); const style = e && getComputedStyle(e);
        return Boolean(e) && style.display !== "none" &&
            style.visibility === "visible" && Number(style.opacity) > 0 && e.getClientRects().length > 0; }})()""")

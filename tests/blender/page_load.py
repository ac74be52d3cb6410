# SPDX-License-Identifier: GPL-3.0-or-later
"""What a page with many Gaussians costs while a hand scrubs and turns it: the main thread's time, and memory.  Chromium tells."""
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from drawn_pages import saved
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.formats.web.page import Page, PageObject, write_page

COUNT = 300_000
WATCH = """
    const textures = WebGL2RenderingContext.prototype, bytes = new Map(), made = textures.texStorage2D, gone = textures.deleteTexture;
    const bound = textures.bindTexture, sizes = { [0x8814]: 16, [0x881A]: 8, [0x8230]: 8, [0x822E]: 4, [0x8058]: 4 };
    let last = null;
    textures.bindTexture = function (target, texture) { last = texture; bound.call(this, target, texture); };
    textures.texStorage2D = function (target, levels, format, width, height) {
        bytes.set(last, sizes[format] * width * height);
        made.call(this, target, levels, format, width, height);
    };
    textures.deleteTexture = function (texture) { bytes.delete(texture); gone.call(this, texture); };
    textures.drawArraysInstanced = () => {};
    window.watched = () => [...bytes.values()].reduce((sum, each) => sum + each, 0);
"""
"""JavaScript before the page's own: adds up what its textures hold, and leaves out the drawing, which another process does."""
SCRUB = """(async () => {{
    const {{ renderer, orbit, scene }} = fastgs;
    for (let k = 0; k < {frames}; k++) {{
        orbit.show({{ ...orbit.goal, yaw: orbit.goal.yaw + 3 }});
        renderer.draw(orbit.camera(1), (7.3 * k) % scene.frames);
        await renderer.work;
    }}
    await renderer.settled();
}})()"""


@dataclass(frozen=True)
class Load:
    """Milliseconds of the main thread's processor for each frame, and megabytes at its end: of JavaScript with its worker, of textures."""

    main: float
    heap: float
    textures: float


def crowd(count: int = COUNT) -> fg.GaussianModel:
    """Many small splats that move, fade in and out, and have a decoder, in a cloud that a view from its middle shows a part of."""
    return random_model(np.random.default_rng(6), count, "line", "static", "radial", "clamp", size=0.002, motion=0.1,
                        clip=fg.Clip(40, 24.0))


def opened(browser, folder: Path):
    """A tab, at rest, with the page of such a crowd."""
    camera = fg.Camera(160, 90, 120, 120, 80, 45, fg.look_at((0, -2, 0.2), (0, 0, 0)))
    model, data = saved(crowd(), folder / "crowd.safetensors")
    with (browser.folder / "crowd.html").open("w", encoding="utf-8") as stream:
        write_page(stream, Page([PageObject(model)], [camera], frames=40, fps=24), [data])
    tab = browser.open("crowd.html#t=0", (160, 90), before=WATCH)
    tab.evaluate("fastgs.ready")
    tab.rest()
    return tab


def scrubbed(tab, frames: int) -> Load:
    """Draw frames of other times from other sides, each with an order of its own."""
    before = tab.metrics()["TaskDuration"]
    tab.evaluate(SCRUB.format(frames=frames))
    main = tab.metrics()["TaskDuration"] - before
    return Load(1000 * main / frames, sum(tab.memory()) / 1e6, tab.evaluate("watched()") / 1e6)

# SPDX-License-Identifier: GPL-3.0-or-later
"""The figures of the example's web page, in a browser without a window: python benchmarks/web.py [--browser chromium]

* bytes        of the page, and of the player's main script in it
* ready        seconds of processor, of all the browser's processes, from opening the page to its first picture
* main thread  milliseconds of a frame's draw() beside the drawing itself, which another process does: median and largest of 20 frames
* order        milliseconds from the last frame until its exact order is drawn, with the drawing
* heap         memory of the page's JavaScript after these frames

A second line is about 300 000 moving Gaussians, scrubbed and turned 200 times without being drawn: the main thread's processor time for
each frame, the memory of all JavaScript with the worker's, and that of textures, after 20 frames and after 200.

Without a graphics card the browser draws in software: seconds and orders are long then, and the main thread's milliseconds are right.
"""
from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), *(str(ROOT / "tests" / folder) for folder in ("blender", "shared"))]

import page_load  # noqa: E402
from browser import launched  # noqa: E402

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.formats import web  # noqa: E402
from fastgs_blender.formats.web.joining import joined  # noqa: E402
from fastgs_blender.formats.web.page import player_files  # noqa: E402

EXAMPLE = ROOT / "examples" / "fireside.safetensors"
FRAMES = """(async () => {
    const { renderer, orbit, clock } = fastgs, took = [];
    clock.pause();
    await fastgs.settled();
    for (let k = 0; k < 20; k++) {
        orbit.show({ ...orbit.goal, yaw: orbit.goal.yaw + 1 });
        orbit.arrive();
        const began = performance.now();
        renderer.draw(orbit.camera(1), (clock.frame + k) % fastgs.scene.frames);
        took.push(performance.now() - began);
        await new Promise((next) => requestAnimationFrame(next));
    }
    const began = performance.now();
    await renderer.settled();
    return [...took, performance.now() - began, performance.memory.usedJSHeapSize / 1e6];
})()"""


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--browser", default="chromium")
    options = parser.parse_args()
    model = fg.load(EXAMPLE)
    with tempfile.TemporaryDirectory() as folder, launched(options.browser, Path(folder)) as browser:
        print(f"{browser.version}, 640 x 360 pixels; the player has {len(joined('main.js', player_files())) / 1e3:.0f} kB")
        size = web.save_page(web.page_of(model), Path(folder, "page.html"), packed={model: EXAMPLE.read_bytes()})
        before = browser.cpu_seconds()
        tab = browser.open("page.html")
        tab.evaluate("fastgs.ready")
        ready = browser.cpu_seconds() - before
        *took, order, heap = tab.evaluate(FRAMES)
        print(f"{size / 1e6:.2f} MB, ready after {ready:.1f} s of processor, main thread {np.median(took):.2f} ms (at most "
              f"{max(took):.1f}), order {order:.0f} ms, heap {heap:.0f} MB, {len(tab.requests)} requests")
        tab.close()
        tab = page_load.opened(browser, Path(folder))
        first, later = page_load.scrubbed(tab, 20), page_load.scrubbed(tab, 180)
        print(f"{page_load.COUNT} Gaussians: main thread {later.main:.2f} ms a frame, heap {first.heap:.1f} and {later.heap:.1f} MB, "
              f"textures {first.textures:.1f} and {later.textures:.1f} MB")


if __name__ == "__main__":
    main()

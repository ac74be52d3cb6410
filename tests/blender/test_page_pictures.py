# SPDX-License-Identifier: GPL-3.0-or-later
"""Web pages show what fg.render() draws: every kind of model, in Chromium, offline."""
from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_models import APPEARANCES, BASES, TEMPORALS, random_model

import fastgs_blender as fg
from fastgs_blender.cameras.viewpoints import camera_of
from fastgs_blender.formats.web.page import Page, PageObject, page_text
from fastgs_blender.rendering import colour
from fastgs_blender.rendering.passes import PassSettings
from fastgs_blender.rendering.volumes import mesh_volume

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "fireside.safetensors"
DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
BACKGROUND = (0.2, 0.05, 0.4)
TIMES = (0.0, 0.21, 0.4, 0.625, 0.99)
LEAST = 40
"""Decibels, of the peak signal over the error."""


@pytest.fixture
def played(browser):
    """played(page, files): the page in the browser, at rest; nothing but tests draws in it any more."""
    def play(page, files):
        (browser.folder / "page.html").write_text(page_text(page, files), "utf-8")
        tab = browser.open("page.html#t=0")
        tab.until("['ready', 'failed'].includes(document.body.dataset.state)")
        assert tab.evaluate("document.body.dataset.state") == "ready", tab.messages
        tab.evaluate("new Promise((rest) => { fastgs.renderer.onfresh = () => {}; setTimeout(rest, 300); })")
        return tab
    return play


def shown(tab, camera, frame):
    """The picture [h, w, 3] of 0..1 that the page draws."""
    seen = {**{key: getattr(camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy", "near")},
            "orthographic": bool(camera.orthographic), "pose": np.linalg.inv(camera.world_to_camera).ravel().tolist()}
    pixels = tab.array(f"(async () => {{ const {{ renderer }} = fastgs; renderer.draw({json.dumps(seen)}, {frame}); "
                       "await renderer.settled(); return renderer.pixels(); })()")
    return pixels.reshape(camera.height, camera.width, 4)[..., :3] / 255


def expected(page, camera, frame):
    """What fg.render() and fg.save_image() make of it; all models are sRGB, and of what changes from frame to frame all is still."""
    instances = [replace(each, t=frame / page.frames) for each in page.instances(int(frame))]
    image = fg.render(instances, camera, settings=PassSettings(film="transparent"))
    linear = colour.scene_linear(image["rgb"], image["alpha"], instances[0].model.colour_space)
    linear = linear + (1 - image["alpha"][..., None]) * np.array(page.background)
    return np.clip(colour.linear_to_srgb(linear), 0, 1)


def decibels(tab, page, camera, frame):
    got, want = shown(tab, camera, frame), expected(page, camera, frame)
    assert want.std() > 0.03
    return -10 * np.log10(np.mean((got - want) ** 2))


def around(model, count=5, size=(160, 120), distance=4.0, extent=1.0):
    """Cameras around a model, the last one orthographic."""
    cameras = []
    for k in range(count):
        pose = fg.look_at((distance * np.sin(1.3 * k), -distance * np.cos(1.3 * k), extent * (0.5 - 0.3 * k)), (0, 0, 0))
        orthographic = k == count - 1
        focal = size[0] / (2.6 * extent) if orthographic else size[0]
        cameras.append(fg.Camera(*size, focal, focal, size[0] / 2, size[1] / 2, pose, orthographic=orthographic))
    return cameras


def saved(model, path, **options):
    fg.save(model, path, **options)
    return fg.load(path), path.read_bytes()


def looked_at(played, objects, files, cameras, times=TIMES):
    """The decibels of the worst picture of a page: of some cameras, each at some times."""
    page = Page(objects, cameras[:1], frames=40, background=BACKGROUND)
    tab = played(page, files)
    worst = min(decibels(tab, page, camera, 40 * t) for camera in cameras for t in times)
    assert not tab.requests and not tab.exceptions
    print(f"{worst:.1f} dB at least, processor {tab.browser.cpu_seconds():.1f} s")
    return worst


def test_the_example(played):
    model = fg.load(EXAMPLE)
    cameras = [replace(camera_of(each), width=320, height=180, fx=235.0, fy=235.0, cx=160.0, cy=90.0, window=None)
               for each in model.surroundings.cameras[::3]] + [camera_of(model.surroundings.view)]
    assert looked_at(played, [PageObject(model)], [EXAMPLE.read_bytes()], cameras) >= LEAST


@pytest.mark.parametrize("file", ["splatv/spinach_4.splatv", "scan/leica-sofort.ply"])
def test_films_and_scans_of_others(played, tmp_path, file):
    if not (DATA / file).exists():
        pytest.skip("the folder of real inputs is absent")
    model, data = saved(fg.load(DATA / file), tmp_path / "model.safetensors")
    centre = np.median(model.position, 0)
    cameras = [fg.Camera(320, 180, 260, 260, 160, 90, each.world_to_camera @ np.block([[np.eye(3), -centre[:, None]], [np.zeros(3), 1]]))
               for each in around(model)]
    assert looked_at(played, [PageObject(model)], [data], cameras) >= LEAST


def test_a_bake(played, tmp_path):
    n = 13
    x, y = (each.ravel() for each in np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n)))
    waves = np.stack([np.stack([x, y, 0.3 * np.sin(3 * x + 2 * np.pi * t)], 1) for t in np.arange(20) / 20])
    first = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    triangles = np.concatenate([np.stack([first, first + 1, first + n + 1], 1), np.stack([first, first + n + 1, first + n], 1)])
    chess = np.where((np.arange(len(triangles)) % 2)[:, None], (0.9, 0.3, 0.1), (0.1, 0.3, 0.8))
    model, data = saved(fg.bake(waves, triangles, chess, count=3000).model, tmp_path / "model.safetensors", compress="small")
    assert looked_at(played, [PageObject(model)], [data], around(model)) >= LEAST


def test_several_objects_with_looks_and_crops(played, tmp_path):
    """Plain colours and two decoders hide each other; shapes with sharp and soft edges cut them, one of them a closed mesh."""
    rng = np.random.default_rng(7)
    made = [saved(random_model(rng, 250, "paper", "line", "radial", look), tmp_path / "model.safetensors")
            for look in ("sh2", "clamp", "stg")]
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.8
    faces = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
                      [1, 5, 7], [1, 7, 3]])
    mesh = fg.Crop(np.eye(4), shape=mesh_volume(corners, faces, corners.min(0), corners.max(0)), soft=0.3)
    settings = [fg.ObjectSettings(exposure=0.5, saturation=1.4, splat_scale=1.3, opacity=0.8, crops=[mesh]),
                fg.ObjectSettings(hue=0.7, crops=[fg.Crop(np.diag([1.2, 1.5, 2, 1]), remove=True, shape="SPHERE")]),
                fg.ObjectSettings(gamma=1.2, pixel_size=0.05)]
    places = [np.eye(4), np.array([[0, -1.2, 0, 0.3], [1.2, 0, 0, 0], [0, 0, 1.2, 0.2], [0, 0, 0, 1]]), np.diag([1.4, 1.4, 1.4, 1])]
    objects = [PageObject(model, (place,), (), (look,)) for (model, _), place, look in zip(made, places, settings)]
    assert looked_at(played, objects, [data for _, data in made], around(made[0][0]), TIMES[1::2]) >= LEAST


def test_graphics_that_were_lost_come_back(played, tmp_path):
    model, data = saved(random_model(np.random.default_rng(2), 300, "paper", "line", "radial", "clamp"), tmp_path / "model.safetensors")
    page, camera = Page([PageObject(model)], around(model)[:1], frames=40, background=BACKGROUND), around(model)[1]
    tab = played(page, [data])
    before = shown(tab, camera, 8)
    tab.evaluate("""new Promise((back) => {
        const { renderer } = fastgs, { gl } = renderer.graphics, ends = gl.getExtension("WEBGL_lose_context");
        renderer.canvas.addEventListener("webglcontextlost", () => setTimeout(() => ends.restoreContext()), { once: true });
        renderer.canvas.addEventListener("webglcontextrestored", () => setTimeout(back), { once: true });
        ends.loseContext();
    })""")
    tab.until("document.getElementById('notice').textContent === ''")
    np.testing.assert_array_equal(shown(tab, camera, 8), before)
    assert not [text for text in tab.messages if "INVALID" in text]


def test_a_damaged_page_says_so(played, browser, tmp_path):
    _, data = saved(random_model(np.random.default_rng(1), 50, "paper"), tmp_path / "model.safetensors")
    model = fg.load(tmp_path / "model.safetensors")
    page = Page([PageObject(model)], around(model)[:1])
    for k, broken in enumerate((data[:-9], data[:200], bytes(300), b"")):
        (browser.folder / "broken.html").write_text(page_text(page, [broken]), "utf-8")
        tab = browser.open("broken.html")
        tab.until("document.body.dataset.state === 'failed'")
        said = tab.evaluate("document.getElementById('notice').textContent")
        assert said.startswith("This page is damaged: ") and said.endswith("Copy or export it again."), (k, said)


KINDS = list(zip(BASES, [*BASES][::-1], [*TEMPORALS] * 2, APPEARANCES)) + [
    ("paper", "line", "radial", look) for look in APPEARANCES[len(BASES):]]


@pytest.mark.parametrize("kinds", KINDS, ids="-".join)
def test_every_kind_of_model(played, tmp_path, kinds):
    basis, turns, temporal, look = kinds
    model, data = saved(random_model(np.random.default_rng(5), 200, basis, turns, temporal, look), tmp_path / "model.safetensors")
    assert looked_at(played, [PageObject(model)], [data], around(model)[2:], TIMES[1::2]) >= LEAST

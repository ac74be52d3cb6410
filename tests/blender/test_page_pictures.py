# SPDX-License-Identifier: GPL-3.0-or-later
"""Web pages show what fg.render() draws: every kind of model, in Chromium and Firefox, offline."""
from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import IN_BOTH
from drawn_pages import BACKGROUND, around, camera_text, decibels, expected, pixels, saved, shown
from random_models import APPEARANCES, BASES, TEMPORALS, random_model

import fastgs_blender as fg
from fastgs_blender.cameras.viewpoints import camera_of
from fastgs_blender.formats.web.long import clip_page
from fastgs_blender.formats.web.page import Page, PageObject, write_page
from fastgs_blender.rendering.volumes import mesh_volume

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "fireside.safetensors"
DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
TIMES = (0.21, 0.625)
LEAST = 40
"""Decibels, of the peak signal over the error."""


@pytest.fixture
def played(browser):
    """played(page, files, **options): the page in a tab, at rest: nothing but tests draws in it any more."""
    tabs = []

    def play(page, files, **options):
        with (browser.folder / "page.html").open("w", encoding="utf-8") as stream:
            write_page(stream, page, files)
        tabs.append(browser.open("page.html#t=0", **options))
        tabs[-1].until("['ready', 'failed'].includes(document.body.dataset.state)")
        tabs[-1].rest()
        return tabs[-1]

    yield play
    for tab in tabs:
        assert not tab.requests and not tab.exceptions
        tab.close()


def looked_at(played, objects, files, cameras, **options):
    """The decibels of the worst picture of a page: of some cameras, each at both times."""
    page = Page(objects, cameras[:1], frames=40, background=BACKGROUND)
    tab = played(page, files, **options)
    assert tab.evaluate("document.body.dataset.state") == "ready", tab.messages
    worst = min(decibels(shown(tab, camera, 40 * t), expected(page, camera, 40 * t)) for camera in cameras for t in TIMES)
    print(f"{worst:.1f} dB at least")
    return worst


def test_the_example(played):
    model = fg.load(EXAMPLE)
    cameras = [replace(camera_of(each), width=320, height=180, fx=235.0, fy=235.0, cx=160.0, cy=90.0, window=None)
               for each in model.surroundings.cameras[::6]] + [camera_of(model.surroundings.view)]
    assert looked_at(played, [PageObject(model)], [EXAMPLE.read_bytes()], cameras) >= LEAST


@pytest.mark.parametrize("file", ["splatv/spinach_4.splatv", "scan/leica-sofort.ply"])
def test_films_and_scans_of_others(played, tmp_path, file):
    if not (DATA / file).exists():
        pytest.skip("the folder of real inputs is absent")
    model, data = saved(fg.load(DATA / file), tmp_path / "model.safetensors")
    centre = np.median(model.position, 0)
    cameras = [fg.Camera(320, 180, 260, 260, 160, 90, each.world_to_camera @ np.block([[np.eye(3), -centre[:, None]], [np.zeros(3), 1]]))
               for each in around(model)[::2]]
    assert looked_at(played, [PageObject(model)], [data], cameras) >= LEAST


def comings(frames: int, runs: int, still: int, each: int) -> fg.GaussianModel:
    """A wall that stays, and balls before it, one after another, each for its run of frames."""
    rng = np.random.default_rng(0)
    k = np.arange(runs).repeat(each)
    wall = np.stack([*rng.uniform(-1.5, 1.5, (2, still)), np.full(still, 0.5)], 1)
    balls = np.stack([np.cos(2 * k), np.sin(2 * k), 0 * k], 1) + rng.normal(0, 0.15, (len(k), 3))
    count, mu = still + len(k), np.concatenate([np.full(still, 0.5), (k + 0.5) / runs])
    temporal = np.concatenate([np.tile([-9.0, 10, -3, -3], (still, 1)),
                               np.stack([k / runs, (k + 1) / runs, *np.full((2, len(k)), np.log(1 / frames))], 1)])
    return fg.GaussianModel(
        position=np.concatenate([wall, balls]), rotation=np.tile([1.0, 0, 0, 0], (count, 1)), scale=np.full((count, 3), -2.6),
        opacity=np.full(count, 2.0), features=rng.uniform(0, 1, (count, 3)), mu_tau=mu, temporal=temporal, temporal_kind=fg.Window(),
        clip=fg.Clip(frames, 30.0))


@IN_BOTH
def test_a_long_clip_is_read_chapter_by_chapter(played, tmp_path):
    """Across seams, at sub-frames and after jumps it shows what its chapters show, and it holds those around the moment alone."""
    path = tmp_path / "clip.safetensors"
    fg.save(fg.chapters(comings(240, 24, 400, 50), frames=10), path)
    page, packed = clip_page(path, background=BACKGROUND)
    source, camera = fg.open_source(path), around(None)[0]
    tab = played(page, [packed[each.model]() for each in page.objects])
    assert tab.evaluate("document.body.dataset.state") == "ready", tab.messages
    held = []
    for frame in (0, 19, 19.5, 20, 20.25, 40, 139, 140, 239, 3, 100, 99.5):
        model, t = source.moment(frame / 240)
        want = expected(replace(page, objects=[PageObject(model)], frames=1), camera, t)
        assert decibels(shown(tab, camera, frame), want) >= LEAST, frame
        held.append(tab.evaluate("fastgs.scene.models.filter((model) => model).length"))
    assert max(held) < 0.75 * len(page.objects), held


def test_a_bake(played, tmp_path):
    n = 13
    x, y = (each.ravel() for each in np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n)))
    waves = np.stack([np.stack([x, y, 0.3 * np.sin(3 * x + 2 * np.pi * t)], 1) for t in np.arange(20) / 20])
    first = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    triangles = np.concatenate([np.stack([first, first + 1, first + n + 1], 1), np.stack([first, first + n + 1, first + n], 1)])
    chess = np.where((np.arange(len(triangles)) % 2)[:, None], (0.9, 0.3, 0.1), (0.1, 0.3, 0.8))
    with pytest.warns(fg.LossWarning, match="quantised"):
        model, data = saved(fg.bake(waves, triangles, chess, count=3000).model, tmp_path / "model.safetensors", compress="small")
    assert looked_at(played, [PageObject(model)], [data], around(model)[2:]) >= LEAST


@IN_BOTH
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
    assert looked_at(played, objects, [data for _, data in made], around(made[0][0])[2:]) >= LEAST


@IN_BOTH
def test_the_edges_of_a_picture_are_whole_while_its_view_turns(played, tmp_path):
    """Frames with the order of the frame before, whose camera looked 5 degrees beside: as after their own, but for splats that overtook."""
    model, data = saved(random_model(np.random.default_rng(4), 12000, "line", size=0.015), tmp_path / "model.safetensors")
    camera = fg.Camera(160, 120, 160, 160, 80, 60, fg.look_at((0, -0.9, 0), (0, 0, 0)))
    tab = played(Page([PageObject(model)], [camera], frames=40, background=BACKGROUND), [data])
    for side in (-0.08, 0.08):
        turned = replace(camera, world_to_camera=fg.look_at((0, -0.9, 0), (side, 0, 0)))
        before = shown(tab, camera, 8)
        moving = pixels(tab, turned, f"renderer.ask = () => {{}}; renderer.draw({camera_text(turned)}, 8); delete renderer.ask")
        settled = shown(tab, turned, 8)
        edge = np.s_[:, :8] if side < 0 else np.s_[:, -8:]
        assert decibels(before[edge], settled[edge]) < 20 and decibels(moving[edge], settled[edge]) >= LEAST


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


def said(tab):
    """The sentence in which a page has ended."""
    assert tab.evaluate("document.body.dataset.state") == "failed"
    return tab.evaluate("document.getElementById('notice').textContent")


def test_a_damaged_page_says_so(played, tmp_path):
    model, data = saved(random_model(np.random.default_rng(1), 50, "paper"), tmp_path / "model.safetensors")
    page = Page([PageObject(model)], around(model)[:1])
    for k, broken in enumerate((data[:-9], data[:200], bytes(300), b"")):
        sentence = said(played(page, [broken]))
        assert sentence.startswith("This page is damaged: ") and sentence.endswith("Copy or export it again."), (k, sentence)


def without(extensions):
    """JavaScript that takes extensions of WebGL away, by a regular expression."""
    return (f"const asked = WebGL2RenderingContext.prototype.getExtension; WebGL2RenderingContext.prototype.getExtension = "
            f"function (name) {{ return /{extensions}/.test(name) ? null : asked.call(this, name); }};")


@pytest.mark.parametrize(("extensions", "least"), [("buffer_float", LEAST), ("buffer_(half_)?float", 33)])
def test_graphics_without_float_targets_draw_plain_colours(played, tmp_path, extensions, least):
    """Half floats are as good; bytes, in which each splat is rounded once, are a little coarser."""
    model, data = saved(random_model(np.random.default_rng(3), 200, "paper", "line", "radial", "sh2"), tmp_path / "model.safetensors")
    assert looked_at(played, [PageObject(model)], [data], around(model)[:2], before=without(extensions)) >= least


@pytest.mark.parametrize("kinds", [{"appearance": "clamp"}, {"colour_space": "linear"}], ids=["decoder", "linear"])
def test_graphics_without_float_targets_refuse_what_bytes_do_not_hold(played, tmp_path, kinds):
    model, data = saved(random_model(np.random.default_rng(3), 50, **kinds), tmp_path / "model.safetensors")
    tab = played(Page([PageObject(model)], around(model)[:1]), [data], before=without("buffer_(half_)?float"))
    assert "colours" in said(tab)


@IN_BOTH
@pytest.mark.parametrize("refusal", ["throw new DOMException('no', 'SecurityError')", "setTimeout(() => this.onerror(new Event('error')))"],
                         ids=["refused", "stopped"])
def test_a_browser_without_workers_gets_a_sentence(played, tmp_path, refusal):
    model, data = saved(random_model(np.random.default_rng(3), 50), tmp_path / "model.safetensors")
    tab = played(Page([PageObject(model)], around(model)[:1]), [data],
                 before=f"window.Worker = class {{ constructor() {{ {refusal}; }} postMessage() {{}} terminate() {{}} }};")
    assert "in the background" in said(tab)


def test_looks_crops_and_places_change_between_frames(played, tmp_path):
    """Frames far apart in looks: between them pages go straight from one to the next."""
    model, data = saved(random_model(np.random.default_rng(8), 300, "paper", "line", "radial", "sh1"), tmp_path / "model.safetensors")
    frames = 5

    def at(frame):
        angle = 0.2 * frame
        place, crop = np.eye(4), np.diag([1.0, 2, 2, 1])
        place[:2, :2], place[0, 3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]], 0.1 * frame
        crop[0, 3] = 0.15 * frame - 0.3
        return place, fg.ObjectSettings(tint=(1 - 0.2 * frame, 1, 0.2 + 0.2 * frame), saturation=0.5 + 0.2 * frame,
                                        opacity=1 - 0.15 * frame, splat_scale=0.6 + 0.2 * frame, crops=(fg.Crop(crop, soft=0.3),))

    whole = Page([PageObject(model, [at(k)[0] for k in range(frames)], (), [at(k)[1] for k in range(frames)])], around(model)[:1],
                 frames=frames, background=BACKGROUND)
    tab = played(whole, [data])
    for frame in (2, 2.5, 0.3, 3.7):
        place, look = at(frame)
        still = Page([PageObject(model, (place,), (), (look,))], whole.cameras, frames=frames, background=BACKGROUND)
        for camera in around(model)[1:3]:
            assert decibels(shown(tab, camera, frame), expected(still, camera, frame)) >= LEAST, frame


KINDS = list(zip(BASES, [*BASES][::-1], [*TEMPORALS] * 2, APPEARANCES)) + [
    ("paper", "line", "radial", look) for look in APPEARANCES[len(BASES):]]


@IN_BOTH
@pytest.mark.parametrize("kinds", KINDS, ids="-".join)
def test_every_kind_of_model(played, tmp_path, kinds):
    basis, turns, temporal, look = kinds
    model, data = saved(random_model(np.random.default_rng(5), 200, basis, turns, temporal, look), tmp_path / "model.safetensors")
    assert looked_at(played, [PageObject(model)], [data], around(model)[3:]) >= LEAST


@pytest.mark.parametrize("fields", [{"colour_space": "linear"}, {"raster": fg.Raster(antialiased=True, blur=0.1)}],
                         ids=["linear", "antialiased"])
def test_every_way_of_blending(played, tmp_path, fields):
    model, data = saved(random_model(np.random.default_rng(5), 200, "paper", size=0.03, **fields), tmp_path / "model.safetensors")
    assert looked_at(played, [PageObject(model)], [data], around(model)[2:]) >= LEAST

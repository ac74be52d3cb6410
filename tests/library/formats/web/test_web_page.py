# SPDX-License-Identifier: GPL-3.0-or-later
"""Web pages as text: one file that asks for nothing, holds its models, and says what it loses."""
from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.cameras.viewpoints import viewpoint_of
from fastgs_blender.formats import rate, sensitivity, web
from fastgs_blender.formats.web.page import Page, PageObject
from fastgs_blender.formats.web.poster import poster, shown
from fastgs_blender.rendering.colour import linear_to_srgb

pytestmark = pytest.mark.filterwarnings("ignore::fastgs_blender.LossWarning")
CAMERA = fg.Camera(96, 64, 90.0, 90.0, 48.0, 32.0, fg.look_at((0, -5, 0), (0, 0, 0)))


@pytest.fixture(autouse=True)
def few_small_pictures(monkeypatch):
    for module, name, value in ((sensitivity, "WIDTH", 64), (rate, "SHOTS", 8), (rate, "JUDGED", 3), (rate, "SHOWN", 64)):
        monkeypatch.setattr(module, name, value)


@pytest.fixture
def model(rng, make_model):
    return make_model(rng, 120, axes="RFU", clip=fg.Clip(12, 24.0), surroundings=fg.Surroundings(view=viewpoint_of(CAMERA)))


@pytest.fixture
def packed(model, tmp_path):
    fg.save(model, tmp_path / "packed.safetensors", compress="fine")
    return tmp_path / "packed.safetensors"


def blocks(text):
    """Script id -> its text."""
    return dict(re.findall(r'<script type="[a-z/]+" id="([\w-]+)">(.*?)</script>', text, re.DOTALL))


def read(path):
    """(text, description, bytes of the parts by name) of a page."""
    text = path.read_text("utf-8")
    found = blocks(text)
    description = json.loads(found["scene"])
    return text, description, {name: base64.b64decode(found[name]) for name in description["parts"]}


@pytest.mark.slow
def test_a_saved_page_holds_the_model_and_its_opening_view(model, tmp_path):
    fg.save(model, tmp_path / "x.html")
    text, description, parts = read(tmp_path / "x.html")
    (tmp_path / "inside.safetensors").write_bytes(parts["model-0"])
    inside = fg.load(tmp_path / "inside.safetensors")
    assert 100 <= len(inside) <= 120 and inside.clip == model.clip
    assert (description["frames"], description["fps"], description["up"]) == (12, 24, [0, 0, 1])
    (eye,) = description["opening"]["cameras"]
    assert (eye["width"], eye["fx"]) == (96, 90) and np.reshape(eye["pose"], (4, 4))[:3, 3] == pytest.approx([0, -5, 0])
    assert f"<title>{description['title']}</title>" in text


def test_the_policy_lets_in_the_pages_own_script_and_style_alone(model, tmp_path):
    fg.save(model, tmp_path / "x.html")
    text = (tmp_path / "x.html").read_text("utf-8")
    policy, text = re.search(r'(?s)http-equiv="Content-Security-Policy" content="([^"]+)"(.*)', text).groups()
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    for name, block in (("script-src", r'<script type="module"[^>]*>(.*?)</script>'), ("style-src", r"<style>(.*?)</style>")):
        part = re.search(block, text, re.DOTALL)[1]
        assert rules[name] == f"'sha256-{base64.b64encode(hashlib.sha256(part.encode()).digest()).decode()}'"
    assert rules["default-src"] == "'none'" and "connect-src" not in rules and not re.search(r"https?:|\*", policy)
    assert not re.search(r'(?:src|href)="(?!data:|#)', text.partition("<script")[0])


def test_texts_in_a_page_cannot_end_its_blocks(model, packed, tmp_path):
    title = '</script><script>alert("1")</script> & <b>'
    web.save_page(web.page_of(model, title=title), tmp_path / "x.html", packed={model: packed.read_bytes()})
    text, description, _ = read(tmp_path / "x.html")
    assert description["title"] == title and "<script>alert" not in text and "<b>" not in text


def test_the_poster_is_the_opening_picture_over_the_background(model, tmp_path):
    page = Page([PageObject(model)], [CAMERA], frames=12, background=(0.2, 0.4, 0.1))
    (tmp_path / "poster.png").write_bytes(poster(page))
    pixels = np.asarray(Image.open(tmp_path / "poster.png"), float) / 255
    image = fg.render(model, CAMERA, 0.0)
    rgb, alpha = np.float64(image["rgb"]), np.float64(image["alpha"])[..., None]
    straight = np.divide(rgb, alpha, out=np.zeros_like(rgb), where=alpha > 0)
    linear = np.where(straight <= 0.04045, straight / 12.92, ((straight + 0.055) / 1.055) ** 2.4) * alpha + (1 - alpha) * (0.2, 0.4, 0.1)
    wanted = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    assert pixels.shape == (64, 96, 3) and np.abs(pixels - np.clip(wanted, 0, 1)).max() < 0.51 / 255 + 1e-4


def test_the_background_is_behind_a_model_of_premultiplied_features(rng):
    """Spacetime Gaussians light a picture even where they hardly are, if nothing is put behind it."""
    model, background = random_model(rng, 60, appearance="stg", size=0.1), np.array([0.2, 0.4, 0.1])
    picture = shown(Page([PageObject(model)], [CAMERA], background=background), 0, CAMERA)
    alpha = fg.render(model, CAMERA, 0.0)["alpha"]
    faint = (alpha > 0) & (alpha < 0.02)
    assert faint.sum() > 50
    assert np.abs(picture[faint] - linear_to_srgb(background)).max() < 0.05


def test_a_crop_a_look_and_hidden_gaussians_reach_the_page(model):
    crop = fg.Crop(np.diag([2.0, 1, 1, 1]), remove=True, shape="SPHERE", soft=0.5)
    looks = [fg.ObjectSettings(crops=(crop,), exposure=value, density=0.5) for value in (0.0, 1.0)]
    page = Page([PageObject(model, settings=looks, times=(0.1, 0.4)), PageObject(model)], [CAMERA], frames=2)
    shown = page.description()["objects"][0]
    assert shown["times"] == [0.1, 0.4] and len(shown["looks"]) == 2 and shown["looks"][1][10] == pytest.approx(2 * shown["looks"][0][10])
    assert shown["crops"] == [[{"matrix": np.diag([2.0, 1, 1, 1]).ravel().tolist(), "remove": True, "soft": 0.5, "shape": "SPHERE"}]]
    assert [len(each) for each in page.models.values()] == [60, 120]


def test_a_page_over_its_limit_is_not_written_and_the_sentence_says_what_to_do(model, packed, tmp_path, monkeypatch):
    kept = {model: packed.read_bytes()}
    with pytest.raises(fg.FastGSError, match=r"x\.html .* MB.*0\.01 MB.*compress"):
        web.save_page(web.page_of(model), tmp_path / "x.html", limit=0.01, packed=kept)
    assert not (tmp_path / "x.html").exists()
    monkeypatch.setattr(web, "LARGE", 0.01)
    with pytest.warns(fg.LossWarning, match="phones"):
        web.save_page(web.page_of(model), tmp_path / "x.html", packed=kept)
    with pytest.warns(fg.LossWarning, match="phones"):
        fg.save(model, tmp_path / "y.html")


def test_a_model_that_a_page_cannot_play_is_refused(model, tmp_path, monkeypatch):
    monkeypatch.setattr(web, "cannot_play", lambda model: "a web page plays no such thing.")
    with pytest.raises(fg.FastGSError, match="x.html.*web page"):
        fg.save(model, tmp_path / "x.html")


def test_numbers_that_are_none_are_a_sentence(model):
    page = Page([PageObject(model, places=[np.eye(4)])], [CAMERA], background=(np.nan, 0, 0))
    with pytest.raises(fg.FastGSError, match="no numbers"):
        page.description()


def test_convert_takes_a_compressed_file_as_it_is_and_its_options_reach_the_page(run, packed, tmp_path):
    (tmp_path / "tone.mp3").write_bytes(b"sound")
    fg.save_cameras([replace(CAMERA, cx=48 + frame) for frame in range(12)], tmp_path / "path.json")
    code, out, _ = run("convert", packed, tmp_path / "x.html", "--title", "Kitchen", "--sound", tmp_path / "tone.mp3",
                       "--background", "#ffffff", "--camera", tmp_path / "path.json", "--once")
    assert code == 0 and "x.html: " in out
    _, description, parts = read(tmp_path / "x.html")
    assert parts == {"model-0": packed.read_bytes(), "sound": b"sound"}
    assert (description["title"], description["loop"], description["background"]) == ("Kitchen", False, [1, 1, 1])
    assert [eye["cx"] for eye in description["opening"]["cameras"]] == [48 + frame for frame in range(12)]
    assert description["sound"] == {"type": "audio/mpeg", "start": 0}


@pytest.mark.parametrize(("target", "options", "words"), [
    ("x.ply", ["--title", "A"], "--title is for web pages"), ("x.html", ["--view", "a"], "--camera"),
    ("x.html", ["--limit", "0"], "--limit"), ("x.html", ["--limit", "0.01"], "limit is 0.01 MB"),
    ("x.html", ["--background", "own"], "name a colour"),
    ("x.html", ["--sound", "notes.txt"], "do not play")])
def test_options_that_do_not_fit_are_sentences(run, packed, tmp_path, target, options, words):
    code, _, told = run("convert", packed, tmp_path / target, *options)
    assert code == 2 and words in " ".join(told.split()) and not (tmp_path / target).exists()

# SPDX-License-Identifier: GPL-3.0-or-later
"""A subject before a plain background is cut out as if its pictures had alpha."""
from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from toy_captures import MemoryStore, toy_cameras, toy_capture, toy_scene, write_shots

import fastgs_blender as fg
from fastgs_blender.captures import open_capture
from fastgs_blender.captures.pixels import plain
from fastgs_blender.captures.pixels.store import FrameStore, Pixels
from fastgs_blender.evaluation.training_record import record, recorded
from fastgs_blender.training.core.settings import settings
from fastgs_blender.training.core.trainer import Trainer
from fastgs_blender.training.initial.start import start

WIDTH, HEIGHT = 64, 48
COLOURS = {"black": (0, 0, 0), "white": (255, 255, 255), "green": (0, 177, 64)}


def disc(x: float, y: float, radius: float, hole: float = 0.0) -> np.ndarray:
    """The share of each pixel [h, w] that a disc covers, with a hole in its middle."""
    fine = 8
    columns, rows = (np.arange(fine * n)[None if k else slice(None)] / fine for k, n in ((0, HEIGHT), (1, WIDTH)))
    away = np.hypot(rows.reshape(1, -1) + 0.5 / fine - x, columns.reshape(-1, 1) + 0.5 / fine - y)
    covered = (away < radius) & (away >= hole)
    return covered.reshape(HEIGHT, fine, WIDTH, fine).mean((1, 3)).astype(np.float32)


def over(alpha: np.ndarray, colour: tuple, first: int = 90) -> np.ndarray:
    """A reddish subject of that alpha, which gets brighter to the right, before a colour, as a picture [h, w, 3] in 255ths."""
    red = np.linspace(first, first + 60, WIDTH)[None, :, None].repeat(HEIGHT, 0)
    subject = np.concatenate([red, red / 3 + 20, 0 * red + 30], -1)
    return np.uint8(alpha[..., None] * subject + (1 - alpha)[..., None] * np.array(colour) + 0.5)


def found(pictures: list[np.ndarray]) -> plain.Plain | None:
    return plain.background([picture / np.float32(255) for picture in pictures], [None] * len(pictures))


@pytest.mark.parametrize("colour", COLOURS.values(), ids=COLOURS)
def test_a_plain_background_is_found_and_alpha_is_that_of_the_subject(colour):
    alphas = [disc(20 + 6 * k, 22, 12) for k in range(4)]
    pictures = [over(alpha, colour) for alpha in alphas]
    background = found(pictures)
    assert background is not None
    np.testing.assert_allclose(background.colour * 255, colour)
    for picture, alpha in zip(pictures, alphas):
        straight, share = background.cut_out(picture / np.float32(255))
        assert np.abs(share - alpha).max() < 0.2
        assert np.abs(share - alpha).mean() < 0.003
        assert background.tells(straight, share).all()


@given(st.integers(0, 2**32 - 1), st.sampled_from(list(COLOURS.values())))
def test_what_is_cut_out_shows_the_picture_again_before_its_background(seed, colour):
    rng = np.random.default_rng(seed)
    image = np.where(rng.random((HEIGHT, WIDTH, 1)) < 0.4, rng.random((HEIGHT, WIDTH, 3)), np.array(colour) / 255).astype(np.float32)
    straight, share = plain.Plain(np.array(colour, np.float32) / 255, plain.LEAST).cut_out(image)
    again = share[..., None] * straight + (1 - share)[..., None] * np.array(colour) / 255
    within = (straight > 0).all(-1) & (straight < 1).all(-1) & (share > 0)  # no colour had to be cut at 0 or 1
    np.testing.assert_allclose(again[within], image[within], atol=1e-4)


def test_a_hole_is_unknown_and_so_is_what_lies_beside_it():
    alpha = disc(32, 24, 16, hole=6)
    picture = over(alpha, (255, 255, 255)) / np.float32(255)
    background = found([np.uint8(picture * 255), over(disc(20, 20, 9), (255, 255, 255))])
    assert background is not None
    straight, share = background.cut_out(picture)
    tells = background.tells(straight, share)
    hole = disc(32, 24, 6) > 0
    assert not tells[hole].any()
    assert tells[disc(32, 24, 9) == 0].all()


@pytest.mark.parametrize("case", ["a place", "a frame", "all empty", "two colours"])
def test_other_pictures_have_no_plain_background(case, rng):
    if case == "a place":
        pictures = [np.uint8(rng.integers(0, 255, (HEIGHT, WIDTH, 3))) for _ in range(4)]
    elif case == "a frame":  # that a lens or an editor left
        pictures = [over(disc(32, 24, 23), (0, 0, 0), 60 + 40 * k) for k in range(4)]
    elif case == "all empty":
        pictures = [over(disc(0, 0, 0), (0, 0, 0))] * 4
    else:
        pictures = [over(disc(20 + 6 * k, 22, 12), (255 * (k % 2),) * 3) for k in range(4)]
    assert found(pictures) is None


def test_noise_of_a_codec_does_not_hide_it(rng):
    pictures = [over(disc(20 + 6 * k, 22, 12), (250, 250, 250)) for k in range(4)]
    noisy = [np.uint8(np.clip(picture + rng.integers(-3, 4, picture.shape), 0, 255)) for picture in pictures]
    background = found(noisy)
    assert background is not None
    share = background.cut_out(noisy[0] / np.float32(255))[1]
    assert (share[disc(20, 22, 14) == 0] < 0.5).all()
    assert (share[disc(20, 22, 10) == 1] == 1).all()


@pytest.fixture(params=["plain", "alpha", "masks"])
def filmed(request, tmp_path):
    """(kind, capture, the truth of alpha by view): a disc before white, in pictures without alpha, with it, and with mask files besides."""
    truth, cameras = {}, []
    for k, camera in enumerate(toy_cameras(4)):
        view, alpha = f"cam{k:02}", disc(16 + 6 * k, 18, 9)[:36, :48]
        truth[view] = alpha
        picture = over(disc(16 + 6 * k, 18, 9), (255, 255, 255))[:36, :48]
        if request.param == "alpha":
            picture = np.concatenate([picture, np.uint8(alpha * 255 + 0.5)[..., None]], -1)
        for folder, image in ((view, picture), *([(f"masks/{view}", np.uint8(alpha > 0.5) * 255)] if request.param == "masks" else [])):
            (tmp_path / folder).mkdir(parents=True)
            Image.fromarray(image).save(tmp_path / folder / "0001.png")
        cameras.append({"name": view, "width": 48, "height": 36, "fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy,
                        "world_to_camera": camera.world_to_camera.tolist()})
    (tmp_path / "cameras.json").write_text(json.dumps({"format": "fast-gs capture", "version": 1, "fps": 24, "start_frame": 1,
                                                       "frame_count": 1, "axes": "RDF", "cameras": cameras}))
    return request.param, open_capture(tmp_path), truth


def test_the_store_gives_pixels_as_if_they_had_alpha(filmed, cache):
    kind, capture, truth = filmed
    store = FrameStore(capture, folder=cache)
    assert (store.plain is None) == (kind == "alpha")
    for shot in capture.shots:
        pixels, alpha = store.pixels(shot), truth[shot.view]
        share = pixels.alpha if kind == "masks" else pixels.mask
        assert np.abs(share - alpha).mean() < 0.01
        if kind == "masks":
            np.testing.assert_allclose(pixels.mask, share * (alpha > 0.5), atol=0.01)
        if kind != "alpha":
            assert pixels.valid.all()
            assert pixels.stored is None


def test_damaged_pictures_do_not_hide_the_background_and_are_told_when_asked_for(filmed, cache):
    kind, capture, _ = filmed
    for shot in capture.shots[:1]:
        shot.image.path.write_bytes(shot.image.path.read_bytes()[:120])
    assert (FrameStore(capture, folder=cache).plain is None) == (kind == "alpha")
    for shot in capture.shots[1:]:
        shot.image.path.write_bytes(shot.image.path.read_bytes()[:120])
    store = FrameStore(capture, folder=cache / "all")
    assert store.plain is None
    with pytest.raises(fg.FastGSError, match="0001.png"):
        store.pixels(capture.shots[0])


def test_a_whole_picture_stays_as_it_is(filmed, cache):
    kind, capture, _ = filmed
    store = FrameStore(capture, folder=cache, whole=True)
    assert store.plain is None
    for shot in capture.shots:
        pixels = store.pixels(shot)
        assert (pixels.mask is None) == (kind == "plain")
        assert pixels.alpha is None
        np.testing.assert_array_equal(pixels.stored, np.asarray(Image.open(shot.image.path))[..., :3])


@pytest.fixture(scope="module", params=COLOURS.values(), ids=COLOURS)
def figure(request, tmp_path_factory):
    """A capture of a figure that waves, from five sides, before a colour: opaque spots, in pictures without alpha."""
    capture, _, _ = toy_capture(4, 5)
    model = toy_scene(4)
    moving = model.take(slice(60, None))
    moving = replace(moving, opacity=np.full_like(moving.opacity, 9), scale=moving.scale + 0.4)
    store = MemoryStore(moving, capture.shots)
    for shot in capture.shots:
        image = fg.render(moving, shot.camera, shot.t)
        alpha = np.clip(3 * image["alpha"][..., None] - 1, 0, 1)  # a sharper outline than Gaussians have
        colours = image["rgb"] / np.maximum(image["alpha"], 1e-6)[..., None]
        rgb = np.clip(alpha * colours + (1 - alpha) * np.array(request.param) / 255, 0, 1)
        store.pictures[shot.view, shot.frame] = Pixels(rgb.astype(np.float32))
    folder = tmp_path_factory.mktemp("figure")
    write_shots(folder, capture, store)
    return open_capture(folder)


def test_training_begins_within_the_outlines_and_leaves_the_background_away(figure, cache):
    chosen = settings(iterations=400, init_points=60, max_gaussians=400, densify_every=20, preview_every=0)
    store = FrameStore(figure, folder=cache)
    first = start(figure, store, chosen)
    away = np.linalg.norm(first.model.position, axis=1)
    assert np.median(away) < 1
    assert away.max() < 3  # cameras stand at 4, and there is no backdrop
    trainer = Trainer(figure, store, chosen, first)
    while trainer.iteration < chosen.iterations:
        trainer.step()
    for shot in figure.training[::3]:
        alpha, truth = fg.render(trainer.final_model({}), shot.camera, shot.t, ("alpha",))["alpha"], store.pixels(shot).mask
        assert alpha[truth == 0].mean() < 0.05
        assert alpha[truth == 1].mean() > 0.8


def test_the_check_says_so_and_calls_nothing_dark_or_burnt(figure):
    report = fg.check(figure.path)
    (section,) = [section for name, section in report.sections.items() if "brightness" in section.measures]
    assert ["--masks" in finding.advice for finding in section.findings].count(True) == 1
    assert not {"median brightness", "burnt share"} & {finding.figure[0] for finding in section.findings if finding.figure}


@pytest.mark.parametrize("whole", [True, False])
def test_a_model_says_whether_it_shows_the_background(figure, whole):
    known = recorded(replace(toy_scene(), provenance=record(figure, whole)))
    assert known is not None
    assert known.whole == whole

# SPDX-License-Identifier: GPL-3.0-or-later
"""fastgs eval: what it measures is what the files show, on tiny captures as FAST-GS captures."""
from __future__ import annotations

import csv
import json
import sys
import types
import weakref
from dataclasses import replace

import av
import numpy as np
import pytest
import torch
from PIL import Image
from toy_captures import SIZE, MemoryStore, toy_cameras, toy_capture, toy_scene, write_capture

import fastgs_blender as fg
from fastgs_blender import cli
from fastgs_blender.evaluation import metrics
from fastgs_blender.evaluation.evaluate import evaluate
from fastgs_blender.evaluation.perceptual import Lpips, Unavailable
from fastgs_blender.evaluation.pictures import HEAT, HEAT_TOP, heat
from fastgs_blender.rendering import colour

FRAMES = 4


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("FASTGS_CACHE_DIR", str(tmp_path / "cache"))


@pytest.fixture
def truth() -> fg.GaussianModel:
    return toy_scene(FRAMES)


@pytest.fixture
def model(truth) -> fg.GaussianModel:
    """The truth, a little off."""
    return replace(truth, position=truth.position + np.float32([0.05, 0, 0]))


@pytest.fixture
def work(tmp_path, model):
    """A folder with the capture `cap` of the truth (views cam00 to cam02, the first held out) and the model m.safetensors."""
    (tmp_path / "cap").mkdir()
    write_capture(tmp_path / "cap", FRAMES, 3)
    fg.save(model, tmp_path / "m.safetensors")
    return tmp_path


@pytest.fixture
def run(work, capsys):
    """run(*arguments): (exit code, output, errors) of fastgs eval with the model and the capture; results go to work/out."""

    def run(*arguments, model="m.safetensors", out="out"):
        where = ("--out", work / out) if out else ()
        code = cli.main(["eval", *map(str, (work / model, work / "cap", *where, *arguments))])
        return code, *capsys.readouterr()

    return run


def change_description(work, **values):
    path = work / "cap" / "cameras.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | values))


def grey(picture) -> np.ndarray:
    """Brightness [h, w, 1]: films hold colour at half the resolution."""
    return (picture * [0.2126, 0.7152, 0.0722]).sum(-1, keepdims=True)


def picture_of(work, view, frame) -> np.ndarray:
    return np.asarray(Image.open(work / "cap" / view / f"{frame + 1:04d}.png"), np.float64) / 255


def test_measures_are_those_of_the_files(run, work, model):
    code, out, err = run("--json")
    assert code == 0, err
    result = json.loads(out)
    camera = toy_cameras(3)[0]
    before = None
    for row, frame in zip(result["rows"], range(FRAMES), strict=True):
        seen, wanted = fg.render(model, camera, frame / FRAMES)["rgb"], picture_of(work, "cam00", frame)
        assert (row["view"], row["frame"], row["t"]) == ("cam00", frame, frame / FRAMES)
        assert row["psnr"] == pytest.approx(-10 * np.log10(np.mean((np.clip(seen, 0, 1) - wanted) ** 2)), abs=1e-4)
        assert row["dssim1"] == pytest.approx(metrics.dssim1(seen, wanted), abs=1e-7)
        assert row["dssim2"] == pytest.approx(metrics.dssim2(seen, wanted), abs=1e-7)
        assert row["psnr_foreground"] is None and row["milliseconds"] > 0
        if before:
            assert row["flicker"] == pytest.approx(np.abs((seen - before[0]) - (wanted - before[1])).mean(), abs=1e-6)
        else:
            assert row["flicker"] is None
        before = seen, wanted
    assert 15 < result["average"]["psnr"] < 40
    for name in ("psnr", "dssim1", "dssim2"):
        assert result["average"][name] == pytest.approx(np.mean([row[name] for row in result["rows"]]))
    assert result["average"]["flicker"] == pytest.approx(np.mean([row["flicker"] for row in result["rows"][1:]]))
    assert result["gaussians"] == 80 and result["fps"] > 0 and result["held_out"] is None, "the file does not say what it was trained on"
    assert result["file_bytes"] == (work / "m.safetensors").stat().st_size
    assert (result["width"], result["height"]) == SIZE


def test_the_files_hold_what_the_terminal_shows(run, work):
    code, out, err = run()
    assert code == 0 and "%" in err, "a progress bar"
    result = json.loads((work / "out" / "evaluation.json").read_text())
    lines = out.splitlines()
    assert lines[0].split() == ["view", "frame", "PSNR", "dB", "DSSIM1", "DSSIM1", "sk", "DSSIM2", "FLIP", "flicker"]
    assert [line.split()[:3] for line in lines[1:1 + FRAMES]] == [["cam00", str(r["frame"]), f"{r['psnr']:.2f}"] for r in result["rows"]]
    assert f"{result['average']['psnr']:.2f}" in lines[FRAMES + 2]
    assert "80 Gaussians" in out and "frames per second" in out and "evaluation.csv, 4 pictures, 1 film" in out
    rows = list(csv.DictReader((work / "out" / "evaluation.csv").open(encoding="utf-8")))
    assert [row["frame"] for row in rows] == ["0", "1", "2", "3", "mean", "mean"]
    for row, values in zip(rows, [*result["rows"], result["views"]["cam00"], result["average"]], strict=True):
        for name in ("psnr", "dssim1", "dssim2", "flicker", "psnr_foreground"):
            assert row[name] == ("" if values[name] is None else str(values[name]))
    assert "LPIPS" in err and "not measured" in err


def test_pictures_and_film(run, work, model):
    assert run("--images", "2", "--quiet")[0] == 0
    sheets = sorted(path.name for path in (work / "out").glob("*.png"))
    assert sheets == ["cam00-0000.png", "cam00-0003.png"]
    width, height = SIZE
    sheet = np.asarray(Image.open(work / "out" / "cam00-0003.png").convert("RGB"), np.float64) / 255
    top = 20
    panels = [sheet[top:top + height, left:left + width] for left in (0, width + 4, 2 * (width + 4))]
    wanted, seen = picture_of(work, "cam00", 3), np.clip(fg.render(model, toy_cameras(3)[0], 3 / FRAMES)["rgb"], 0, 1)
    np.testing.assert_allclose(panels[0], wanted, atol=0.51 / 255)
    np.testing.assert_allclose(panels[1], seen, atol=0.51 / 255)
    np.testing.assert_allclose(panels[2], heat(np.abs(seen - wanted).mean(-1)), atol=0.51 / 255)
    with av.open(str(work / "out" / "cam00.mp4")) as film:
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
        assert film.streams.video[0].average_rate == 24
    assert len(frames) == FRAMES
    left, right, wanted, seen = (grey(v) for v in (frames[3][top:top + height, :width] / 255,
                                                   frames[3][top:top + height, width + 4:2 * width + 4] / 255, wanted, seen))
    assert metrics.psnr(left, wanted) > max(35, metrics.psnr(left, seen) + 2)
    assert metrics.psnr(right, seen) > max(35, metrics.psnr(right, wanted) + 2)


def test_heat_has_its_scale():
    np.testing.assert_allclose(heat(np.array([[0, HEAT_TOP, 9.0]])), [[HEAT[0], HEAT[-1], HEAT[-1]]])
    brightness = heat(np.linspace(0, HEAT_TOP, 50)[None]).sum(-1)[0]
    assert (np.diff(brightness) > 0).all()


def test_a_model_that_is_the_truth_is_found_to_be(run, work, truth):
    fg.save(truth, work / "truth.safetensors")
    code, out, _ = run("--json", model="truth.safetensors")
    average = json.loads(out)["average"]
    assert code == 0
    assert average["psnr"] > 55 and average["dssim1"] < 1e-3 and average["dssim2"] < 1e-3 and average["flicker"] < 2e-3


def test_views_and_frames(run, work):
    result = json.loads(run("--views", "cam02,cam01", "--frames", "1:3:2", "--json")[1])
    assert [(row["view"], row["frame"]) for row in result["rows"]] == [("cam01", 1), ("cam01", 3), ("cam02", 1), ("cam02", 3)]
    assert result["held_out"] is None
    assert result["average"]["flicker"] is None, "frames that do not follow each other say nothing of flicker"
    assert set(result["views"]) == {"cam01", "cam02"}
    table = run("--views", "all", "--frames", "0", "--quiet")[1].splitlines()
    assert [line.split()[0] for line in table[5:9]] == ["cam00", "cam01", "cam02", "all"]


def test_nothing_held_out(run, work):
    change_description(work, held_out=[])
    code, _, err = run()
    assert code == 2 and "--views" in err and "cam01" in err and len(err.splitlines()) == 1
    assert run("--views", "cam01")[0] == 0


@pytest.mark.parametrize(("arguments", "words"), [
    (("--views", "cam07"), "no view 'cam07'; there are cam00, cam01, cam02"), (("--frames", "9"), "the frames 0 to 3"),
    (("--frames", "0.5"), "whole frames only"), (("--views", ","), "names no view"), (("--scale", "7"), "scale"),
])
def test_what_cannot_be_evaluated(run, arguments, words):
    code, out, err = run(*arguments, "--quiet")
    assert code == 2 and out == "" and words in err and len(err.splitlines()) == 1


def test_a_damaged_picture_is_left_out_with_a_line(run, work):
    (work / "cap" / "cam00" / "0003.png").write_bytes(b"nonsense")
    code, out, err = run("--json")
    assert code == 0 and "left out: 1 of" in err
    assert [row["frame"] for row in json.loads(out)["rows"]] == [0, 1, 3], "frame 2 is the picture 0003.png"


def test_the_folder_of_a_training_run(run, work, model):
    folder = work / "trained"
    folder.mkdir()
    code, _, err = run(model="trained", out=None)
    assert code == 2 and "no model.safetensors" in err
    fg.save(model, folder / "model.safetensors")
    assert run("--images", "0", "--quiet", model="trained", out=None)[0] == 0
    assert (folder / "evaluation" / "evaluation.csv").is_file() and not list((folder / "evaluation").glob("*.png"))
    assert run("--images", "0", "--quiet", out=None)[0] == 0
    assert (work / "m-evaluation" / "evaluation.json").is_file()


def test_masks_of_the_foreground(run, work, model):
    masks = []
    for frame in range(FRAMES):
        mask = np.zeros((SIZE[1], SIZE[0]), np.uint8)
        mask[10 + frame:25, 12:30] = 255
        for view in ("cam00", "cam01", "cam02"):
            path = work / "cap" / "masks" / view / f"{frame + 1:04d}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(mask).save(path)
        masks.append(mask > 0)
    bare = json.loads(run("--json", "--quiet")[1])
    for row, mask in zip(bare["rows"], masks, strict=True):
        seen, wanted = fg.render(model, toy_cameras(3)[0], row["t"])["rgb"], picture_of(work, "cam00", row["frame"])
        assert row["psnr_foreground"] == pytest.approx(-10 * np.log10(np.mean((np.clip(seen, 0, 1) - wanted)[mask] ** 2)), abs=1e-3)
        assert row["psnr"] == pytest.approx(metrics.psnr(seen, wanted), abs=1e-4), "the whole picture counts"
    change_description(work, masks="valid")
    for row in json.loads(run("--json", "--quiet")[1])["rows"]:
        assert row["psnr_foreground"] is None
        assert row["psnr"] == pytest.approx(bare["rows"][row["frame"]]["psnr_foreground"], abs=1e-6), "what is not valid does not count"


def test_transparent_pictures_are_judged_over_black(run, work, truth):
    small = truth.take(slice(60, 80))
    for shot in toy_capture(FRAMES, 3)[0].shots:
        image = fg.render(small, shot.camera, shot.t)
        straight = np.clip(colour.straight(image["rgb"], image["alpha"]), 0, 1)
        straight[image["alpha"] == 0] = 1  # what a painter leaves where nothing is to be seen
        rgba = np.concatenate([straight, image["alpha"][..., None]], -1)
        Image.fromarray(np.uint8(np.round(rgba * 255))).save(work / "cap" / shot.view / f"{shot.frame + 1:04d}.png")
    fg.save(small, work / "small.safetensors")
    average = json.loads(run("--json", "--quiet", model="small.safetensors")[1])["average"]
    assert average["psnr"] > 50 and average["psnr_foreground"] > 45


def test_a_model_of_a_part_of_the_capture(truth):
    """Frames are matched by the numbers that model and capture give them."""
    capture, store, _ = toy_capture(8, 3)
    whole = toy_scene(8)
    part = replace(whole, clip=fg.Clip(3, 24.0, 1 + 4), basis=fg.Cosine(4, whole.basis.scale * 3 / 8, 4 / 8 * whole.basis.scale))
    result = evaluate(part, capture, store, lpips=False)
    assert [row["frame"] for row in result["rows"]] == [4, 5, 6]
    assert [row["t"] for row in result["rows"]] == pytest.approx([0, 1 / 3, 2 / 3])
    assert any("5 frames lie outside" in note for note in result["notes"])
    assert result["average"]["psnr"] is None or result["average"]["psnr"] > 100
    beyond = evaluate(part, capture, store, frames=[3, 7], lpips=False)
    assert [row["t"] for row in beyond["rows"]] == pytest.approx([-1 / 3, 1]), "frames that are asked for are measured beyond the clip too"
    with pytest.raises(fg.FastGSError, match="none.*frames"):
        evaluate(part, capture, store, frames=[8], lpips=False)
    every_second = replace(whole, clip=fg.Clip(4, 12.0, 1))
    assert [row["t"] for row in evaluate(every_second, capture, store, frames=[0, 2, 3], lpips=False)["rows"]] == [0, 0.25, 0.375]


def test_equal_frames_have_no_finite_psnr_and_the_average_says_so(truth):
    capture, store, _ = toy_capture(FRAMES, 3)
    for frame in range(2):
        key = "cam00", frame
        store.pictures[key] = replace(store.pictures[key], rgb=np.zeros_like(store.pictures[key].rgb))
    empty = truth.take(slice(0, 0))
    result = evaluate(empty, capture, store, lpips=False)
    assert [row["psnr"] is None for row in result["rows"]] == [True, True, False, False]
    assert result["average"]["psnr"] == pytest.approx(np.mean([row["psnr"] for row in result["rows"][2:]]))
    assert any("2 frames equal" in note for note in result["notes"])


def test_few_frames_are_in_memory(truth, tmp_path):
    """Of twelve frames never more than three pictures live at once, whatever is written."""
    frames = 12
    model = toy_scene(frames)
    capture, _, _ = toy_capture(frames, 1)
    alive: list[weakref.ref] = []
    most = 0

    class Store:
        def pixels(self, shot):
            nonlocal most
            most = max(most, sum(ref() is not None for ref in alive))
            pixels = MemoryStore(model, [shot]).pixels(shot)
            alive.append(weakref.ref(pixels.rgb))
            return pixels

    capture.shots[:] = [replace(shot, held_out=True) for shot in capture.shots]
    evaluate(model, capture, Store(), out=tmp_path / "out", lpips=False)
    assert len(alive) == frames and most <= 2


def test_captures_without_poses_are_refused(truth):
    capture, store, _ = toy_capture(FRAMES, 2)
    capture.shots[:] = [replace(shot, camera=None) for shot in capture.shots]
    with pytest.raises(fg.FastGSError, match="where.*cameras"):
        evaluate(truth, capture, store, lpips=False)


# ---- LPIPS -------------------------------------------------------------------------------------------------------------


@pytest.fixture
def lpips_package(tmp_path, monkeypatch):
    """Stand-ins for the packages lpips and torchvision, built as the real network is, and torch's cache without weights; gives torch."""
    nn = torch.nn

    class Network(nn.Module):
        def __init__(self, net, version, pretrained, pnet_rand, verbose):
            assert (net, version, pretrained, pnet_rand) == ("alex", "0.1", False, True), "anything else downloads, or unpickles"
            super().__init__()
            self.net = nn.Module()
            self.net.slice1 = nn.Sequential()
            self.net.slice1.add_module("0", nn.Conv2d(3, 2, 3))
            self.lin0 = nn.Module()
            self.lin0.model = nn.Sequential(nn.Dropout(), nn.Conv2d(2, 1, 1, bias=False))

        def forward(self, a, b, normalize=False):
            if normalize:
                a, b = 2 * a - 1, 2 * b - 1
            return self.lin0.model((self.net.slice1(a) - self.net.slice1(b)) ** 2).mean((2, 3), keepdim=True)

    package = types.ModuleType("lpips")
    package.__file__ = str(tmp_path / "lpips" / "__init__.py")
    package.LPIPS = Network
    monkeypatch.setitem(sys.modules, "lpips", package)
    monkeypatch.setitem(sys.modules, "torchvision", types.ModuleType("torchvision"))
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))
    linear = tmp_path / "lpips" / "weights" / "v0.1" / "alex.pth"
    linear.parent.mkdir(parents=True)
    torch.save({"lin0.model.1.weight": torch.tensor([0.5, 2.0]).reshape(1, 2, 1, 1)}, linear)
    (tmp_path / "hub" / "checkpoints").mkdir(parents=True)
    return torch


def save_trunk(torch, tmp_path):
    kernel = torch.zeros(2, 3, 3, 3)
    kernel[:, :, 1, 1] = torch.tensor([[1.0, 0, 0], [0, 1.0, 1.0]])
    state = {"features.0.weight": kernel, "features.0.bias": torch.zeros(2), "classifier.1.weight": torch.zeros(4, 4)}
    torch.save(state, tmp_path / "hub" / "checkpoints" / "alexnet-owt-7be5be79.pth")


def test_lpips_uses_the_weights_that_are_there(lpips_package, tmp_path, rng):
    with pytest.raises(Unavailable, match="weights.*alexnet-owt"):
        Lpips()
    save_trunk(lpips_package, tmp_path)
    picture, truth = rng.random((2, 70, 66, 3))
    r, gb = picture[..., 0] - truth[..., 0], picture[..., 1:].sum(-1) - truth[..., 1:].sum(-1)
    expected = (0.5 * r**2 + 2 * gb**2)[1:-1, 1:-1].mean()
    assert Lpips()(picture, truth) == pytest.approx((expected, 4 * expected), rel=1e-4)
    assert Lpips()(picture[:40], truth[:40]) == (None, None)


def test_damaged_weights_and_absent_packages_are_told(lpips_package, tmp_path, monkeypatch):
    save_trunk(lpips_package, tmp_path)
    (tmp_path / "hub" / "checkpoints" / "alexnet-owt-7be5be79.pth").write_bytes(b"cut short")
    with pytest.raises(Unavailable, match="damaged"):
        Lpips()
    lpips_package.save({"features.0.bias": lpips_package.zeros(2)}, tmp_path / "hub" / "checkpoints" / "alexnet-owt-7be5be79.pth")
    with pytest.raises(Unavailable, match=r"lacks 0\.weight"):
        Lpips()
    monkeypatch.setitem(sys.modules, "lpips", None)
    with pytest.raises(Unavailable, match="lpips.*installed"):
        Lpips()


def test_lpips_in_the_report(lpips_package, tmp_path, truth):
    save_trunk(lpips_package, tmp_path)
    capture, _, _ = toy_capture(2, 1)
    shots = [replace(shot, held_out=True, camera=replace(shot.camera, width=96, height=72, fx=90, fy=90, cx=48, cy=36, window=None))
             for shot in capture.shots]
    result = evaluate(truth, replace(capture, shots=shots), MemoryStore(toy_scene(2), shots))
    assert result["average"]["lpips_normalised"] == pytest.approx(4 * result["average"]["lpips"], rel=1e-3)
    assert not any("LPIPS" in note for note in result["notes"])


@pytest.mark.parametrize("arguments", [("--views", "cam09"), ("--frames", "99"), ("--layout", "none"), ("--backend", "none")])
def test_a_wrong_name_leaves_no_folder(run, work, arguments):
    assert run(*arguments)[0] == 2 and not (work / "out").exists()
    assert run(model="missing.safetensors")[0] == 2 and not (work / "out").exists()

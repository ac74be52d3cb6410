# SPDX-License-Identifier: GPL-3.0-or-later
"""fastgs render: the right pictures under the right names, and nothing lost when it is stopped."""
from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from held_runs import GUARD, until
from PIL import Image

import fastgs_blender as fg
from fastgs_blender import cli
from fastgs_blender.cameras.viewpoints import viewpoint_of
from fastgs_blender.model.surroundings import Surroundings
from fastgs_blender.rendering import api as rendering
from fastgs_blender.rendering import colour, passes
from fastgs_blender.rendering.cryptomatte import bits_of
from fastgs_blender.rendering.exposure import Aperture, Exposure

ROOT = Path(__file__).resolve().parents[3]
FRAMES = 10


def camera_entry(name="front", x=0.0, **fields) -> dict:
    return {"id": 0, "img_name": name, "width": 24, "height": 16, "position": [x, 0, -4], "rotation": np.eye(3).tolist(),
            "fx": 20.0, "fy": 20.0} | fields


@pytest.fixture
def model(rng, make_model):
    return make_model(rng, 12, basis=fg.Fourier(2), clip=fg.Clip(FRAMES, 25.0))


@pytest.fixture
def work(model, tmp_path):
    """A folder with m.safetensors and cameras.json (one camera)."""
    fg.save(model, tmp_path / "m.safetensors")
    (tmp_path / "cameras.json").write_text(json.dumps([camera_entry()]))
    return tmp_path


@pytest.fixture
def run(work, capsys):
    """run(*arguments): (exit code, output, errors) of fastgs render in the folder `work`; frames go to work/out."""

    def run(*arguments):
        code = cli.main(["render", str(work / "m.safetensors"), "--camera", str(work / "cameras.json"), "--out", str(work / "out"),
                         "--backend", "reference", *map(str, arguments)])
        return code, *capsys.readouterr()

    return run


def camera(**fields) -> fg.Camera:
    values = camera_entry() | fields
    matrix = np.eye(4)
    matrix[:3, 3] = -np.array(values["position"])
    return fg.Camera(values["width"], values["height"], values["fx"], values["fy"], values["width"] / 2, values["height"] / 2, matrix)


def names(work) -> list[str]:
    """The frames; what is known of them lies in a hidden folder."""
    return sorted(name for name in os.listdir(work / "out") if name != ".fastgs-frames")


def pixels(work, name) -> np.ndarray:
    return np.asarray(Image.open(work / "out" / name))


def png_of(model, camera, frame) -> np.ndarray:
    image = fg.render(model, camera, frame / FRAMES, backend="reference")
    rgba = np.concatenate([colour.display(image["rgb"], image["alpha"], model.colour_space), image["alpha"][..., None]], -1)
    return np.floor(np.clip(rgba, 0, 1) * 255 + 0.5).astype(np.uint8)


def test_frames_are_rendered_where_they_lie_in_time(run, work, model):
    code, out, _ = run("--frames", "2:4")
    assert (code, out) == (0, "")
    assert names(work) == ["0002.png", "0003.png", "0004.png"]
    for frame in (2, 3, 4):
        np.testing.assert_array_equal(pixels(work, f"{frame:04d}.png"), png_of(model, camera(), frame))
    assert (pixels(work, "0002.png") != pixels(work, "0003.png")).any()


def test_sub_frames_are_exact(run, work, model):
    run("--frames", "2:3:0.5")
    assert names(work) == ["0002.0.png", "0002.5.png", "0003.0.png"]
    np.testing.assert_array_equal(pixels(work, "0002.5.png"), png_of(model, camera(), 2.5))


def test_the_whole_clip_is_the_default(run, work):
    run()
    assert names(work) == [f"{i:04d}.png" for i in range(FRAMES)]


def test_frames_beyond_the_clip_are_rendered_with_a_remark(run, work):
    code, _, err = run("--frames", "9:11")
    assert code == 0
    assert len(names(work)) == 3
    assert "0 to 9" in err


def test_progress_on_standard_error(run):
    _, out, err = run("--frames", "0:2")
    assert out == ""
    assert "rendering: 3/3 frames (100 %)" in err and not {"\r", "\x1b"} & set(err)
    assert run("--frames", "0:2", "--overwrite", "--quiet")[1:] == ("", "")


def test_frames_of_the_same_work_are_kept(run, work, model):
    run("--frames", "0:1")
    (work / "out" / "0000.png").unlink()
    before = (work / "out" / "0001.png").stat().st_mtime_ns
    code, out, err = run("--frames", "0:2", "--json")
    assert code == 0 and (work / "out" / "0001.png").stat().st_mtime_ns == before
    assert "1 of 3" in err
    result = json.loads(out)
    assert (result["rendered"], result["kept"]) == (2, 1)
    assert [Path(f).name for f in result["files"]] == ["0000.png", "0001.png", "0002.png"]
    fg.save(model, work / "copy.safetensors")  # another file of the same model
    assert cli.main(["render", str(work / "copy.safetensors"), "--camera", str(work / "cameras.json"), "--out", str(work / "out"),
                     "--backend", "reference", "--frames", "0:2"]) == 0


@pytest.mark.parametrize("change", ["size", "background", "model", "camera", "backend", "not ours", "note"])
def test_frames_of_other_work_are_not_kept(run, work, model, change):
    run("--frames", "0:1")
    options = {"size": ["--size", "12x8"], "background": ["--background", "white"], "backend": ["--backend", "auto"]}.get(change, [])
    if change == "model":
        model.opacity[0] += 1
        fg.save(model, work / "m.safetensors")
    elif change == "camera":
        (work / "cameras.json").write_text(json.dumps([camera_entry(x=0.1)]))
    elif change == "not ours":
        (work / "out" / "0002.png").write_bytes(b"mine")
    elif change == "note":
        (work / "out" / ".fastgs-frames" / "0001.png").write_bytes(b"\xff" * 1000)
    before = {name: (work / "out" / name).read_bytes() for name in names(work)}
    code, _, err = run("--frames", "0:2", *options)
    assert code == 2 and "--overwrite" in err and len(err.strip().splitlines()) == 1
    assert {name: (work / "out" / name).read_bytes() for name in names(work)} == before
    assert run("--frames", "0:2", "--overwrite", *options)[0] == 0
    code, _, err = run("--frames", "0:2", *options)
    assert code == 0 and "3 of 3" in err


def test_options_are_checked_where_nothing_is_left_to_do(run):
    run("--frames", "0")
    for wrong in (["--backend", "magic"], ["--threads", "0"], ["--view", "back"], ["--background", "sky"]):
        assert run("--frames", "0", *wrong)[0] == 2


def read_exr(path) -> dict[str, np.ndarray]:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: np.array(channel.pixels) for name, channel in file.channels().items()}


def test_exr_holds_every_pass(run, work, model):
    assert run("--frames", "3", "--format", "exr")[0] == 0
    image = fg.render(model, camera(), 3 / FRAMES, passes=tuple(passes.PASSES), backend="reference")
    channels = read_exr(work / "out" / "0003.exr")
    np.testing.assert_array_equal(channels["A"], image["alpha"])
    wanted = colour.scene_linear(image["rgb"], image["alpha"], "srgb")
    np.testing.assert_array_equal(np.stack([channels[c] for c in "RGB"], -1), wanted)
    seen = image["alpha"] > 0
    np.testing.assert_array_equal(channels["Depth.Z"][seen], image["depth"][seen])
    assert "MedianDepth.Z" in channels


def test_exr_with_chosen_passes(run, work):
    run("--frames", "3", "--format", "exr", "--passes", "depth,alpha")
    assert set(read_exr(work / "out" / "0003.exr")) == {"A", "Depth.Z"}


def test_motion_blur_and_depth_of_field(run, work, model):
    """As the library renders them; other settings are other work."""
    options = ["--frames", "3", "--format", "exr", "--passes", "alpha,cryptomatte_00"]
    assert run(*options, "--shutter", "2", "--steps", "8", "--aperture", "0.2", "--focus", "4", "--lens-samples", "8")[0] == 0
    exposure = Exposure(-1, 1, steps=8, aperture=Aperture(0.2, 4.0, samples=8))
    image = fg.render(model, camera(), 3 / FRAMES, passes=("alpha",), backend="reference", exposure=exposure)
    np.testing.assert_array_equal(read_exr(work / "out" / "0003.exr")["A"], image["alpha"])
    with OpenEXR.File(str(work / "out" / "0003.exr")) as file:
        manifest = json.loads(next(value for name, value in file.header().items() if name.endswith("/manifest")))
    assert manifest == {"m": f"{bits_of('m'):08x}"}
    assert run(*options)[0] == 2, "sharp frames are other work"
    for wrong in (["--aperture", "0.1"], ["--shutter", "-1"], ["--shutter", "1", "--steps", "0"]):
        assert run(*options, "--overwrite", *wrong)[0] == 2


def test_far_views_as_they_come(run, work, model):
    """--no-antialias is for models that know their cameras, and other work."""
    known = replace(model, surroundings=Surroundings(cameras=(viewpoint_of(replace(camera(), fx=400, fy=400)),)))
    fg.save(known, work / "m.safetensors")
    run("--frames", "0")
    soft = pixels(work, "0000.png")
    assert run("--frames", "0", "--no-antialias")[0] == 2
    run("--frames", "0", "--no-antialias", "--overwrite")
    np.testing.assert_array_equal(pixels(work, "0000.png"), png_of(model, camera(), 0))
    assert np.abs(soft.astype(int) - pixels(work, "0000.png")).max() > 20


def test_sorting_by_pixel(run, work, model):
    """As the library does it; other sorting is other work."""
    near = replace(model, scale=model.scale + 1.5)
    fg.save(near, work / "m.safetensors")
    run("--frames", "0", "--format", "exr", "--passes", "alpha,median_depth", "--sorting", "pixel")
    wanted, other = (fg.render(near, camera(), 0, ("alpha", "median_depth"), "reference", settings=passes.PassSettings(sorting=sorting))
                     for sorting in ("pixel", "centre"))
    seen = np.isfinite(wanted["median_depth"])
    np.testing.assert_array_equal(read_exr(work / "out" / "0000.exr")["MedianDepth.Z"][seen], wanted["median_depth"][seen])
    assert np.abs(wanted["median_depth"][seen] - other["median_depth"][seen]).max() > 0.1
    assert run("--frames", "0", "--format", "exr", "--passes", "alpha,median_depth")[0] == 2


def test_background(run, work, model):
    run("--frames", "0", "--background", "#336699")
    image = fg.render(model, camera(), 0, backend="reference")
    wanted = image["rgb"] + (1 - image["alpha"][..., None]) * np.array([0x33, 0x66, 0x99]) / 255
    assert np.abs(pixels(work, "0000.png")[..., :3] / 255 - np.clip(wanted, 0, 1)).max() <= 0.51 / 255
    assert (pixels(work, "0000.png")[..., 3] == 255).all()


def test_the_own_background_is_what_a_decoder_of_sums_shows(run, work, model, rng, make_model):
    """As Spacetime Gaussians' renderer; on the usual transparent film nothing is where no splat is."""
    shown = make_model(rng, 30, appearance="stg", size=0.2)
    fg.save(shown, work / "m.safetensors")
    run("--frames", "0", "--background", "own")
    wanted = fg.render(shown, camera(), 0, backend="reference")
    assert (wanted["alpha"] == 0).any() and (wanted["rgb"][wanted["alpha"] == 0] > 0.1).all()
    written = pixels(work, "0000.png")
    assert np.abs(written[..., :3] / 255 - wanted["rgb"]).max() <= 0.51 / 255 and (written[..., 3] == 255).all()
    run("--frames", "0", "--overwrite")
    assert (pixels(work, "0000.png")[..., 3] == 0).any()
    assert run("--frames", "0", "--background", "own", "--shutter", "1")[0] == 2


def test_size(run, work, model):
    run("--frames", "0", "--size", "48x32")
    np.testing.assert_array_equal(pixels(work, "0000.png"), png_of(model, camera(width=48, height=32, fx=40, fy=40), 0))


@pytest.fixture
def three_cameras(work):
    cameras = [camera_entry(name, x) for name, x in (("left", -1.0), ("middle", 0.0), ("right", 1.0))]
    (work / "cameras.json").write_text(json.dumps(cameras))
    return [camera(position=entry["position"]) for entry in cameras]


@pytest.mark.parametrize(("view", "number"), [("right", 2), ("1", 1)])
def test_a_view_by_name_or_number(run, work, model, three_cameras, view, number):
    run("--frames", "0:2", "--view", view)
    for frame in range(3):
        np.testing.assert_array_equal(pixels(work, f"{frame:04d}.png"), png_of(model, three_cameras[number], frame))


def test_as_many_cameras_as_frames_are_a_path(run, work, model, three_cameras):
    run("--frames", "4:6")
    for i, one in enumerate(three_cameras):
        np.testing.assert_array_equal(pixels(work, f"{4 + i:04d}.png"), png_of(model, one, 4 + i))


def test_a_frame_of_a_path_takes_its_camera(run, work, model, three_cameras):
    run("--frames", "2", "--path")
    np.testing.assert_array_equal(pixels(work, "0002.png"), png_of(model, three_cameras[2], 2))
    code, _, err = run("--frames", "2:3", "--path")
    assert code == 2
    assert "3 cameras" in err


def test_several_cameras_and_no_choice_is_the_first_and_says_so(run, work, model, three_cameras):
    _, _, err = run("--frames", "0:1")
    assert "left" in err
    np.testing.assert_array_equal(pixels(work, "0001.png"), png_of(model, three_cameras[0], 1))


@pytest.mark.parametrize("arguments", [
    ("--frames", "5:1"), ("--frames", "x"), ("--size", "0x5"), ("--size", "big"), ("--background", "sky"), ("--background", "#12"),
    ("--passes", "depth"), ("--passes", "wetness", "--format", "exr"), ("--passes", "", "--format", "exr"), ("--view", "back"),
    ("--backend", "magic"), ("--threads", "0"), ("--camera", "none.json"),
])
def test_wrong_arguments_are_one_sentence_and_no_file(run, work, arguments):
    code, _, err = run("--quiet", *arguments)
    assert code == 2
    assert err.startswith("fastgs: ")
    assert len(err.strip().splitlines()) == 1
    assert not (work / "out").exists() or not names(work)


def test_the_folder_is_a_file(run, work):
    (work / "out").write_text("a file")
    code, _, err = run("--frames", "0")
    assert code == 2
    assert str(work / "out") in err
    assert (work / "out").read_text() == "a file"


def test_interrupt_ends_with_one_line_and_whole_frames(run, work, monkeypatch):
    real, calls = rendering.render, []

    def interrupted(*arguments, **options):
        calls.append(arguments)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return real(*arguments, **options)

    monkeypatch.setattr(rendering, "render", interrupted)
    code, _, err = run("--frames", "0:5", "--quiet")
    assert code == 130
    assert len(err.strip().splitlines()) == 1
    assert "2 of 6" in err
    assert names(work) == ["0000.png", "0001.png"]


@pytest.fixture
def start(work):
    """start(*arguments, **options): fastgs render in a process of its own."""

    def start(*arguments, **options):
        command = [sys.executable, "-m", "fastgs_blender", "render", str(work / "m.safetensors"), "--camera", str(work / "cameras.json"),
                   "--out", str(work / "out"), "--backend", "reference", *arguments]
        return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)

    return start


def wait_for_frames(work, process, count):
    """Wait until a process that is far from its end has written so many frames."""
    def written():
        assert process.poll() is None, process.communicate()[1]
        return len(list((work / "out").glob("[0-9]*"))) >= count

    until(written)


@pytest.mark.slow
@pytest.mark.parametrize(("kill", "code"), [("SIGKILL", -9), ("SIGTERM", 130), ("SIGINT", 130)])
@pytest.mark.parametrize("kind", ["png", "exr"])
@pytest.mark.posix
def test_a_killed_run_leaves_whole_frames_and_goes_on(run, work, model, start, kill, code, kind):
    process = start("--frames", "0:5000", "--format", kind, "--size", "96x64")
    wait_for_frames(work, process, 3)
    process.send_signal(getattr(signal, kill))
    _, err = process.communicate(timeout=GUARD)
    assert process.returncode == code, "the signal has hit it"
    assert "Traceback" not in err
    frames = sorted(p.name for p in (work / "out").glob(f"[0-9]*.{kind}"))
    assert frames == [f"{i:04d}.{kind}" for i in range(len(frames))]
    for name in frames:
        if kind == "png":
            assert pixels(work, name).shape == (64, 96, 4)
        else:
            assert read_exr(work / "out" / name)["A"].shape == (64, 96)
    if kill != "SIGKILL":
        assert names(work) == frames
        assert "stopped" in err
    before = (work / "out" / frames[0]).stat().st_mtime_ns
    assert run("--frames", f"0:{len(frames)}", "--format", kind, "--size", "96x64")[0] == 0
    assert (work / "out" / f"{len(frames):04d}.{kind}").exists()
    assert (work / "out" / frames[0]).stat().st_mtime_ns == before


@pytest.mark.parametrize("kind", ["png", "exr"])
@pytest.mark.posix
def test_a_disk_that_takes_no_more_is_one_sentence(work, start, kind):
    import resource

    process = start("--frames", "0:3", "--format", kind, "--size", "640x480", "--quiet",
                    preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (1024, 1024)))
    _, err = process.communicate(timeout=GUARD)
    assert process.returncode == 2, err
    assert len(err.strip().splitlines()) == 1
    assert "not be written" in err
    assert names(work) == []


def test_frames_go_to_standard_output_for_ffmpeg(work, capsysbinary):
    """The same bytes as in files, one PNG after another."""
    command = ["render", str(work / "m.safetensors"), "--camera", str(work / "cameras.json"), "--backend", "reference", "--frames", "2:4"]
    assert cli.main([*command, "--out", str(work / "out")]) == 0
    capsysbinary.readouterr()
    assert cli.main([*command, "--out", "-", "--quiet"]) == 0
    files = [(work / "out" / f"{frame:04d}.png").read_bytes() for frame in (2, 3, 4)]
    assert capsysbinary.readouterr().out == b"".join(files)
    for more in (["--format", "exr"], ["--json"]):
        assert cli.main([*command, "--out", "-", *more]) == cli.FAILED
        printed = capsysbinary.readouterr()
        assert not printed.out and more[0].encode() in printed.err

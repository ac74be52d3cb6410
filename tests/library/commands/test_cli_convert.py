# SPDX-License-Identifier: GPL-3.0-or-later
"""fastgs convert: what it says of frames, of what a file holds, and of antialiasing."""
from __future__ import annotations

import base64
import json
import os
import re
import signal
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from held_runs import until

import fastgs_blender as fg

ROOT = Path(__file__).resolve().parents[3]


def test_convert_for_viewers_that_antialias(run, rng, make_model, tmp_path):
    """One camera sees all Gaussians from 1000 away with a focal length of 500: a pixel is 2 wide; each variance grows by 0.2 * 2^2."""
    model = make_model(rng, 30, basis=fg.Fourier(3), temporal="radial", appearance="sh1", clip=fg.Clip(50, 25.0, 7))
    path, plain, soft = (tmp_path / name for name in ("model.safetensors", "plain.ply", "soft.ply"))
    fg.save(model, path)
    assert run("convert", path, soft, "--at", "12", "--antialias")[0] == 2 and "annotate" in run(
        "convert", path, soft, "--at", "12", "--antialias")[2]
    camera = fg.Viewpoint(width=640, height=480, fx=500, fy=500, cx=320, cy=240, position=(0, 0, -1000))
    fg.save(replace(model, surroundings=fg.Surroundings(cameras=(camera,))), path)
    for target, options, said in ((tmp_path / "a.ply", (), "--at"), (tmp_path / "a.splat", ("--at", "12"), ".spz")):
        code, _, told = run("convert", path, target, "--antialias", *options)
        assert code == 2 and said in told and not target.exists()
    for target, options in ((plain, ()), (soft, ["--antialias"])):
        code, _, told = run("convert", path, target, "--at", "12", *options)
        assert code == 0 and ("softer" in told) == bool(options)
    before, after = fg.load(plain), fg.load(soft)
    assert after.raster.antialiased and not before.raster.antialiased
    np.testing.assert_allclose(np.exp(2.0 * after.scale), np.exp(2.0 * before.scale) + 0.8, rtol=0.03)


@pytest.mark.parametrize("frames", ["50", "-1", "40:60:10"])
def test_frames_outside_of_the_clip_are_told(frames, run, rng, make_model, tmp_path):
    path = tmp_path / "model.safetensors"
    fg.save(make_model(rng, 5, basis=fg.Fourier(3), clip=fg.Clip(50, 25.0, 7)), path)
    code, _, said = run("convert", path, tmp_path / "out_####.spz", f"--at={frames}")
    assert code == 0 and "0 to 49" in said and "extrapolated" in said
    assert "extrapolated" not in run("convert", path, tmp_path / "in_####.spz", "--at", "0:49:49")[2]


@pytest.mark.slow
def test_what_a_compressed_file_holds_is_reported(run, rng, make_model, tmp_path, few_pictures):
    """Compression leaves out what pictures do not show: here, Gaussians that nobody can see."""
    model = make_model(rng, 200, appearance="rgb")
    model.opacity[:150] = -30
    path, small = tmp_path / "model.safetensors", tmp_path / "small.safetensors"
    fg.save(model, path)
    code, text, _ = run("convert", path, small, "--compress", "--json")
    assert code == 0 and json.loads(text)["gaussians"] == len(fg.load(small)) < 200


@pytest.mark.parametrize("name", ["m.spz", "m.sog", "m.splat", "m.glb", "m.compressed.ply", "m.ply", "m.splatv", "m.safetensors"])
def test_formats_without_cameras_say_that_antialiasing_ends(name, rng, make_model, tmp_path):
    """They say so exactly where the file does not give the cameras back."""
    camera = fg.Viewpoint(width=640, height=480, fx=500, fy=500, cx=320, cy=240, position=(0, 0, -1000))
    model = replace(make_model(rng, 5, appearance="rgb"), surroundings=fg.Surroundings(cameras=(camera,)))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", fg.LossWarning)
        fg.save(model, tmp_path / name)
    told = any("Antialias" in str(warning.message) for warning in caught)
    assert told == (not fg.load(tmp_path / name).surroundings.cameras)


HELD = "import os, signal\nos.fsync = lambda handle: signal.pause()\n"
"""What a process reads at its start that is held after its last byte and before its first rename."""


@pytest.mark.parametrize("names", [("a.safetensors",), ("a.ply", "a.pt")], ids=str)
@pytest.mark.posix
def test_what_a_killed_conversion_left_goes_with_the_next_one(names, rng, make_model, tmp_path):
    """All that it wrote aside goes, and nothing else, be it hidden or called alike."""
    hook, out = tmp_path / "hook", tmp_path / "out"
    for folder in (hook, out, out / ".fastgs-mine", out / "fastgs-000000000000.tmp"):
        folder.mkdir()
    (hook / "sitecustomize.py").write_text(HELD)
    for name in (".fastgs-mine/x", "fastgs-000000000000.tmp/x", ".hidden", "b.ply.tmp"):
        (out / name).write_text("precious")
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    model = make_model(rng, 3000, basis="cubic", rotation_basis="line", temporal="radial", appearance="sigmoid")  # a .ply has a decoder
    fg.save(model, tmp_path / "model.safetensors")
    command = [sys.executable, "-m", "fastgs_blender", "convert", str(tmp_path / "model.safetensors"), str(out / names[0])]
    path = os.pathsep.join([str(hook), str(ROOT)])
    with subprocess.Popen(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": path}, stderr=subprocess.PIPE) as process:
        def written():
            assert process.poll() is None, process.stderr.read()
            return [file for file in out.glob(f".fastgs-*.tmp/{names[0]}") if file.stat().st_size > 10_000]

        until(written)
        process.kill()
    assert process.returncode == -signal.SIGKILL
    after = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert len(after) > len(before) and {path: after[path] for path in before} == before
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    left = {path: path.read_bytes() for path in out.rglob("*") if path.is_file() and path not in {out / name for name in names}}
    assert left == before and all((out / name).stat().st_size > 1000 for name in names) and not list(out.glob(".fastgs-*.tmp"))


def test_long_clips_in_chapters(run, rng, make_model, tmp_path):
    """A model in chapters, two models after each other, one model again; info, render and frames of them."""
    model = make_model(rng, 40, basis="line", temporal="window", clip=fg.Clip(50, 25.0))
    one, two, long, both = (tmp_path / f"{name}.safetensors" for name in ("one", "two", "long", "both"))
    fg.save(model, one)
    fg.save(make_model(rng, 30, basis="cosine", clip=fg.Clip(30, 25.0)), two)
    assert run("convert", one, long, "--chapters", "10")[0] == 0 and len(fg.open_source(long).chapters) == 5
    code, text, _ = run("convert", long, both, "--then", two, "--json")
    assert code == 0 and json.loads(text)["gaussians"] == 70 and fg.open_source(both).clip == fg.Clip(80, 25.0)
    facts = json.loads(run("info", both, "--json")[1])
    assert (facts["gaussians"], facts["chapters"], facts["clip"]["frame_count"]) == (70, 6, 80) and "in 6 chapters" in run("info", both)[1]
    assert run("convert", long, tmp_path / "again.safetensors")[0] == 0
    assert isinstance(fg.open_source(tmp_path / "again.safetensors"), fg.GaussianModel)
    assert run("convert", both, tmp_path / "f_####.ply", "--at", "0:79:60")[0] == 0 and (tmp_path / "f_0060.ply").is_file()
    code, _, said = run("convert", one, tmp_path / "m.ply", "--chapters")
    assert code == 2 and ".safetensors" in said


@pytest.mark.slow
def test_a_page_of_a_long_clip_has_a_file_for_each_piece(run, rng, make_model, tmp_path, few_pictures):
    """Of models with a motion of their own one after another; a compressed file gives the page its own numbers."""
    names = [tmp_path / f"{name}.safetensors" for name in ("one", "two", "both")]
    for name, basis in zip(names, ("line", "cosine")):
        fg.save(make_model(rng, 30, basis=basis, clip=fg.Clip(20, 25.0)), name)
    assert run("convert", names[0], names[2], "--then", names[1], "--compress", "fine")[0] == 0
    assert run("convert", names[2], tmp_path / "page.html", "--title", "Both", "--once")[0] == 0
    text, source = (tmp_path / "page.html").read_text("utf-8"), fg.open_source(names[2])
    about = json.loads(re.search(r'id="scene"[^>]*>(.*?)</script>', text, re.DOTALL)[1])
    assert about["title"] == "Both" and about["frames"] == 40 and not about["loop"]
    assert [each["count"] for each in about["objects"]] == [piece.size for piece in source.pieces]
    assert about["objects"][0]["shown"][1] == about["objects"][-1]["shown"][0] == pytest.approx(0.5)
    assert about["objects"][-1]["clip"] == pytest.approx([0.5, 0.5])
    data = base64.b64decode(re.search(r'id="model-1"[^>]*>(.*?)</script>', text, re.DOTALL)[1])
    (tmp_path / "piece.safetensors").write_bytes(data)
    np.testing.assert_array_equal(fg.load(tmp_path / "piece.safetensors").position, source.pieces[1].read().position)

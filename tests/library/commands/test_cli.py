# SPDX-License-Identifier: GPL-3.0-or-later
"""fastgs info, convert and bench; and what holds for every subcommand."""
from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender import cli
from fastgs_blender.commands import COMMANDS, bench
from fastgs_blender.kernels.cpu import jit
from fastgs_blender.training.core.settings import settings
from fastgs_blender.training.run.plan import Plan, Source

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def model(rng, make_model):
    return make_model(rng, 30, basis=fg.Fourier(3), temporal="radial", appearance="sh1", clip=fg.Clip(50, 25.0, 7),
                      provenance={"source": "a test"})


@pytest.fixture
def file(model, tmp_path):
    path = tmp_path / "model.safetensors"
    fg.save(model, path)
    return path


def test_help_and_version_import_nothing_heavy():
    program = """
import sys
from fastgs_blender import cli
for argument in (["--help"], ["--version"], ["render", "--help"], ["bench", "--help"]):
    try:
        cli.main(argument)
    except SystemExit as end:
        assert end.code == 0
assert not {"numba", "OpenEXR", "PIL", "tqdm", "torch"} & set(sys.modules)
"""
    result = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert all(word in result.stdout for word in ("info", "convert", "render", "bench", fg.__version__))


HOSTILE = {"a\udcffb": "x\x1b]0;owned\x07\x1b[2J\ud800", "plain": "one\nfile   /etc/passwd\ttwo\r\x00", "é漢": "ü"}


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_what_a_file_says_cannot_command_the_terminal_or_break_its_encoding(model, tmp_path, encoding):
    model.provenance = HOSTILE
    path = tmp_path / "a\x1b[31m.safetensors"
    fg.save(model, path)
    def info(*arguments):
        command = [sys.executable, "-m", "fastgs_blender", "info", *arguments, path]
        return subprocess.run(command, cwd=ROOT, capture_output=True, check=False, env={**os.environ, "PYTHONIOENCODING": encoding})

    result = info()
    assert result.returncode == 0, result.stderr
    text = result.stdout.decode(encoding)
    assert not {c for c in text if ord(c) < 32} - {"\n"}
    assert "\\x1b]0;owned" in text and "a\\udcffb" in text and "\\ud800" in text
    assert [line for line in text.splitlines() if line.startswith("file")] == [line for line in text.splitlines() if "a\\x1b[31m" in line]
    values = json.loads(info("--json").stdout.decode(encoding))
    assert "\x1b]0;owned" in values["provenance"]["a\\udcffb"] and values["provenance"]["é漢"] == "ü"
    json.dumps(values, ensure_ascii=False).encode("utf-8")
    path.write_bytes(b"{")
    failed = info("--debug")
    assert failed.returncode == 2 and b"\x1b" not in failed.stderr and b"Traceback" in failed.stderr


@pytest.mark.parametrize("command", [("info", "{}"), ("convert", "{}", "{}.ply"), ("check", "{}"), ("sync", "{}"), ("eval", "{}", "{}"),
                                     ("cameras", "{}", "--out", "{}"), ("render", "{}", "--camera", "{}", "--out", "{}"),
                                     ("train", "{}", "--out", "{}"), ("annotate", "{}", "--capture", "{}")])
def test_a_line_end_in_a_name_begins_no_line(run, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    code, _, errors = run(*(part.format("a\nfastgs: all is well\r") for part in command))
    assert code == 2 and not [line for line in errors.splitlines() if line.startswith("fastgs: all is well")]


def test_what_commands_print_goes_through_one_function():
    """util.screen.tell() makes lines printable; print() is for what holds no names."""
    allowed = {"util/screen.py", "commands/completion.py", "jobs/environment.py"}
    library = ROOT / "fastgs_blender"
    found = {file.relative_to(library).as_posix() for file in library.rglob("*.py")
             if re.search(r"^ *print\(", re.sub(r'""".*?"""', "", file.read_text("utf-8"), flags=re.DOTALL), re.MULTILINE)}
    assert found <= allowed


def test_a_name_that_is_no_utf8(run):
    code, _, errors = run("info", "missing\udcff\x1b[31m.ply")
    assert code == 2 and "missing\\udcff\\x1b[31m.ply" in errors and "Traceback" not in errors


def test_runs_as_a_module(file):
    result = subprocess.run([sys.executable, "-m", "fastgs_blender", "info", "--json", str(file)], cwd=ROOT, capture_output=True,
                            text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["gaussians"] == 30


def test_info_of_a_run_names_its_frames_as_train_takes_them(tmp_path, capsys):
    (tmp_path / "status.json").write_text('{"state": "stopped"}')
    for part, words in (((2, 7, 1), "frames 2:6,"), ((0, 20, 3), "frames 0:19:3,"), ((4, 1 << 30, 1), "frames from 4 on,")):
        plan = Plan(settings(), Source("/capture", scale=0.5, frames=part, held_out=("cam00",)))
        (tmp_path / "run.json").write_text(json.dumps(plan.to_dict()))
        assert cli.main(["info", str(tmp_path)]) == 0
        assert words in " ".join(capsys.readouterr().out.split())


def test_info_for_scripts(run, file, model):
    code, out, err = run("info", "--json", file)
    facts = json.loads(out)
    assert (code, err) == (0, "")
    assert facts["gaussians"] == 30
    assert facts["motion"]["basis"] == "fourier"
    assert facts["motion"]["order"] == 3
    assert facts["motion"]["band_limit_hz"] == pytest.approx(3 / (50 / 25.0))
    assert facts["rotation"]["band_limit_hz"] is None
    assert facts["temporal_opacity"] == "radial"
    assert facts["appearance"] == {"kind": "sh", "columns": 12, "degree": 1}
    assert facts["clip"] == {"frame_count": 50, "fps": 25.0, "start_frame": 7, "duration_seconds": 2.0}
    assert facts["raster"]["blur"] == model.raster.blur
    assert (facts["axes"], facts["colour_space"]) == (model.axes, "srgb")
    assert facts["provenance"]["source"] == "a test"
    assert facts["file_bytes"] == file.stat().st_size
    assert facts["memory_bytes"] == model.nbytes


def test_info_bounds_hold_the_motion(run, file, model):
    facts = json.loads(run("info", "--json", file)[1])
    centres = np.concatenate([fg.slice_model(model, t, cull=False).position for t in (0, 0.25, 0.5, 0.75, 1)])
    np.testing.assert_allclose(facts["bounds"]["low"], centres.min(0), atol=1e-5)
    np.testing.assert_allclose(facts["bounds"]["high"], centres.max(0), atol=1e-5)


def test_info_for_people(run, file):
    code, out, _ = run("info", file)
    assert code == 0
    assert all(words in out for words in ("fourier, order 3", "up to 1.5 Hz", "50 frames from 7 at 25 fps", "sh, columns 12, degree 1",
                                          "radial", "srgb", "a test", str(file)))


def test_info_fits_on_a_screen_and_shows_the_rest_when_told(run, model, tmp_path):
    model.provenance = {"settings": json.dumps(dict.fromkeys(map(str, range(200)), 1.5)), **{f"key {i}": "a word " * 9 for i in range(30)}}
    path = tmp_path / "long.safetensors"
    fg.save(model, path)
    _, short, _ = run("info", path)
    _, long, _ = run("info", path, "--all")
    lines = short.splitlines()
    assert len(lines) < 24 and all(len(line) <= 80 or str(path) in line for line in lines) and "--all" in lines[-1]
    assert all(words in long for words in ("rasteriser", "from settings", "from key 29", '"199": 1.5')) and "rasteriser" not in short
    assert all(len(line) <= 80 or str(path) in line for line in long.splitlines())


@pytest.mark.parametrize("command", [[], *([module.__name__.rpartition(".")[2]] for module in COMMANDS)])
def test_help_has_80_columns_and_a_bare_command_shows_it(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    if command:
        with pytest.raises(SystemExit, match="0"):
            cli.main([*command, "--help"])
    else:
        assert cli.main([]) == 0
    out = capsys.readouterr().out
    assert out.startswith("usage: fastgs") and max(map(len, out.splitlines())) <= 80
    assert command or "Exit codes" in out


WRONG = ["trian"], ["completion", "powershell"], ["render", "a", "--format", "jpg"], ["info"], ["info", "no such file " * 9]


@pytest.mark.parametrize("arguments", WRONG, ids=" ".join)
def test_what_goes_wrong_is_told_within_the_terminal(arguments, capsys, monkeypatch):
    """Between words where $COLUMNS, or a terminal, says how wide it is; a log gets each sentence whole."""
    found = {}
    for columns in ("80", "5000"):
        monkeypatch.setenv("COLUMNS", columns)
        try:
            code = cli.main(arguments)
        except SystemExit as end:
            code = end.code
        out, found[columns] = capsys.readouterr()
        assert (code, out) == (2, "")
    assert max(map(len, found["80"].splitlines())) <= 80 and "fastgs: " in found["80"] and found["80"].endswith(".\n")
    assert found["80"].split() == found["5000"].split() and found["5000"].splitlines()[-1].startswith("fastgs: ")


def test_quiet_is_quiet(run, model, tmp_path, monkeypatch):
    """Losses, remarks, summaries and the first compilation too; errors are told."""
    model.position[3] = np.nan
    path = tmp_path / "diverged.safetensors"
    fg.save(model, path)
    assert run("convert", path, tmp_path / "a.splatv", "--quiet") == (0, "", "")
    assert "lost" in run("convert", path, tmp_path / "b.splatv")[2]
    monkeypatch.setattr(jit.cache, "is_begun", lambda: False)
    monkeypatch.setattr(jit.aside, "begin", lambda work: None)
    for quiet in ([], ["--quiet"]):
        monkeypatch.setattr(jit, "_announced", set())
        monkeypatch.setattr(bench, "measure", lambda *arguments: jit.announce() or {})
        _, _, err = run("bench", path, "--size", "9x9", "--json", *quiet)
        assert ("compiling" in err) == (not quiet)
    code, out, err = run("convert", path, tmp_path / "a.splatv", "--quiet")
    assert (code, out) == (2, "") and "--overwrite" in err


def test_info_of_a_training_run(run, file, tmp_path, capsys):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "run.json").write_text(json.dumps({"settings": {"motion": "paper"}, "source": {"capture": "/films", "scale": 0.5}}))
    status = {"state": "training", "iteration": 20, "iterations": 90}
    (folder / "status.json").write_text(json.dumps(status))
    code, out, _ = run("info", folder)
    assert code == 0 and all(words in out for words in ("training, 20 of 90 steps", "/films, scale 0.5", "motion paper"))
    for command in (["eval", folder], ["render", folder, "--camera", ROOT / "examples/cameras.json", "--out", tmp_path / "frames"]):
        code, _, err = run(*command)
        assert code == 2 and "20 of 90 steps" in err and "--resume" in err
    (folder / "status.json").write_text(json.dumps({**status, "state": "failed", "reason": "the disk is full."}))
    code, out, _ = run("info", folder)
    assert code == 1 and "disk is full" in out
    shutil.copy(file, folder / "model.safetensors")
    facts = json.loads(run("info", folder, "--json")[1])
    assert facts["model"]["gaussians"] == 30 and facts["settings"]["motion"] == "paper" and facts["state"] == "failed"
    assert run("render", folder, "--camera", ROOT / "examples/cameras.json", "--view", "0", "--frames", "0", "--size", "16x9",
               "--backend", "reference", "--out", tmp_path / "frames")[0] == 0


def test_info_of_a_still_model(run, rng, make_model, tmp_path):
    path = tmp_path / "still.safetensors"
    fg.save(make_model(rng, 3), path)
    facts = json.loads(run("info", "--json", path)[1])
    assert facts["motion"] == {"basis": "static", "terms": 0, "band_limit_hz": None}


@pytest.mark.parametrize("arguments", [
    ("info", "{none}"), ("info", "{text}"), ("info", "{folder}"), ("convert", "{none}", "{folder}/a.ply"),
    ("convert", "{model}", "{folder}/a.unknown"), ("convert", "{model}", "{folder}/no/such/folder/a.ply"),
    ("bench", "--gaussians", "0"), ("bench", "--repeat", "-1"), ("bench", "--size", "12"), ("bench", "--threads", "0"),
    ("bench", "--size", "8x8", "--gaussians", "5", "--backend", "magic"),
])
@pytest.mark.parametrize("debug", [False, True])
def test_errors_are_one_sentence_and_exit_code_2(run, file, tmp_path, arguments, debug):
    (tmp_path / "text.ply").write_text("no model at all")
    names = {"none": tmp_path / "none.ply", "text": tmp_path / "text.ply", "folder": tmp_path, "model": file}
    code, out, err = run(*(a.format(**names) for a in arguments), *(["--debug"] if debug else []))
    lines = err.strip().splitlines()
    assert (code, out) == (2, "")
    assert lines[-1].startswith("fastgs: ")
    assert lines[-1].endswith(".")
    assert ("Traceback" in err) == debug
    assert debug or len(lines) == 1


def test_arguments_that_make_no_sense_end_with_2(run):
    for arguments in (["explode"], ["info"], ["render", "a"]):
        with pytest.raises(SystemExit) as end:
            run(*arguments)
        assert end.value.code == 2


def test_convert_and_back_keeps_everything(run, file, model, tmp_path):
    code, out, err = run("convert", file, tmp_path / "copy.safetensors")
    assert (code, err) == (0, "")
    assert "30 Gaussians" in out
    copy = fg.load(tmp_path / "copy.safetensors")
    assert all(np.array_equal(copy.arrays[name], model.arrays[name]) for name in model.arrays)


def test_convert_tells_what_is_lost(run, file, tmp_path):
    code, out, err = run("convert", file, tmp_path / "lossy.splatv")
    assert code == 0
    assert "fastgs: lost: " in err
    assert "lost" not in out
    code, out, err = run("convert", file, tmp_path / "lossy2.splatv", "--json")
    result = json.loads(out)
    assert result["losses"]
    assert result["outputs"] == [str(tmp_path / "lossy2.splatv")]


def test_what_a_file_could_not_give_is_a_remark(run, model, tmp_path):
    model.position[3] = np.nan
    path = tmp_path / "diverged.safetensors"
    fg.save(model, path)
    code, out, err = run("info", "--json", path)
    assert (code, json.loads(out)["gaussians"]) == (0, 29)
    assert err.startswith("fastgs: lost: ")
    assert "1 of 30" in err
    assert len(err.strip().splitlines()) == 1
    assert "1 of 30" in json.loads(run("convert", "--json", path, tmp_path / "b.safetensors")[1])["losses"][0]


@pytest.mark.slow
def test_convert_shows_how_far_it_is(run, file, tmp_path, few_pictures):
    code, out, told = run("convert", file, tmp_path / "small.safetensors", "--compress", "1")
    assert code == 0 and "small.safetensors: " in out and "compressing: 100/100 steps (100 %)" in told
    code, _, told = run("convert", file, tmp_path / "f_##.ply", "--at", "0:2")
    assert code == 0 and "writing: 300/300 steps (100 %)" in told
    code, _, told = run("convert", file, tmp_path / "small.safetensors", "--compress", "1", "--overwrite", "--quiet")
    assert code == 0 and "steps" not in told
    code, _, told = run("convert", file, tmp_path / "one.ply")
    assert code == 0 and "steps" not in told


def test_convert_overwrites_only_when_told(run, file, tmp_path):
    target = tmp_path / "out.safetensors"
    target.write_bytes(b"precious")
    code, _, err = run("convert", file, target)
    assert code == 2
    assert "--overwrite" in err
    assert target.read_bytes() == b"precious"
    assert run("convert", file, target, "--overwrite")[0] == 0
    assert len(fg.load(target)) == 30


def test_convert_does_not_replace_a_decoder_either(run, rng, make_model, tmp_path):
    source = tmp_path / "with_decoder.safetensors"
    fg.save(make_model(rng, 5, basis="cubic", rotation_basis="line", temporal="radial", appearance="sigmoid"), source)
    assert run("convert", source, tmp_path / "a.ply")[0] == 0
    decoder = (tmp_path / "a.pt").read_bytes()
    (tmp_path / "a.ply").unlink()
    code, _, err = run("convert", source, tmp_path / "a.ply")
    assert code == 2
    assert "a.pt" in err
    assert not (tmp_path / "a.ply").exists()
    assert (tmp_path / "a.pt").read_bytes() == decoder
    assert run("convert", source, tmp_path / "a.ply", "--overwrite")[0] == 0


def test_convert_a_frame(run, file, model, tmp_path):
    assert run("convert", file, tmp_path / "frame.ply", "--at", "12.5")[0] == 0
    frozen, now = fg.load(tmp_path / "frame.ply"), fg.slice_model(model, 12.5 / 50)
    assert isinstance(frozen.basis, fg.Static)
    np.testing.assert_allclose(frozen.position, now.position, atol=1e-6)
    np.testing.assert_allclose(np.exp(frozen.scale), now.scale, rtol=1e-5)


@pytest.mark.parametrize(("pattern", "names"), [
    ("f_####.ply", ["f_0000.ply", "f_0002.ply", "f_0004.ply"]), ("f.%03d.ply", ["f.000.ply", "f.002.ply", "f.004.ply"]),
    ("%d.ply", ["0.ply", "2.ply", "4.ply"]),
])
def test_convert_frames(run, file, tmp_path, pattern, names):
    folder = tmp_path / "frames"
    folder.mkdir()
    code, out, _ = run("convert", file, folder / pattern, "--at", "0:4:2", "--json")
    assert code == 0
    assert sorted(p.name for p in folder.iterdir()) == names
    assert [Path(p).name for p in json.loads(out)["outputs"]] == names
    assert not np.array_equal(fg.load(folder / names[0]).position[:5], fg.load(folder / names[1]).position[:5])
    assert all(pattern in loss for loss in json.loads(out)["losses"])
    assert len(json.loads(out)["losses"]) <= 1
    # one of the files is there already: nothing at all is written
    (folder / names[0]).unlink()
    assert run("convert", file, folder / pattern, "--at", "0:4:2")[0] == 2
    assert not (folder / names[0]).exists()


def test_convert_frames_needs_a_place_for_the_number(run, file, tmp_path):
    code, _, err = run("convert", file, tmp_path / "f.ply", "--at", "0:4")
    assert code == 2
    assert "out_####.ply" in err


def test_no_gpu_is_looked_for_before_all_else_is_known_to_be_right(run, file, tmp_path, monkeypatch):
    """The first time a GPU is tested, which takes a moment and says a line."""
    def unwanted(device):
        raise AssertionError("a GPU was looked for")

    monkeypatch.setattr("fastgs_blender.util.backends.choose_device", unwanted)
    monkeypatch.setattr("fastgs_blender.training.run.launch.choose_device", unwanted)
    for arguments in (("eval", file, tmp_path / "missing"), ("train", tmp_path / "missing", "--out", tmp_path / "run"),
                      ("train", tmp_path, "--out", tmp_path / "run", "--iterations", "0")):
        code, _, err = run(*arguments)
        assert code == 2 and len(err.splitlines()) == 1


def test_bench_prints_a_table(run):
    code, out, _ = run("bench", "--gaussians", "200", "--size", "48x32", "--repeat", "2", "--threads", "1")
    assert code == 0 and "backend cpu" in out
    assert all(words in out for words in ("200 Gaussians", "48 x 32", "1 threads", "slice and project", "rasterise", "whole frame"))


def test_bench_a_file_for_scripts(run, file):
    result = json.loads(run("bench", file, "--size", "32x32", "--repeat", "1", "--json")[1])
    assert result["gaussians"] == 30
    assert 0 < result["visible"] <= 30
    assert set(result["milliseconds"]) == {"slice and project", "sort", "tiles and rasterise", "whole frame"}
    oracle = json.loads(run("bench", file, "--size", "32x32", "--repeat", "1", "--json", "--backend", "reference")[1])
    assert set(oracle["milliseconds"]) == {"whole frame"}

# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands and the Python of the README and of docs/: none is overlooked, and the Python runs (test_fresh_environment.py: commands)."""
from __future__ import annotations

import re
import shlex
import shutil
import tomllib
import warnings
from pathlib import Path

import numpy as np
import pytest
from toy_captures import write_capture, write_examples

import fastgs_blender as fg
from fastgs_blender import cli
from fastgs_blender.training.core.settings import settings

ROOT = Path(__file__).resolve().parents[2]
PAGES = [page for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))) if page.name != "api.md"]
BLOCK = re.compile(r"^( *)```(\w*)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)
FEW = ["--init", "file",
       *(text for option in ("iterations=3", "init_points=60", "preview_every=0", "warm_up=") for text in ("--set", option))]
OTHERS = r"(\w+=\S+ )*(make|pip|blender|torchrun|ffmpeg|colmap|\.venv(313)?/bin/python) "
"""Programs that are not run here: make and pip are looked at below, the rest needs what a test has not."""


def blocks(page: Path, language: str) -> list[str]:
    return [code for _, found, code in BLOCK.findall(page.read_text("utf-8")) if found == language]


def lines(page: Path) -> list[str]:
    """Lines of the page's code blocks without a language that are commands."""
    return [line.removeprefix("$ ") for code in blocks(page, "") for line in code.splitlines() if re.match(r"(\$ )?fastgs ", line)]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    write_examples(folder / "examples")
    write_capture(folder / "my-capture")
    return folder


@pytest.fixture
def folder(files, tmp_path, monkeypatch):
    """Where a page's commands run."""
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if any("import bpy" not in code and "bpy." not in code
                                                                for code in blocks(page, "python"))], ids=lambda page: page.name)
def test_python_runs(page, folder):
    square = np.tile(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), (3, 1, 1)) + np.arange(3)[:, None, None]
    names = {"fg": fg, "np": np, "model": fg.load("examples/fireside.safetensors"), "placement": np.eye(4), "t": 0.25,
             "camera": fg.load_cameras("examples/cameras.json")[4].camera, "positions": square,
             "triangles": np.array([[0, 1, 2], [1, 3, 2]]), "colours": (0.8, 0.3, 0.1)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fg.LossWarning)
        for code in blocks(page, "python"):
            if "bpy" not in code:
                exec(code, names)  # noqa: S102 (our own pages)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_command_is_overlooked(page):
    """A line of a block without a language that begins like a program is run, or is one of those that are not run here."""
    known = r"fastgs |\$ fastgs |comment |capture/|  |#|" + OTHERS
    for code in blocks(page, ""):
        first = code.splitlines()[0]
        if re.match(known, first):
            words = [line for line in code.splitlines() if line and not re.match(known, line)]
            assert first.startswith(("$ ", "capture/")) or not words, words
        else:
            assert re.match(r"[\w.]+/? {2,}|[\w.]+\.(py|toml) ", first), f"is this a command? {first}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_pip_installs_exists(page):
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    for asked in re.findall(r'pip install "\.\[([\w,]+)\]"', page.read_text("utf-8")):
        assert set(asked.split(",")) <= set(extras)
    assert not re.search(r'pip install "?fastgs', page.read_text("utf-8")), "no registry has the package"


def test_torchrun_gets_a_command_that_is_understood():
    found = [line for page in PAGES for line in re.findall(r"^torchrun .*-m fastgs_blender (.+)$", page.read_text("utf-8"), re.MULTILINE)]
    assert found
    for line in found:
        assert cli.parser().parse_args(shlex.split(line)).command == "train"


def test_options_of_training_in_the_text_exist():
    text = (ROOT / "docs" / "training.md").read_text("utf-8")
    options = cli.parser().parse_args(["train", "x", "--out", "y"])
    for flag in set(re.findall(r"`--([a-z-]+)", text)):
        assert hasattr(options, flag.replace("-", "_")), flag
    for option in re.findall(r"--set (\w+)=(\d+)`", text):
        settings(**{option[0]: int(option[1])})

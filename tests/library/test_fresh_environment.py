# SPDX-License-Identifier: GPL-3.0-or-later
"""Every command of the README and of docs/ in a fresh environment: this project as pip installs it, what it says it needs, nothing else.

They run as they are written, page by page in a folder of its own that holds the examples and the captures
`my-capture` and `my-photographs`; training takes few steps, and compression few pictures.
"""
from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import venv
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from test_docs_commands import FEW, PAGES, ROOT, lines
from toy_captures import write_capture, write_examples

RUN = """
import json, os, sys
from fastgs_blender import cli
from fastgs_blender.formats import rate, thinning
rate.SHOTS, rate.JUDGED, thinning.SENSED, thinning.REFITS, thinning.FINAL = 31, 3, 3, 6, 11  # as the fixture few_pictures
for folder, commands in json.load(sys.stdin):
    os.chdir(folder)
    for words in commands:
        if code := cli.main(words):
            sys.exit(f"{folder}: fastgs {' '.join(words)} ended with {code}")
"""


def needed(names: list[str], found: dict[str, metadata.Distribution]) -> dict[str, metadata.Distribution]:
    """The distributions of these names and all that they need, as they are installed here."""
    for name in names:
        if re.sub(r"[-_.]+", "-", name).lower() not in found:
            distribution = metadata.distribution(name)
            found[re.sub(r"[-_.]+", "-", name).lower()] = distribution
            wanted = [Requirement(text) for text in distribution.requires or []]
            needed([r.name for r in wanted if r.marker is None or r.marker.evaluate({"extra": ""})], found)
    return found


@pytest.fixture(scope="module")
def fresh(tmp_path_factory):
    """The Python of an environment with the project, built and unpacked as pip does it, beside links to its dependencies alone."""
    folder = tmp_path_factory.mktemp("fresh")
    source = folder / "source"
    shutil.copytree(ROOT / "fastgs_blender", source / "fastgs_blender", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    venv.create(folder / "env", with_pip=False)
    python = folder / "env" / ("Scripts" if os.name == "nt" else "bin") / "python"
    site = Path(subprocess.run([python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], check=True, capture_output=True,
                               text=True).stdout.strip())
    subprocess.run([sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps", "--no-build-isolation",
                    "--no-index", "--target", site, source], check=True, capture_output=True)
    own = metadata.Distribution.at(next(site.glob("fastgs_blender-*.dist-info")))
    wanted = [Requirement(text) for text in own.requires]
    for distribution in needed([r.name for r in wanted if r.marker is None or r.marker.evaluate({"extra": ""})], {}).values():
        for top in {path.parts[0] for path in distribution.files if ".." not in path.parts}:
            if not (site / top).exists() and distribution.locate_file(top).exists():
                (site / top).symlink_to(distribution.locate_file(top))
    return python, site


@pytest.mark.slow
def test_the_pages_commands_run(fresh, tmp_path):
    python, site = fresh
    work, capture, examples = [], write_capture(tmp_path / "my-capture"), write_examples(tmp_path / "examples")
    for page in (page for page in PAGES if lines(page)):
        folder = tmp_path / page.stem
        shutil.copytree(examples, folder / "examples")
        for name in ("my-capture", "my-photographs"):
            shutil.copytree(capture, folder / name)
        commands = [shlex.split(re.sub(r"\s#.*", "", line))[1:] for line in lines(page)]
        work.append([str(folder), [[*words, *(FEW if words[0] == "train" and "--resume" not in words else [])] for words in commands]])
    known = {words[0] for _, commands in work for words in commands}
    assert known >= {"info", "check", "render", "cameras", "convert", "train", "eval", "bench"}
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run([python, "-c", RUN], input=json.dumps(work), cwd=tmp_path, env=clean, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert not {"torch", "bpy", "pytest"} & {path.name for path in site.iterdir()}


def test_the_command_and_the_types_are_installed(fresh, tmp_path):
    python, site = fresh
    assert (site / "fastgs_blender" / "py.typed").exists()
    script = next(path for path in (site / "bin").iterdir() if path.name.startswith("fastgs"))
    done = subprocess.run([python, script, "--version"], cwd=tmp_path, env=os.environ | {"PYTHONPATH": ""}, capture_output=True, text=True,
                          check=False)
    assert done.returncode == 0 and done.stdout.startswith("fastgs"), done.stderr

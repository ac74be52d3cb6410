# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands that make an environment for training."""
from __future__ import annotations

import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest
from packaging.requirements import Requirement

from fastgs_blender.jobs import environment, maker


@pytest.mark.parametrize(("index", "torch"), [("", False), ("", True), ("https://mirror/simple", True)])
def test_an_environment_gets_torch_where_it_is_wanted_and_the_small_one_where_it_is_offered(tmp_path, monkeypatch, index, torch):
    ran = []
    monkeypatch.setattr(maker.subprocess, "Popen", lambda command, **_: ran.append(command) or SimpleNamespace(
        poll=lambda: 0, returncode=0))
    making = maker.Maker(tmp_path / "made", tmp_path / "log", index, torch)
    while making.poll():
        pass
    made, plain, *rest = ran
    assert not making.failed and made[1:3] == ["-m", "venv"]
    assert set(maker.INSTALLED) <= set(plain) and not [part for part in plain if part.startswith("torch")]
    assert len(rest) == torch and all((index in command) == bool(index) for command in ran[1:])
    for command in rest:  # a user's own index is the only one that is asked
        assert command[-1].startswith("torch>=") and (maker.TORCH_INDEX in command) == (not index)


def test_its_versions_are_those_of_the_project():
    project = tomllib.loads((Path(__file__).resolve().parents[3] / "pyproject.toml").read_text("utf-8"))["project"]
    extras = project["optional-dependencies"]
    assert set(project["dependencies"]) <= set(maker.INSTALLED) <= {*project["dependencies"], *extras["train"]}
    assert maker.TORCH in extras["torch"]
    named = {Requirement(text).name for text in maker.INSTALLED}
    assert {*environment.NEEDED.values(), *environment.USEFUL} <= named

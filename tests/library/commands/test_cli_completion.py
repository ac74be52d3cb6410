# SPDX-License-Identifier: GPL-3.0-or-later
"""fastgs completion: the scripts are understood by their shells and offer what there is."""
from __future__ import annotations

import shutil
import subprocess

import pytest

from fastgs_blender import cli
from fastgs_blender.commands import COMMANDS

NAMES = {module.__name__.rpartition(".")[2] for module in COMMANDS}


def script(shell, capsys) -> str:
    assert cli.main(["completion", shell]) == 0
    return capsys.readouterr().out


@pytest.mark.skipif(not shutil.which("bash"), reason="bash is not installed")
def test_bash_completes_commands_options_choices_and_files(tmp_path, capsys):
    (tmp_path / "model.safetensors").touch()
    (tmp_path / "complete").write_text(script("bash", capsys))

    def completed(*words) -> list[str]:
        line = " ".join(f"'{word}'" for word in ("fastgs", *words))
        program = f"source ./complete; COMP_WORDS=({line}); COMP_CWORD={len(words)}; _fastgs; printf '%s\\n' \"${{COMPREPLY[@]}}\""
        result = subprocess.run(["bash", "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True)
        assert not result.stderr
        return result.stdout.split()

    assert set(completed("")) == NAMES | {"--help", "--version"}
    assert completed("ren") == ["render"]
    assert "--overwrite" in completed("render", "--o") and "--out" in completed("render", "--o")
    assert completed("train", "--preset", "dr") == ["draft"]
    assert completed("info", "mod") == ["model.safetensors"]
    assert completed("cameras", "x", "--move", "") [:3] == ["orbit", "dolly", "path"]


def test_other_shells(capsys):
    assert script("zsh", capsys).startswith("autoload") and "complete -o filenames -F _fastgs fastgs" in script("zsh", capsys)
    fish = script("fish", capsys)
    assert all(f"-a {name} -d '" in fish for name in NAMES) and "-l preset -x -a 'draft standard final paper stg'" in fish
    if shutil.which("fish"):
        assert subprocess.run(["fish", "--no-execute", "-c", fish], check=False).returncode == 0

# SPDX-License-Identifier: GPL-3.0-or-later
"""fastgs completion: bash completes commands, options, choices and files with the script that it prints."""
from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fastgs_blender import cli
from fastgs_blender.commands import COMMANDS

NAMES = {module.__name__.rpartition(".")[2] for module in COMMANDS}
ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.skipif(not shutil.which("bash"), reason="bash is not installed")
def test_bash_completes_commands_options_choices_and_files(tmp_path, capsys):
    (tmp_path / "model.safetensors").touch()
    assert cli.main(["completion", "bash"]) == 0
    (tmp_path / "complete").write_text(capsys.readouterr().out)
    (tmp_path / "fastgs").write_text(f"#!{sys.executable}\n# PYTHON_ARGCOMPLETE_OK\nfrom fastgs_blender.cli import main\nmain()\n")
    (tmp_path / "fastgs").chmod(0o755)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]), "PATH": f"{tmp_path}:{os.environ['PATH']}"}

    def completed(*words) -> list[str]:
        line = " ".join(("fastgs", *words))
        program = (f"source ./complete; COMP_LINE='{line}'; COMP_POINT={len(line)}; COMP_TYPE=9; COMP_WORDS=({line}); "
                   f"COMP_CWORD={len(words)}; _python_argcomplete fastgs; printf '%s\\n' \"${{COMPREPLY[@]}}\"")
        result = subprocess.run(["bash", "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
        return [word.strip() for word in result.stdout.split()]

    assert set(completed("")) >= NAMES
    assert completed("ren") == ["render"]
    assert {"--overwrite", "--out"} <= set(completed("render", "--o"))
    assert completed("train", "--preset", "dr") == ["draft"]
    assert "model.safetensors" in completed("info", "mod")


def test_without_its_package_one_sentence_says_so(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "argcomplete", None)
    assert cli.main(["completion", "fish"]) == cli.FAILED
    assert "argcomplete" in capsys.readouterr().err

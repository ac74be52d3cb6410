# SPDX-License-Identifier: GPL-3.0-or-later
"""The mode that refuses what Windows does not allow (FASTGS_WINDOWS_RULES=1) refuses it."""
from __future__ import annotations

import mmap
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import windows_rules

from fastgs_blender.formats.rounding import ldexp

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def _ours(monkeypatch):
    monkeypatch.setattr(windows_rules, "ours", lambda: True)


def test_what_is_open_is_neither_renamed_nor_deleted(tmp_path):
    path = tmp_path / "model.ply"
    path.write_bytes(b"ply")
    windows_rules.hook("os.remove", (str(path), -1))
    windows_rules.hook("os.rename", (str(path), str(tmp_path / "b"), -1, -1))
    with path.open("rb") as file:
        with pytest.raises(PermissionError, match="WinError 32"):
            windows_rules.hook("os.remove", (str(path), -1))
        with pytest.raises(PermissionError):
            windows_rules.hook("os.rename", (str(tmp_path / "b"), str(path), -1, -1))
        with pytest.raises(PermissionError):
            windows_rules.hook("os.rmdir", (str(tmp_path), -1))
        mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    with pytest.raises(PermissionError):
        windows_rules.hook("os.remove", (str(path), -1))
    mapped.close()
    windows_rules.hook("os.remove", (str(path), -1))


def test_names_that_windows_cannot_store_are_refused(tmp_path):
    (tmp_path / "Model.ply").write_bytes(b"")
    for name in "a:b.ply", "aux.txt", "end.", "what?":
        with pytest.raises(OSError, match="WinError 123"):
            windows_rules.hook("open", (str(tmp_path / name), "w", windows_rules.CREATE))
    with pytest.raises(AssertionError, match="capital letters"):
        windows_rules.hook("open", (str(tmp_path / "model.ply"), "w", windows_rules.CREATE))
    for name in "Model.ply", "other.ply":
        windows_rules.hook("open", (str(tmp_path / name), "w", windows_rules.CREATE))
    with pytest.raises(AssertionError, match="capital letters"):
        windows_rules.hook("os.mkdir", (str(tmp_path / "MODEL.PLY"), 0o777, -1))
    windows_rules.hook("os.rename", (str(tmp_path / "Model.ply"), str(tmp_path / "model.ply"), -1, -1))
    with pytest.raises(OSError, match="WinError 123"):  # and there is nothing to be read
        windows_rules.hook("open", (str(tmp_path / "a*.ply"), "r", 0))


def test_the_folders_of_the_root_are_drives(tmp_path):
    with pytest.raises(OSError, match="WinError 17"):
        windows_rules.hook("os.rename", (str(tmp_path / "a"), "/elsewhere/a", -1, -1))
    with pytest.raises(OSError, match="WinError 1314"):
        windows_rules.hook("os.symlink", ("a", str(tmp_path / "b"), -1))


ASKS = """
import os, sys
sys.path.insert(0, "tests/shared")
import windows_rules
windows_rules.install()
windows_rules.ours = windows_rules._from_us = lambda *_: True
def told(function, *arguments):
    try:
        return function(*arguments)
    except (OSError, ValueError) as error:
        return type(error).__name__
print(told(os.stat, "/tmp/a*b"), os.path.exists("/tmp/a*b"), told(os.stat, "/tmp") != "OSError")
print(told(os.path.relpath, "/tmp/a", "/etc"), told(os.path.relpath, "/tmp/a", "/tmp/b"), told(os.path.commonpath, ["/tmp/a", "/etc"]))
print(sys.stdout.encoding)
"""


def test_the_mode_is_switched_on(tmp_path):
    """Paths on several drives, names that cannot be asked for, and the letters of programs' output."""
    environment = {**os.environ, "FASTGS_WINDOWS_RULES": "1", "PYTHONIOENCODING": "cp1252"}
    lines = subprocess.run([sys.executable, "-c", ASKS], cwd=ROOT, env=environment, check=True, capture_output=True,
                           text=True).stdout.splitlines()
    assert lines == ["OSError False True", "ValueError ../a ValueError", "cp1252"]


def test_text_that_a_console_of_windows_lacks_is_an_error(monkeypatch):
    class Stream:
        errors = "strict"
        write = windows_rules._written(lambda self, text: len(text))

    assert Stream().write("naïve") == 5
    with pytest.raises(UnicodeEncodeError):
        Stream().write("→")
    monkeypatch.setattr(Stream, "errors", "backslashreplace")
    assert Stream().write("→") == 1


def test_powers_of_two_have_exponents_of_32_bits():
    """np.ldexp() takes C's long, which has 32 bits on Windows; formats/rounding.py gives it no more."""
    users = [file.name for folder in ("fastgs_blender", "scene", "engine", "operators", "ui") for file in (ROOT / folder).rglob("*.py")
             if "np.ldexp" in file.read_text("utf-8")]
    assert users == ["rounding.py"]
    assert ldexp(1.5, np.arange(3)).tolist() == [1.5, 3.0, 6.0]

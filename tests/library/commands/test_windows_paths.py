# SPDX-License-Identifier: GPL-3.0-or-later
"""What Windows gives the command line: drives, shares, and a console that lacks letters."""
import io

import pytest

from fastgs_blender.util.screen import tell


@pytest.mark.parametrize("path", [r"C:\films\a", "D:/films/a", r"\\server\films\a", "E:"])
@pytest.mark.posix
def test_a_drive_is_no_part_of_a_name(run, tmp_path, monkeypatch, path):
    """The sentence names the path as it was given: nothing is cut off at its colon."""
    monkeypatch.chdir(tmp_path)
    for command in ("info", path), ("convert", path, "a.ply"), ("check", path), ("train", path, "--out", "a"):
        code, _, errors = run(*command)
        assert code == 2 and f"{path}: " in errors


def test_what_a_console_lacks_is_told_in_escapes():
    written = io.TextIOWrapper(io.BytesIO(), encoding="cp1252", errors="strict")
    tell("a café → done", written)
    assert written.buffer.getvalue().decode("cp1252").rstrip() == r"a café \u2192 done"

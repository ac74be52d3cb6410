# SPDX-License-Identifier: GPL-3.0-or-later
"""The mode that refuses what Windows does not allow (FASTGS_WINDOWS_RULES=1) refuses it."""
from __future__ import annotations

import mmap

import pytest
import windows_rules


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

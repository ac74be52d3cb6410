# SPDX-License-Identifier: GPL-3.0-or-later
r"""Paths that files from outside state: what Windows would ask another machine for, or a device, is refused on every system."""
from __future__ import annotations

from pathlib import Path

import pytest

from fastgs_blender.util import stated_paths
from fastgs_blender.util.stated_paths import below, local

NETWORK = (r"\\host\share\a.png", "//host/share/a.png", r"\/host/share/a.png", r"/\host\share\a.png", r"\\?\C:\a.png",
           r"\\.\C:\a.png", r"\??\UNC\host\share\a.png", "/??/UNC/host/a.png", "//?/UNC/host/a.png")
NONE = ("", None, 5, ["a"], "a\0b", "a" * 5000)
HERE = Path("/captures/one")


@pytest.mark.parametrize("stated", NETWORK + NONE)
def test_networks_devices_and_what_is_no_path_are_refused(stated):
    assert local(HERE, stated) is None and below(HERE, stated) is None


@pytest.mark.parametrize("stated", ["../a.png", "a/../../b.png", "/etc/passwd", r"..\a.png", r"\etc\passwd", "C:/a.png", "C:a.png", "a//b",
                                    ".", "./", "a/"])
def test_what_leads_out_of_the_folder_is_refused_where_it_must_lie_below(stated):
    assert below(HERE, stated) is None
    assert local(HERE, stated) is not None


@pytest.mark.posix
def test_files_of_this_machine():
    assert below(HERE, r".\images\a.png") == local(HERE, "images/a.png") == HERE / "images" / "a.png"
    assert local(HERE, "/data/a.png") == Path("/data/a.png")
    assert local(HERE, "../two/a.png") == HERE / "../two/a.png"
    assert below(HERE, "12:30:05/a.png") is not None, "a colon is a letter here"


@pytest.mark.parametrize("stated", ["con", "NUL.png", "a/COM1.txt", "lpt9", r"a\aux .png", "conin$", "COM¹", "a.png:stream", "C:/a:b"])
def test_devices_and_streams_of_windows(stated, monkeypatch):
    monkeypatch.setattr(stated_paths, "WINDOWS", True)
    assert local(HERE, stated) is None and below(HERE, stated) is None
    assert local(HERE, "C:/contact/auxiliary.png") is not None and below(HERE, "console/com10.png") is not None

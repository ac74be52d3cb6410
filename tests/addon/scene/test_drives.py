# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths of Windows: drives, and what lies on another one."""
from __future__ import annotations

import os

import bpy
import pytest


@pytest.mark.parametrize(("path", "short"), [
    ("C:\\films\\", "C:\\films"), ("C:/films/", "C:/films"), ("D:\\", "D:\\"), ("D:/", "D:/"), ("/", "/"), ("//", "//"), ("", ""),
    ("\\\\server\\films\\", "\\\\server\\films"), ("//films/", "//films"), ("a", "a")])
def test_the_whole_of_a_drive_stays_one(module, path, short):
    assert module("scene.paths").bare(path) == short


def test_a_sequence_may_be_a_drive(module):
    """D: would be the folder that some program uses on D:, not its root."""
    paths = module("scene.paths")
    bpy.ops.cachefile.open(filepath="0001.ply")
    file = bpy.data.cache_files[-1]
    file[paths.SEQUENCE] = os.fsencode(paths.FOLDER)
    for first, folder in (("D:\\0001.ply", "D:\\"), ("D:\\clip\\0001.ply", "D:\\clip"), ("//0001.ply", "//")):
        file.filepath = first
        assert paths._path_of(file) == folder


def test_a_capture_on_a_drive_is_asked_for_by_its_name(module, fg):
    with pytest.raises(fg.FastGSError, match=r"D:\\.*no such capture"):
        module("scene.training.installation").capture_path("D:\\")


def test_a_file_on_another_drive_keeps_its_path(module, make_model, model_file, tmp_path, monkeypatch):
    def elsewhere(*_):
        raise ValueError("path is on mount 'D:', start on mount 'C:'")

    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    path = model_file(make_model())
    monkeypatch.setattr(bpy.path, "relpath", elsewhere)
    obj = module("scene.splats.splat_object").create(bpy.context, path, relative=True)
    assert module("scene.paths").get(obj.fastgs) == path

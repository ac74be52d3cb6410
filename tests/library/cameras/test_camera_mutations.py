# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged camera files: whatever cameras.json, a camera path or a COLMAP model holds, the answer is cameras or one sentence."""
from __future__ import annotations

import json
import zipfile
from pathlib import Path

import mutations
import numpy as np
import pytest
import tiny_captures

from fastgs_blender.cameras import colmap_files
from fastgs_blender.cameras.camera import Camera
from fastgs_blender.cameras.cameras_json import load_cameras
from fastgs_blender.cameras.paths import FORMATS, CameraPath, load_path, save_path
from fastgs_blender.cameras.paths.base import MOST_FRAMES
from fastgs_blender.util.errors import FastGSError


def finite(camera: Camera):
    assert np.isfinite(camera.world_to_camera).all() and camera.fx > 0 and camera.fy > 0 and np.isfinite([camera.cx, camera.cy]).all()


def path_of(frames: int) -> CameraPath:
    cameras = [Camera(64, 48, 60 + i, 60 + i, 32, 24, tiny_captures.pose(i)) for i in range(frames)]
    return CameraPath(cameras, 24, keys=[(0, cameras[0]), (frames - 1, cameras[-1])])


SUPERSPLAT = {"timeline": {"frames": 40, "frameRate": 20, "smoothness": 1, "loop": True}, "camera": {"fov": 60},
              "poseSets": [{"poses": [{"frame": 5 * i, "position": [i, 1, 3], "target": [0, 0.1 * i, 0], "fov": 50} for i in range(3)]}]}
NGP = {"loop": True, "time": 0.0, "spline_order": 3, "duration_seconds": 2, "path": [
    {"R": [0.1 * i, 0, 0, 1], "T": [0.5, i, 0.5], "fov": 50, "slice": 0, "scale": 1, "aperture_size": 0, "timestamp": 0.3 * (i + 1)}
    for i in range(3)]}


@pytest.mark.slow
@pytest.mark.parametrize("name", [module.name for module in FORMATS])
def test_damaged_paths(name, tmp_path):
    file = tmp_path / "made"
    save_path(path_of(4), file, name)
    files = tiny_captures.contents(file) if file.is_dir() else {"path.json": file.read_bytes()}
    seeds = {"saved": files}
    if name == "instant-ngp":
        seeds["splines"] = {"path.json": json.dumps(NGP).encode()}
    if name == "supersplat":
        with zipfile.ZipFile(tmp_path / "a.ssproj", "w") as archive:
            archive.writestr("document.json", json.dumps(SUPERSPLAT))
            archive.writestr("splats.ply", b"ply")
        seeds["project"] = {"path.json": (tmp_path / "a.ssproj").read_bytes()}
        seeds["document"] = {"path.json": json.dumps(SUPERSPLAT).encode()}

    def read(folder):
        found = load_path(folder if name == "colmap" else folder / "path.json")
        assert 1 <= len(found) <= MOST_FRAMES
        for camera in (*found.cameras, *(camera for _, camera in found.keys)):
            finite(camera)
        assert np.isfinite([frame for frame, _ in found.keys]).all()

    mutations.campaign(f"paths-{name}", read, seeds, tmp_path)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("path", "key"), [(NGP["path"], "T"), (SUPERSPLAT["poseSets"][0]["poses"], "position"),
                                           (SUPERSPLAT["poseSets"][0]["poses"], "target")])
def test_places_beyond_reason_are_refused(tmp_path, monkeypatch, path, key):
    monkeypatch.setitem(path[1], key, [0, 1e308, 0])
    (tmp_path / "path.json").write_text(json.dumps(NGP if path is NGP["path"] else SUPERSPLAT))
    with pytest.raises(FastGSError, match="farther than"):
        load_path(tmp_path / "path.json")


def test_damaged_cameras_json(tmp_path):
    save_path(path_of(2), tmp_path / "cameras.json", "cameras.json")

    def read(folder):
        for view in load_cameras(folder / "cameras.json"):
            finite(view.camera)
            assert isinstance(view.name, str)

    mutations.campaign("cameras.json", read, {"two": {"cameras.json": (tmp_path / "cameras.json").read_bytes()}}, tmp_path)


def test_damaged_colmap_models(tmp_path):
    seeds = {}
    for name, binary in (("text", False), ("binary", True)):
        tiny_captures.colmap_model(tmp_path / "made" / name, ["a/0001.png", "b/0001.png", "c.png"], binary)
        seeds[name] = tiny_captures.contents(tmp_path / "made" / name)

    def read(folder):
        for image in colmap_files.read_images(folder):
            assert np.isfinite(image.world_to_camera).all() and not Path(image.name).is_absolute() and min(image.camera.intrinsics[:2]) > 0
        points = colmap_files.read_points(folder)
        assert points is None or np.isfinite(points.xyz).all()

    mutations.campaign("colmap", read, seeds, tmp_path)

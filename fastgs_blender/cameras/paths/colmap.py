# SPDX-License-Identifier: GPL-3.0-or-later
"""A COLMAP model as a path: its images in the order of their names.  Written as text: cameras.txt, images.txt, points3D.txt."""
from __future__ import annotations

import warnings
from pathlib import Path

from ...util import rotations
from ...util.errors import FastGSError, LossWarning
from ...util.outputs import replacing
from ...util.stated_paths import below
from ..colmap_files import has_model, read_images
from ..lens import pinhole_for
from .base import CameraPath, refuse_orthographic

name, label = "colmap", "COLMAP model (folder)"
PLACES = ("", "sparse/0", "sparse")
FILES = (".json", ".txt", ".bin", ".zip", ".ssproj")
"""Endings of files' names."""


def folder_of(path: Path) -> Path | None:
    """The folder of a model, where `path` is one, one of its files, or a project's folder."""
    path = path if path.is_dir() else path.parent
    return next((path / place for place in PLACES if has_model(path / place)), None)


def load(folder: Path, values, picture) -> CameraPath:
    images = read_images(folder)
    if any(not image.camera.lens.is_pinhole for image in images):
        warnings.warn("the distortion of COLMAP's lenses is left out: these cameras are pinholes.", LossWarning, stacklevel=3)
    return CameraPath([pinhole_for(type(image.camera.lens)(), image.camera.intrinsics, image.world_to_camera) for image in images],
                      names=[image.name for image in images])


def _plain(name: str) -> str:
    """A name that can be a picture's in images.txt; raises FastGSError."""
    if name.split() != [name] or below(Path(), name) is None:
        raise FastGSError(f"a COLMAP model has no camera called {name!r}: a name there has no spaces, and is that of a picture.")
    return name


def save(path: CameraPath, folder, picture) -> None:
    refuse_orthographic(path, label)
    folder = Path(folder)
    if folder.is_file():
        raise FastGSError(f"{folder}: a COLMAP model is a folder; give the name of one.")
    if folder.suffix.lower() in FILES:
        raise FastGSError(f"{folder}: a COLMAP model is a folder; give a name without {folder.suffix}.")
    folder.mkdir(parents=True, exist_ok=True)
    names = [_plain(name) for name in path.names] or [f"frame_{path.start_frame + i:05d}.png" for i in range(len(path))]
    cameras: dict = {}
    images = ["# Image list with two lines of data per image:", "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
              "#   POINTS2D[] as (X, Y, POINT3D_ID)"]
    for i, camera in enumerate(path.cameras):
        key = camera.width, camera.height, *(float(v) for v in (camera.fx, camera.fy, camera.cx, camera.cy))
        number = cameras.setdefault(key, len(cameras) + 1)
        pose = camera.world_to_camera
        numbers = [repr(float(v)) for v in (*rotations.from_matrices(pose[:3, :3]), *pose[:3, 3])]
        images += [" ".join([f"{i + 1}", *numbers, f"{number}", names[i]]), ""]
    rows = [f"{number} PINHOLE {w} {h} {' '.join(map(repr, rest))}" for (w, h, *rest), number in cameras.items()]
    texts = {"cameras.txt": ["# Camera list with one line of data per camera:", "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]", *rows],
             "images.txt": images, "points3D.txt": ["# 3D point list: none"]}
    with replacing([folder / file for file in texts]) as parts:
        for part, lines in zip(parts, texts.values()):
            part.write_text("\n".join(lines) + "\n", encoding="utf-8")

# SPDX-License-Identifier: GPL-3.0-or-later
"""A COLMAP model as a path: its images in the order of their names.  Written in COLMAP's binary form: cameras, images, points3D (none).

In images.txt a name ends at its first blank (colmap, scene/reconstruction_io_text.cc); in images.bin it may have blanks.
"""
import struct
from pathlib import Path

from ...util import rotations
from ...util.errors import FastGSError
from ...util.outputs import replacing
from ...util.stated_paths import below
from ..colmap_files import MODELS, has_model, largest, read_images, read_points
from .base import CameraPath, Picture, frame_names, pinholes, warn_of_rate

name, label = "colmap", "COLMAP model (folder)"
PLACES = ("", "sparse/0", "sparse")
PARTS = tuple(f"{part}{ending}" for part in ("cameras", "images", "points3d", "frames", "rigs") for ending in (".txt", ".bin"))
"""The files of a model, in small letters."""
FILES = (".json", ".txt", ".bin", ".zip", ".ssproj")
"""Endings of files' names."""


def folder_of(path: Path) -> Path | None:
    """The folder of a model, where `path` is one, one of its files, or a project's folder."""
    path = path.parent if path.name.lower() in PARTS and not path.is_dir() else path
    return next((largest(path / place) if place else path for place in PLACES if has_model(path / place)), None)


def load(folder: Path, values: None, picture: Picture) -> CameraPath:
    images = read_images(folder)
    return CameraPath(pinholes([(image.camera.lens, image.camera.intrinsics, image.world_to_camera) for image in images], label),
                      names=[image.name for image in images])


def _plain(name: str) -> bytes:
    """A name that can be a picture's in images.bin; raises FastGSError."""
    found = below(Path(), name)
    if found is None or found.as_posix() != name:
        raise FastGSError(f"a COLMAP model has no camera called {name!r}: a name there is that of a picture, without \\, : and .. in it.")
    return name.encode("utf-8", "surrogateescape")


def save(path: CameraPath, folder: str | Path, picture: Picture) -> None:
    folder = Path(folder)
    if folder.is_file():
        raise FastGSError(f"{folder}: a COLMAP model is a folder; give the name of one.")
    if folder.suffix.lower() in FILES:
        raise FastGSError(f"{folder}: a COLMAP model is a folder; give a name without {folder.suffix}.")
    if has_model(folder) and read_points(folder) is not None:
        raise FastGSError(f"{folder}: there is a COLMAP model with points, which these cameras have none of; give another folder.")
    names = [_plain(name) for name in path.names] or [f"frame_{number}.png".encode() for number in frame_names(path)]
    warn_of_rate(path, label)
    cameras: dict[bytes, int] = {}
    images = []
    for i, camera in enumerate(path.cameras):
        lens = struct.pack("<iQQ4d", MODELS["PINHOLE"][0], camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
        number, pose = cameras.setdefault(lens, len(cameras) + 1), camera.world_to_camera
        images.append(struct.pack("<I7dI", i + 1, *rotations.from_matrices(pose[:3, :3]), *pose[:3, 3], number) + names[i] + bytes(9))
    lenses = [struct.pack("<I", number) + lens for lens, number in cameras.items()]
    files = {"cameras.bin": lenses, "images.bin": images, "points3D.bin": []}
    folder.mkdir(parents=True, exist_ok=True)
    with replacing([folder / file for file in files]) as parts:
        for part, records in zip(parts, files.values()):
            part.write_bytes(struct.pack("<Q", len(records)) + b"".join(records))

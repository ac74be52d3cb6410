# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera paths of other programs, and ours: load_path() and save_path().  A file is known by its content.

A format is one module with `name`, `label`, load(file, values, picture) -> CameraPath and save(path, file, picture), listed in FORMATS;
those that are JSON have recognises(values).
"""
import os
import zipfile
from pathlib import Path
from types import ModuleType

from ...util.errors import FastGSError
from ...util.reading import open_file, read_json, reading
from . import colmap, fastgs, inria, nerfstudio, ngp, supersplat, transforms
from .base import CameraPath, Picture

FORMATS: tuple[ModuleType, ...] = (fastgs, nerfstudio, ngp, supersplat, inria, colmap, transforms)
__all__ = ["FORMATS", "CameraPath", "Picture", "format_named", "load_path", "save_path"]


def load_path(file: str | os.PathLike, picture: Picture | None = None) -> CameraPath:
    """The camera path in a file, or in a folder with a COLMAP model.

    picture  size and frame rate for the formats that state none (instant-ngp, SuperSplat)
    Raises FastGSError where it cannot be read or is none.
    """
    path, picture = Path(os.fsdecode(file)), picture or Picture()
    with reading(path):
        folder = colmap.folder_of(path)
        if folder is not None:
            return colmap.load(folder, None, picture)
        if not path.exists():
            raise FastGSError(f"{path}: there is no such file; check the name.")
        if path.is_dir():
            raise FastGSError(f"{path}: there is no COLMAP model (cameras and images, .txt or .bin) in this folder.")
        values = supersplat.read_project(path) if _is_zip(path) else read_json(path)
        for module in FORMATS:
            if module is not colmap and module.recognises(values):
                return module.load(path, values, picture)
        if isinstance(values, dict) and str(values.get("format", "")).startswith("fast-gs capture"):
            raise FastGSError(f"{path}: this describes the cameras and pictures of a capture, and no camera path; import it with Capture "
                              "Cameras, or write its cameras with fastgs cameras.")
    labels = ", ".join(module.label for module in FORMATS)
    raise FastGSError(f"{path}: this is no camera path known here; there are {labels}.")


def _is_zip(path: Path) -> bool:
    with open_file(path) as file:
        return zipfile.is_zipfile(file)


def format_named(name: str) -> ModuleType:
    """The format of that name; raises FastGSError."""
    for module in FORMATS:
        if module.name == name:
            return module
    raise FastGSError(f"there is no camera path format {name!r}; there are {', '.join(module.name for module in FORMATS)}.")


def save_path(path: CameraPath, file: str | Path, name: str = "fastgs", picture: Picture | None = None) -> None:
    """Write a camera path in the format of that name, aside and renamed.

    A LossWarning says what the format cannot hold.  Raises FastGSError where the file cannot be written.
    """
    module = format_named(name)
    try:
        if any(camera.orthographic for camera in path.cameras):
            raise FastGSError(f"{module.label} holds perspective cameras only; set the camera to Perspective.")
        module.save(path, file, picture or Picture())
    except FastGSError as error:
        raise error if str(file) in str(error) else FastGSError(f"{file}: {error}") from error
    except OSError as error:
        raise FastGSError(f"{file}: it cannot be written ({error.strerror or error}); choose another place.") from error

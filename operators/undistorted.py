# SPDX-License-Identifier: GPL-3.0-or-later
"""Copies of a capture's pictures without their lenses' distortion: Blender's cameras have none, so only these lie where they should."""
from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

from ..engine.settings import EXTENSION
from ..fastgs_blender.captures import decoding
from ..fastgs_blender.captures.framefiles import default_folder, digest
from ..fastgs_blender.captures.sources import Source
from ..fastgs_blender.errors import FastGSError

QUALITY = 95


def write(manager: bpy.types.WindowManager, capture, shots: list) -> dict:
    """Write these shots as JPEG pictures of their pinhole cameras into the extension's folder, where they are not there yet.

    manager shows the progress.  Returns the shots whose image is the copy, by the originals.  Raises FastGSError.
    """
    folder = Path(bpy.utils.extension_path_user(EXTENSION, path=f"undistorted/{default_folder(capture).name}", create=True))
    places: dict[str, Path] = {}
    for shot in shots:
        if shot.view not in places:  # other files, another lens or scale: another folder
            places[shot.view] = folder / f"{re.sub(r'[^A-Za-z0-9_-]+', '_', shot.view)}-{digest(shot, capture.scale)[:8]}"
    files = {shot: places[shot.view] / f"{shot.frame + 1:05d}.jpg" for shot in shots}
    missing = [shot for shot, file in files.items() if not file.exists()]
    manager.progress_begin(0, len(missing))
    try:
        for place in places.values():
            place.mkdir(exist_ok=True)
        for i, (shot, pixels) in enumerate(decoding.decode(missing, capture.scale)):
            if isinstance(pixels, FastGSError):
                raise pixels
            _save(files[shot], pixels)
            manager.progress_update(i)
    except OSError as error:
        raise FastGSError(f"{folder}: undistorted pictures cannot be written there ({error.strerror}); free some space, or set Backgrounds "
                          "to Files.") from error
    finally:
        manager.progress_end()
    return {shot: replace(shot, image=Source(file)) for shot, file in files.items()}


def _save(file: Path, pixels: np.ndarray) -> None:
    from PIL import Image

    rgb = pixels[..., :3]
    part = file.with_suffix(".part")
    Image.fromarray(np.ascontiguousarray(rgb if rgb.dtype == np.uint8 else np.uint8(rgb >> 8))).save(part, format="JPEG", quality=QUALITY)
    part.replace(file)

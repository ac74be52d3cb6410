# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes copies of a capture's pictures without the distortion of their lenses, because Blender's cameras have none.

They are JPEG files, or PNG where pictures have alpha.
"""
import re
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import replace
from pathlib import Path
from threading import Event

import bpy
import numpy as np

from ...fastgs_blender.captures.pixels import decoding, probe
from ...fastgs_blender.captures.pixels.framefiles import default_folder, digest
from ...fastgs_blender.captures.sources import Source
from ...fastgs_blender.util import threads
from ...fastgs_blender.util.errors import FastGSError
from ..settings import EXTENSION

QUALITY = 95
MOST_AT_ONCE = 8
"""Films that are read side by side: each holds some pictures in memory."""


def steps(capture, shots: list) -> Iterator[tuple[int, int]]:
    """Write these shots as pictures of their pinhole cameras into the extension's folder, where they are not there yet.

    Yields (those that are there, all) several times a second; ending it early ends the writing.  Returns the shots whose image is
    the copy, by the originals.  Raises FastGSError.
    """
    folder = Path(bpy.utils.extension_path_user(EXTENSION, path=f"undistorted/{default_folder(capture).name}", create=True))
    places: dict[str, Path] = {}
    for shot in shots:
        if shot.view not in places:  # other files, another lens or scale: another folder
            places[shot.view] = folder / f"{re.sub(r'[^A-Za-z0-9_-]+', '_', shot.view)}-{digest(shot, capture.scale)[:8]}"
    files = {shot: places[shot.view] / f"{shot.frame + 1:05d}{'.png' if probe.facts(shot.image).alpha else '.jpg'}" for shot in shots}
    missing: dict[str, list] = {}
    for shot, file in files.items():
        if not file.exists():
            missing.setdefault(shot.view, []).append(shot)
    try:
        for place in places.values():
            place.mkdir(exist_ok=True)
        kept = len(shots) - sum(map(len, missing.values()))
        for written in _written(list(missing.values()), files, capture.scale):
            yield kept + written, len(shots)
    except OSError as error:
        raise FastGSError(f"{folder}: undistorted pictures cannot be written there ({error.strerror}); free some space, or set Backgrounds "
                          "to Files.") from error
    return {shot: replace(shot, image=Source(file)) for shot, file in files.items()}


def _written(views: list[list], files: dict, scale: float) -> Iterator[int]:
    """Each view's film is decoded once, in order; several views go side by side.  Yields how many pictures are written."""
    stopped, done = Event(), [0] * len(views)

    def work(number):
        for shot, pixels in decoding.decode(views[number], scale):
            if stopped.is_set():
                return
            if isinstance(pixels, FastGSError):
                raise pixels
            _save(files[shot], pixels)
            done[number] += 1

    with ThreadPoolExecutor(min(threads.thread_count(), MOST_AT_ONCE), thread_name_prefix="undistorted") as pool:
        pending = {pool.submit(work, number) for number in range(len(views))}
        try:
            while pending:
                ended, pending = wait(pending, timeout=0.1, return_when=FIRST_COMPLETED)
                for future in ended:
                    future.result()
                yield sum(done)
        finally:
            stopped.set()
            for future in pending:
                future.cancel()


def _save(file: Path, pixels: np.ndarray) -> None:
    from PIL import Image

    with_alpha = file.suffix == ".png"
    chosen = pixels[..., [0, 1, 2, -1]] if with_alpha else pixels[..., :3]  # of masks and alpha, alpha is the last
    part = file.with_suffix(".part")
    picture = Image.fromarray(np.ascontiguousarray(chosen if chosen.dtype == np.uint8 else np.uint8(chosen >> 8)))
    picture.save(part, **(dict(format="PNG") if with_alpha else dict(format="JPEG", quality=QUALITY)))
    part.replace(file)

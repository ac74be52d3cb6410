# SPDX-License-Identifier: GPL-3.0-or-later
"""Shows a run in Blender's editors: its last preview and its loss as images, its log as a text.

Nothing here gets a fake user: what no editor shows is not saved with the .blend.
"""
import os
from pathlib import Path

import bpy
import bpy.utils.previews
import numpy as np

from ...fastgs_blender.jobs.job import Job
from ...fastgs_blender.training.run.files import CONSOLE, PLOT, PREVIEWS
from ...fastgs_blender.util.errors import FastGSError, printable_lines
from ...fastgs_blender.util.identity import status_of
from ...fastgs_blender.util.reading import open_file
from .. import arrays

PREVIEW, LOSS, LOG = "FAST-GS Training", "FAST-GS Training Loss", "FAST-GS Training Log"
MOST_TEXT = 200_000
_files: dict[str, tuple] = {}
"""By name of an image or text: the file that it shows."""
_icons = None
"""Blender's collection of pictures as icons, made when it is needed."""


def update(job: Job) -> None:
    """Let the images and the text follow the run's files, where those have changed."""
    out = Path(job.out)
    picture = max((out / PREVIEWS).glob("*.png"), default=None)
    for name, path in ((PREVIEW, picture), (LOSS, out / PLOT)):
        if path is not None and _changed(name, path):
            _show_image(name, path)
    console = out / CONSOLE
    if _changed(LOG, console):
        _show_text(LOG, _end_of(console))


def icons_of(path: Path) -> list[int]:
    """The numbers of icons that show the halves of a preview picture, the model and the truth; [] where it cannot be read.

    Not to be called while a panel is drawn.
    """
    global _icons
    try:
        image = bpy.data.images.load(str(path), check_existing=False)
    except RuntimeError:
        return []
    pixels = arrays.pixels(image)
    bpy.data.images.remove(image)
    if _icons is None:
        _icons = bpy.utils.previews.new()
    _icons.clear()
    found = []
    for name, half in zip(("model", "truth"), np.array_split(pixels, 2, axis=1)):
        icon = _icons.new(name)
        icon.image_size = half.shape[1::-1]
        icon.image_pixels_float.foreach_set(np.ascontiguousarray(half).ravel())
        found.append(icon.icon_id)
    return found


def unregister() -> None:
    """Free the icons."""
    global _icons
    if _icons is not None:
        bpy.utils.previews.remove(_icons)
    _icons = None


def _changed(name, path: Path) -> bool:
    present = name in (bpy.data.texts if name == LOG else bpy.data.images)
    before = _files.get(name)
    try:
        _files[name] = str(path), status_of(str(path))
    except FastGSError:  # it is not there yet
        return False
    return not present or _files[name] != before


def _show_image(name, path: Path):
    image = bpy.data.images.get(name)
    if image is None:
        try:
            image = bpy.data.images.load(str(path))
        except RuntimeError:  # it cannot be read; the next one may
            return
        image.name = name
    else:
        image.filepath = str(path)
        image.reload()


def _show_text(name, content: str):
    text = bpy.data.texts.get(name)
    if text is None:
        text = bpy.data.texts.new(name)
        text.use_fake_user = False
    text.from_string(content)


def _end_of(path: Path) -> str:
    """The last MOST_TEXT bytes of a file as text."""
    with open_file(path) as file:
        file.seek(max(file.seek(0, os.SEEK_END) - MOST_TEXT, 0))
        return printable_lines(file.read(MOST_TEXT).decode("utf-8", "replace").replace("\r", "\n"))

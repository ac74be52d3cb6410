# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender's editors show of a run: its last preview and its loss as images, its log as a text.

Nothing here gets a fake user: what no editor shows is not saved with the .blend.
"""
from __future__ import annotations

from pathlib import Path

import bpy

from ...fastgs_blender.jobs.queue import CONSOLE, PLOT, Job

PREVIEW, LOSS, LOG = "FAST-GS Training", "FAST-GS Training Loss", "FAST-GS Training Log"
MOST_TEXT = 200_000
_times: dict[str, tuple[str, float]] = {}


def update(job: Job) -> None:
    """Let the images and the text follow the run's files, where those have changed."""
    out = Path(job.out)
    picture = max((out / "previews").glob("*.png"), default=None)
    for name, path in ((PREVIEW, picture), (LOSS, out / PLOT)):
        if path is not None and _changed(name, path):
            _show_image(name, path)
    console = out / CONSOLE
    if _changed(LOG, console):
        _show_text(LOG, console.read_text("utf-8", "replace")[-MOST_TEXT:])


def _changed(name, path: Path) -> bool:
    try:
        now = str(path), path.stat().st_mtime
    except OSError:
        return False
    present = name in (bpy.data.texts if name == LOG else bpy.data.images)
    if present and _times.get(name) == now:
        return False
    _times[name] = now
    return True


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

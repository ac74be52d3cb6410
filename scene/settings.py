# SPDX-License-Identifier: GPL-3.0-or-later
"""Holds the extension's preferences for code that must not use Blender's context, and sets up the log."""
import contextlib
import logging
from collections import deque
from pathlib import Path

import bpy

from ..fastgs_blender.kernels.cpu import cache

EXTENSION = __package__.rpartition(".")[0]
"""The extension's module, as Blender names it."""

BLEND_RELATIVE = {'PATH_SUPPORTS_BLEND_RELATIVE'} if bpy.app.version >= (4, 5, 0) else set()
"""Options of a property that holds a path which may begin with //; earlier versions of Blender do not know the flag."""

threads = 0
"""Threads for rendering where the scene does not say; 0: all processors."""
gpu = ""
"""The name of the GPU that scenes with the device GPU use; empty: `auto`, a GPU that is faster than the processor."""


class RecentLines(logging.Handler):
    """Keeps the last lines of the log, for diagnostics."""

    def __init__(self):
        super().__init__()
        self.lines: deque[str] = deque(maxlen=60)
        self.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))

    def emit(self, record):
        self.lines.append(self.format(record))


recent = RecentLines()
console = logging.StreamHandler()  # Python prints warnings by itself only where nothing else handles them
console.setFormatter(logging.Formatter("FAST-GS %(levelname)s: %(message)s"))


def apply(preferences) -> None:
    """Take over the preferences; the cache folder counts for kernels that are not loaded yet."""
    global threads, gpu
    threads, gpu = preferences.threads, preferences.gpu
    cache.use_folder(kernel_folder(preferences))
    logging.getLogger(EXTENSION).setLevel(preferences.log_level)


def kernel_folder(preferences=None) -> Path:
    """Where compiled kernels go: the user's choice, else the extension's own folder for data."""
    if preferences and preferences.cache_folder:
        return Path(bpy.path.abspath(preferences.cache_folder))
    return Path(bpy.utils.extension_path_user(EXTENSION, path="kernels"))


def preferences():
    """The extension's preferences, or None where Blender has none (it is registered, but not enabled as an add-on)."""
    addon = bpy.context.preferences.addons.get(EXTENSION)
    return addon.preferences if addon else None


def register():
    for handler in (recent, console):
        logging.getLogger(EXTENSION).addHandler(handler)
    with contextlib.suppress(ValueError):  # not loaded as an extension: the library's own place
        cache.use_folder(kernel_folder())


def unregister():
    for handler in (recent, console):
        logging.getLogger(EXTENSION).removeHandler(handler)

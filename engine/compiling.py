# SPDX-License-Identifier: GPL-3.0-or-later
"""Compile the renderer's kernels ahead of the first picture, in a process of their own: Blender stays responsive.

Kernels land in the cache folder, where the first render finds them.  If anything goes wrong here, that render compiles them.
"""
import importlib.util
import logging
import subprocess
import time

import bpy

from ..fastgs_blender.kernels.cpu import aside, cache
from ..fastgs_blender.util.processes import hidden

log = logging.getLogger(__name__)
TEXT = "FAST-GS compiles its renderer for this machine, once; pictures can be made after some ten seconds"
_process: subprocess.Popen | None = None


def has_numba() -> bool:
    """Whether the fast renderer can run here at all; without numba, NumPy renders, slowly."""
    return importlib.util.find_spec("numba") is not None


def is_running() -> bool:
    """Whether kernels are being compiled just now."""
    return _process is not None and _process.poll() is None


def is_first_due() -> bool:
    """Whether what a first picture needs is being compiled just now; the rest follows behind it."""
    return is_running() and not cache.has_first()


def start() -> bool:
    """Compile the kernels unless they are there, or under way; returns whether compilation has begun."""
    global _process
    if not has_numba() or cache.is_filled() or is_running():
        return False
    try:
        _process = subprocess.Popen(aside.command("all"), env=aside.environment(), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                    stderr=subprocess.PIPE, **hidden())
    except OSError as error:
        log.warning("The renderer cannot be compiled ahead (%s); the first render will do it.", error)
        return False
    log.info(TEXT)
    if not bpy.app.background:
        _show(TEXT)
        bpy.app.timers.register(_watch, first_interval=0.5, persistent=True)
    return True


def start_on_first_use():
    """To be called when splats come into a scene: compile in the background, if there is a user to wait for it."""
    if not bpy.app.background:
        start()


def wait(timeout: float | None = None) -> bool:
    """Wait for a compilation under way; returns whether kernels are there."""
    if _process is not None:
        _process.wait(timeout)
    return cache.is_filled()


def wait_for_first():
    """Wait until a first picture can be made, or the compilation has ended."""
    while is_first_due():
        time.sleep(0.05)


def stop():
    """End a compilation under way."""
    global _process
    if bpy.app.timers.is_registered(_watch):
        bpy.app.timers.unregister(_watch)
        _show(None)
    if is_running():
        _process.terminate()
        _process.wait()
    _process = None


def _watch():
    if is_running():
        return 0.5
    _show(None)
    if _process is not None and _process.returncode:
        last = (_process.stderr.read().decode(errors="replace").strip().splitlines() or ["no reason given"])[-1]
        log.warning("Compiling the renderer ahead failed (%s); the first render will do it.", last)
    return None


def _show(text: str | None):
    """The status bar's text in all windows."""
    for window in bpy.context.window_manager.windows:
        with bpy.context.temp_override(window=window):  # a timer may have none, and Blender crashes without one
            window.workspace.status_text_set(text)

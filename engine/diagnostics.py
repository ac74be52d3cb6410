# SPDX-License-Identifier: GPL-3.0-or-later
"""Collects what a report of a problem should contain."""
import os
import platform
from importlib.metadata import PackageNotFoundError, version

import bpy

from ..fastgs_blender import __version__
from ..fastgs_blender.kernels.cpu import cache
from ..fastgs_blender.util.errors import printable, printable_lines
from ..fastgs_blender.util.threads import thread_count
from ..scene import devices, objects, settings
from . import compiling
from .viewport.spaces import viewports

PACKAGES = ("numpy", "numba", "llvmlite", "safetensors", "OpenEXR", "wgpu", "torch")


def text() -> str:
    """Versions, machine, graphics card, renderer, splat objects, the viewport's stages and the last lines of the log, one fact a line."""
    lines = [
        f"FAST-GS for Blender {__version__}",
        f"Blender {bpy.app.version_string}, Python {platform.python_version()}, {platform.platform()}, {os.cpu_count()} processors",
        "packages: " + ", ".join(f"{name} {_version(name)}" for name in PACKAGES),
        f"graphics: {_graphics()}",
        f"backend: {'cpu' if compiling.has_numba() else 'reference (numba is missing)'}, {thread_count()} threads",
        f"GPUs: {_gpus()}",
        f"kernels: {'compiled' if cache.is_filled() else 'not compiled'}, {cache.size() / 1e6:.1f} MB in {cache.folder()}",
    ]
    for obj in bpy.data.objects:
        if objects.is_splat(obj):
            state = objects.error_of(obj) or f"{obj.fastgs.gaussian_count:,} Gaussians"
            lines.append(f'object "{obj.name}": {obj.fastgs.filepath}: {state}')
    lines += _stages()
    return "\n".join([*map(printable, lines), "log:", *map(printable_lines, settings.recent.lines or ["(empty)"]), ""])


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "-"


def _stages() -> list[str]:
    """How long the stages of a viewport's picture take here; a viewport must have drawn splats."""
    try:
        lines = viewports.timed()
    except Exception as error:  # noqa: BLE001 (a driver raises anything, which is what such a report is about)
        return [f"viewport: could not be timed ({type(error).__name__}: {error})"]
    return lines or ["viewport: has not drawn splats"]


def _gpus() -> str:
    """The GPUs of this machine on one line, each with the result of its self-test, and which one `auto` means."""
    known = devices.found()
    if known is None:
        return "not looked for yet"
    said = {None: "not tested", "": "passed"}
    each = [f"{each['name']} ({each['interface']}, {each['driver']}): {said.get(each['self_test'], each['self_test'])}"
            for each in known["devices"]]
    return ", ".join([*each, f"automatic: {known['reason']}"])


def _graphics() -> str:
    if bpy.app.background:
        return "none (background)"
    import gpu

    p = gpu.platform
    return f"{p.vendor_get()} {p.renderer_get()} {p.version_get()} ({p.backend_type_get()})"

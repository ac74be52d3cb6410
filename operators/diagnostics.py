# SPDX-License-Identifier: GPL-3.0-or-later
"""What a report of a problem should contain, and what a Python has for training."""
from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

import bpy

from ..engine import compiling, objects, settings
from ..fastgs_blender import __version__
from ..fastgs_blender.kernels import cache
from ..fastgs_blender.kernels.threads import thread_count

PACKAGES = ("numpy", "numba", "llvmlite", "safetensors", "OpenEXR", "torch")
TRAINING = ("torch", "numpy", "numba", "av", "pycolmap", "OpenEXR")
_ASK = """
import json, sys
from importlib.metadata import PackageNotFoundError, version
def v(name):
    try: return version(name)
    except PackageNotFoundError: return None
print(json.dumps({"python": sys.version.split()[0], "packages": {n: v(n) for n in %r}}))
"""


@dataclass(frozen=True)
class TrainingPython:
    """What a Python answered: its version and its packages' (None: not installed), or why it did not answer."""

    python: str = ""
    packages: dict | None = None
    problem: str = ""

    @property
    def missing(self) -> list[str]:
        return [name for name, found in (self.packages or {}).items() if found is None]

    @property
    def complete(self) -> bool:
        return not self.problem and not self.missing

    def __str__(self):
        if self.problem:
            return self.problem
        have = ", ".join(f"{name} {found}" for name, found in self.packages.items() if found)
        lacking = f"; missing: {', '.join(self.missing)}" if self.missing else ""
        return f"Python {self.python} has {have or 'none of the packages'}{lacking}"


def ask_python(path: str) -> TrainingPython:
    """Ask the Python at a path ("": Blender's own) for the packages that training needs."""
    path = path or sys.executable
    try:
        result = subprocess.run([path, "-c", _ASK % (TRAINING,)], capture_output=True, text=True, timeout=60, check=True)
        answer = json.loads(result.stdout)
        return TrainingPython(answer["python"], answer["packages"])
    except (OSError, subprocess.SubprocessError, ValueError, KeyError) as error:
        return TrainingPython(problem=f"{path} did not answer as a Python does ({type(error).__name__})")


def text() -> str:
    """Versions, machine, graphics card, renderer, splat objects and the last lines of the log, one fact a line."""
    lines = [
        f"FAST-GS for Blender {__version__}",
        f"Blender {bpy.app.version_string}, Python {platform.python_version()}, {platform.platform()}, {os.cpu_count()} processors",
        "packages: " + ", ".join(f"{name} {_version(name)}" for name in PACKAGES),
        f"graphics: {_graphics()}",
        f"backend: {'cpu' if compiling.has_numba() else 'reference (numba is missing)'}, {thread_count()} threads",
        f"kernels: {'compiled' if cache.is_filled() else 'not compiled'}, {cache.size() / 1e6:.1f} MB in {cache.folder()}",
    ]
    for obj in bpy.data.objects:
        if objects.is_splat(obj):
            state = objects.error_of(obj) or f"{obj.fastgs.gaussian_count:,} Gaussians"
            lines.append(f'object "{obj.name}": {obj.fastgs.filepath}: {state}')
    return "\n".join([*lines, "log:", *(settings.recent.lines or ["(empty)"])]) + "\n"


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "-"


def _graphics() -> str:
    if bpy.app.background:
        return "none (background)"
    import gpu

    p = gpu.platform
    return f"{p.vendor_get()} {p.renderer_get()} {p.version_get()} ({p.backend_type_get()})"

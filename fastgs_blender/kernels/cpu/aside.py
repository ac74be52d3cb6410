# SPDX-License-Identifier: GPL-3.0-or-later
"""A second process that compiles some kernels while this one compiles the others.  Does not import numba.

numba compiles one function at a time in a process, and a first picture needs three that take long.  The second process does the same
work (warm.py), but runs no kernel: it compiles those of KERNELS that it meets, and passes by all others.
"""
from __future__ import annotations

import os
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

from ...util.processes import hidden
from ...util.threads import thread_count
from . import cache

KERNELS = {"project", "rasterise", "project_backward"}
"""Names of the kernels that the second process compiles: about half of the time, and none is needed at once."""
VARIABLE = "FASTGS_COMPILE_ASIDE"
"""The environment variable that says so to the second process."""
_process: subprocess.Popen | None = None

# Compiled code refers to its modules by name, so they must have the names there that they have here, and the same files, wherever Python
# would look.  What else an extension consists of cannot be imported without Blender: empty packages stand for it.
_CHILD = """
import importlib.util, os, sys, types
package, folder, program, work = sys.argv[1:]
names = package.split(".")[:-2]
for i in range(1, len(names)):
    sys.modules[".".join(names[:i])] = types.ModuleType(names[i - 1])
file = os.path.join(folder, "__init__.py")
spec = importlib.util.spec_from_file_location(".".join(names), file, submodule_search_locations=[folder])
library = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(library)
importlib.import_module(f"{package}.{program}").WORK[work]()
"""


def command(work: str) -> list[str]:
    """The command line of a process that does a work of warm.py, with modules of the same names and files as here."""
    return [sys.executable, "-c", _CHILD, __package__, str(Path(__file__).parents[2]), "warm", work]  # warm.py imports this module


def environment() -> dict[str, str]:
    """Its environment variables."""
    return {**os.environ, "FASTGS_CACHE_DIR": str(cache.base_folder()), "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}


def is_here() -> bool:
    """Whether this is the second process."""
    return VARIABLE in os.environ


def begin(work: str) -> None:
    """Start a second process for a work of warm.py: once for each cache, and not where there is one thread."""
    global _process
    if is_here() or is_running() or thread_count() < 2 or getattr(sys, "frozen", False):  # then sys.executable is no Python
        return
    with suppress(OSError):
        cache.folder().mkdir(parents=True, exist_ok=True)
        (cache.folder() / f"aside-{work}").touch(exist_ok=False)
        _process = subprocess.Popen(command(work), env={**environment(), VARIABLE: "1"}, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
                                    stderr=subprocess.DEVNULL, **hidden())


def end_with_parent() -> None:
    """In the second process: end when the first one does.  Not by sys.stdin, whose lock Python wants at its end."""
    threading.Thread(target=lambda: (os.read(0, 1), os._exit(0)), daemon=True).start()


def is_running() -> bool:
    """Whether the second process is at work."""
    return _process is not None and _process.poll() is None


def is_compiling(name: str) -> bool:
    """Whether the second process has compiled a kernel of this name, or will."""
    return name in KERNELS and is_running()

# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's folders for the user's data, the training jobs in them, and the Python that trains."""
import importlib.util
import sys
import tempfile
from pathlib import Path

import bpy

from ...fastgs_blender.jobs.environment import NEEDED, USEFUL, Report, purposes, python_in
from ...fastgs_blender.jobs.queue import Jobs
from ...fastgs_blender.util.errors import FastGSError
from .. import paths, settings

maker = None
"""The jobs.maker.Maker that makes an environment, or made one last, in this Blender; None where there was none."""
tested: dict[str, Report] = {}
"""By Python: what its last test in this Blender found."""


def folder(name: str) -> Path:
    """A folder of the extension for the user's data; it is not created."""
    try:
        return Path(bpy.utils.extension_path_user(settings.EXTENSION, path=name))
    except ValueError:  # not loaded as an extension
        return Path(tempfile.gettempdir(), "fastgs-blender", name)


def jobs() -> Jobs:
    """The user's training jobs."""
    return Jobs(folder("training/jobs"))


def capture_path(path: str) -> str:
    """The path of a capture that a user chose, absolute; raises FastGSError where none is chosen or nothing is there."""
    path = paths.bare(bpy.path.abspath(path))
    if not path:
        raise FastGSError("no capture is chosen; choose its folder.")
    if not Path(path).exists():
        raise FastGSError(f"{path}: there is no such capture; check the folder.")
    return path


def made_environment() -> Path:
    """The folder of the environment for training that the preferences' button makes."""
    return folder("training/environment")


def python() -> str:
    """The training Python as the preferences have it; raises FastGSError where there is none."""
    preferences = settings.preferences()
    chosen = bpy.path.abspath(preferences.training_python) if preferences and preferences.training_python else ""
    if preferences and preferences.training_choice == 'CHOSEN':
        found = python_in(chosen) if chosen else None
        if found is None:
            raise FastGSError(f"there is no Python at {chosen or 'the chosen place'}; choose an environment's folder or its python "
                              "program in the preferences.")
        return found
    if not is_making() and (found := python_in(str(made_environment()))):
        return found
    if lacking := [package for module, package in NEEDED.items() if importlib.util.find_spec(module) is None]:
        raise FastGSError(f"Blender's own Python lacks {', '.join(lacking)}; install the extension's zip for this system and Python "
                          f"{sys.version_info[0]}.{sys.version_info[1]}, which brings them and needs no network, or choose an environment "
                          "that has them in the preferences.")
    return sys.executable


def trouble() -> str:
    """Why nothing can be trained, in one sentence; "" where nothing is known to be wrong with the training Python."""
    try:
        report = tested.get(python())
    except FastGSError as error:
        return str(error)
    return "" if report is None or report.ready else report.sentence


def lacking() -> str:
    """A sentence on what captures may need that the training Python lacks, as far as that is known without starting it; "" where it
    lacks nothing."""
    try:
        chosen = python()
    except FastGSError:
        return ""
    if chosen in tested:
        missing = tested[chosen].missing
    elif chosen == sys.executable:
        missing = {name for name in USEFUL if importlib.util.find_spec(name) is None}
    else:
        return ""
    purpose = purposes(missing)
    return f"Captures in this Python: {purpose}. Choose a Python that has it in the preferences." if purpose else ""


def is_making() -> bool:
    """Whether an environment is being made just now."""
    return maker is not None and maker.poll()


def unregister():
    """Stop making an environment when the extension is disabled; training jobs continue."""
    global maker
    if maker is not None:
        maker.stop()
    maker = None

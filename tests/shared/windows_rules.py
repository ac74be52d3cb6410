# SPDX-License-Identifier: GPL-3.0-or-later
"""What Windows does not allow, refused here too: with FASTGS_WINDOWS_RULES=1 in all rings, for what our own code does.

* A file that this process has open, or has mapped into memory, is neither renamed, replaced nor deleted, nor is a folder with it.
* No file is made with a name that Windows cannot store, or beside one whose name differs by case alone.
* Programs that are started write cp1252, where they do not choose otherwise.

The rules are an audit hook of Python.  It asks whose code is at work, so tests themselves may do what they like.
"""
from __future__ import annotations

import os
import re
import sys
from pathlib import Path

OURS = re.compile(r"[/\\](fastgs_blender|scene|engine|operators|ui)[/\\](?!.*[/\\]tests[/\\])")
FORBIDDEN = re.compile(r'[<>:"|?*]|[. ]$|^(con|prn|aux|nul|com\d|lpt\d)(\.|$)', re.IGNORECASE)
CREATE = os.O_CREAT
OTHERWISE_THERE = ("/fastgs_blender/util/locks.py",)
"""Modules that do something else on Windows, by their own words."""
CHANGES = {"os.rename": 2, "os.remove": 1, "os.rmdir": 1}
"""Audit events that take a name away, and how many of their arguments are names."""
_asking = False


def install() -> None:
    """From now on, in this process; where FASTGS_WINDOWS_RULES is set."""
    if os.environ.get("FASTGS_WINDOWS_RULES") == "1":
        os.environ["PYTHONIOENCODING"] = "cp1252"  # of programs that are started
        sys.addaudithook(hook)


def hook(event: str, arguments: tuple) -> None:
    """Raise what Windows raises."""
    global _asking
    if _asking or (event != "open" and event not in CHANGES):
        return
    _asking = True
    try:
        if event == "open":
            path, _, flags = arguments
            if isinstance(path, str | bytes | os.PathLike) and isinstance(flags, int) and flags & CREATE and ours():
                named(os.fspath(path))
        elif ours():
            count = CHANGES[event]
            for path, folder in zip(arguments[:count], arguments[count:], strict=False):
                free(path, folder)
    finally:
        _asking = False


def ours() -> bool:
    """Whether the code at work, seen through Python's own library, is the extension's or the library's."""
    frame = sys._getframe(2)
    while frame is not None:
        name = frame.f_code.co_filename
        if not name.startswith((STDLIB, "<frozen")) or "site-packages" in name:
            return bool(OURS.search(name)) and "site-packages" not in name and not name.endswith(OTHERWISE_THERE)
        frame = frame.f_back
    return False


STDLIB = os.path.dirname(os.__file__)


def free(path, folder: int = -1) -> None:
    """Raise PermissionError where a file, or one in a folder, is open or mapped."""
    path = os.fsdecode(path)
    place = os.path.realpath(path if folder < 0 else os.path.join(os.readlink(f"/proc/self/fd/{folder}"), path))
    for other in sorted(busy()):
        if other == place or other.startswith(place + os.sep):
            raise PermissionError(13, "The process cannot access the file because it is being used by another process (WinError 32)", path)


def busy() -> set[str]:
    """The files that this process has open or mapped."""
    found = set()
    for number in os.listdir("/proc/self/fd"):
        try:
            found.add(os.readlink(f"/proc/self/fd/{number}"))
        except OSError:
            continue
    for line in Path("/proc/self/maps").read_text("utf-8", "replace").splitlines():
        found.add(line[73:])
    return {name for name in found if name.startswith("/") and os.path.isfile(name)}


def named(path: str) -> None:
    """Raise OSError where Windows could not make a file of this name, or would take it for another."""
    folder, name = os.path.split(os.fsdecode(path))
    if FORBIDDEN.search(name):
        raise OSError(22, "The filename, directory name, or volume label syntax is incorrect (WinError 123)", path)
    try:
        others = os.listdir(folder or ".")
    except OSError:
        return
    if name not in others and name.casefold() in map(str.casefold, others):
        raise AssertionError(f"{path}: another file has this name, but for capital letters")

# SPDX-License-Identifier: GPL-3.0-or-later
"""What Windows does not allow, refused here too: with FASTGS_WINDOWS_RULES=1 in all rings, for what our own code does.

* A file that this process has open, or has mapped into memory, is neither renamed, replaced nor deleted, nor is a folder with it.
* No file or folder is made with a name that Windows cannot store, or beside one whose name differs by case alone.  Asking for such a
  name is an error, not an absence.
* The folders of / are drives: nothing is moved or linked from one to another, and no relative path leads there.
* Links are for administrators.
* The console writes cp1252, that of programs that are started too, where they do not choose otherwise.

Most of it is an audit hook of Python.  It asks whose code is at work, so tests themselves may do what they like.
"""
from __future__ import annotations

import os
import re
import sys
from functools import wraps
from pathlib import Path

OURS = re.compile(r"^(?!.*[/\\]tests[/\\]).*[/\\](fastgs_blender|scene|engine|operators|ui)[/\\]")
FORBIDDEN = re.compile(r'[<>:"|?*]|[. ]$|^(con|prn|aux|nul|com\d|lpt\d)(\.|$)', re.IGNORECASE)
CREATE = os.O_CREAT
ON = os.environ.get("FASTGS_WINDOWS_RULES") == "1"
OTHERWISE_THERE = ("/fastgs_blender/util/locks.py",)
"""Modules that do something else on Windows, by their own words."""
CHANGES = {"os.rename": 2, "os.remove": 1, "os.rmdir": 1}
"""Audit events that take a name away, and how many of their arguments are names."""
MADE = {"os.rename": 1, "os.mkdir": 0, "os.link": 1}
"""Audit events that make a name, and which of their arguments it is."""
STDLIB = os.path.dirname(os.__file__)
_asking = False


def install() -> None:
    """From now on, in this process; where FASTGS_WINDOWS_RULES is set."""
    if not ON:
        return
    os.environ["PYTHONIOENCODING"] = "cp1252"  # of programs that are started
    sys.addaudithook(hook)
    os.stat, os.lstat = _asked(os.stat), _asked(os.lstat)
    os.path.relpath, os.path.commonpath = _on_one_drive(os.path.relpath), _on_one_drive(os.path.commonpath)
    if "_pytest" in sys.modules:
        from _pytest import capture

        for kind in capture.EncodedFile, capture.CaptureIO:
            kind.encoding = property(lambda self: "cp1252")
            kind.write = _written(kind.write)


def hook(event: str, arguments: tuple) -> None:
    """Raise what Windows raises."""
    global _asking
    if _asking or (event not in ("open", "os.symlink") and event not in CHANGES and event not in MADE):
        return
    _asking = True
    try:
        if event == "open":
            path, _, flags = arguments
            if isinstance(path, str | bytes | os.PathLike) and isinstance(flags, int) and ours():
                named(os.fspath(path), bool(flags & CREATE))
        elif ours():
            if event == "os.symlink":
                raise OSError(1, "A required privilege is not held by the client (WinError 1314)", arguments[1])
            if event in ("os.rename", "os.link") and drive(arguments[0]) != drive(arguments[1]):
                raise OSError(18, "The system cannot move the file to a different disk drive (WinError 17)", arguments[0])
            count = CHANGES.get(event, 0)
            for path, folder in zip(arguments[:count], arguments[count:], strict=False):
                free(path, folder)
            if event in MADE and arguments[-1] < 0:
                named(os.fspath(arguments[MADE[event]]), True, () if event != "os.rename" else (arguments[0],))
    finally:
        _asking = False


def ours(depth: int = 2) -> bool:
    """Whether the code at work, seen through Python's own library, is the extension's or the library's."""
    frame = sys._getframe(depth)
    while frame is not None:
        name = frame.f_code.co_filename
        if not name.startswith((STDLIB, "<frozen")) or "site-packages" in name:
            return bool(OURS.search(name)) and "site-packages" not in name and not name.endswith(OTHERWISE_THERE)
        frame = frame.f_back
    return False


def drive(path) -> str:
    """The folder of / that a path leads into, as if it were a drive."""
    return os.path.abspath(os.fsdecode(path)).split(os.sep)[1]


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


def named(path: str, made: bool = True, gone: tuple = ()) -> None:
    """Raise OSError where Windows has no file of this name or, if it is made, would take it for another than those that are gone."""
    folder, name = os.path.split(os.fsdecode(path))
    if FORBIDDEN.search(name) and name not in (os.curdir, os.pardir):
        error = OSError(22, "The filename, directory name, or volume label syntax is incorrect (WinError 123)", path)
        error.winerror = 123  # pathlib looks at it
        raise error
    if not made:
        return
    try:
        others = set(os.listdir(folder or ".")) - {os.path.basename(os.fsdecode(each)) for each in gone}
    except OSError:
        return
    if name not in others and name.casefold() in map(str.casefold, others):
        raise AssertionError(f"{path}: another file has this name, but for capital letters")


def _asked(status):
    """os.stat() or os.lstat(), to which a name that cannot be is an error of its own."""
    @wraps(status)
    def asked(path, *arguments, **options):
        if isinstance(path, str | bytes | os.PathLike) and not _asking and ours():
            named(os.fspath(path), False)
        return status(path, *arguments, **options)

    for kinds in os.supports_fd, os.supports_dir_fd, os.supports_follow_symlinks:
        if status in kinds:
            kinds.add(asked)
    return asked


def _on_one_drive(function):
    """A function of paths that has no answer where they lie on several drives."""
    @wraps(function)
    def on_one(path, start=os.curdir):
        paths = [path, start or os.curdir] if isinstance(path, str | bytes | os.PathLike) else list(path)
        if len({drive(each) for each in paths}) > 1 and _from_us():
            raise ValueError(f"path is on mount {drive(paths[0])!r}, start on mount {drive(paths[-1])!r}")
        return function(path) if function.__name__ == "commonpath" else function(path, start)

    return on_one


def _from_us() -> bool:
    """Whether our code asked for this, be it through Blender's own Python."""
    frame = sys._getframe(2)
    while frame is not None:
        if OURS.search(frame.f_code.co_filename) and "site-packages" not in frame.f_code.co_filename:
            return True
        frame = frame.f_back
    return False


def _written(write):
    """write() of a stream, which has the letters of cp1252 alone; others are escaped on standard error, and where it was told to."""
    @wraps(write)
    def written(self, text):
        if ours() and self is not sys.stderr and self.errors != "backslashreplace":
            text.encode("cp1252")
        return write(self, text)

    return written

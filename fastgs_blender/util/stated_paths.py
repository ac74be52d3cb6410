# SPDX-License-Identifier: GPL-3.0-or-later
r"""Paths that files from outside state, such as the pictures of a capture or the buffers of a glTF.

A file may come from a stranger.  On Windows, opening \\host\share\x tells that host the user's name and a hash of the password, and CON or
COM1 are devices in every folder.  So a stated path is taken only where it is a file of this machine.
"""
import os
import re
from pathlib import Path

LONGEST = 4096
"""Letters of a path."""
WINDOWS = os.name == "nt"
DRIVE = re.compile(r"[A-Za-z]:")
ELSEWHERE = re.compile(r"//|/\?\?")
r"""How paths of networks and devices begin, once \ is /: \\host\share, \\?\..., \\.\..., \??\..."""
DEVICES = re.compile(r"(con|prn|aux|nul|conin\$|conout\$|(com|lpt)[0-9¹²³]) *(\..*)?", re.IGNORECASE)
"""Names that are devices on Windows, whatever ending and spaces follow."""


def local(folder: Path, stated: object) -> Path | None:
    """The path on this machine's disks that is stated in a file of that folder; `..` and absolute paths may lead elsewhere.

    None where it is no text, or names a file of a network or a device.
    """
    if not isinstance(stated, str) or not 0 < len(stated) <= LONGEST or "\0" in stated:
        return None
    path = stated.replace("\\", "/")
    if ELSEWHERE.match(path):
        return None
    inner = path[2:] if DRIVE.match(path) else path
    if WINDOWS and (":" in inner or any(DEVICES.fullmatch(part) for part in inner.split("/"))):
        return None
    return folder / path


def below(folder: Path, stated: object) -> Path | None:
    """The path of a file beside or below the folder's others that is stated in one of them; None where it is anything else."""
    path = local(folder, stated)
    if path is None or not isinstance(stated, str) or DRIVE.match(stated):
        return None
    parts = [part for part in stated.replace("\\", "/").split("/") if part != "."]
    if not parts or any(part in ("", "..") for part in parts):
        return None
    return folder.joinpath(*parts)

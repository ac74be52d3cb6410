# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps the paths of splat files in datablocks of Blender's own kind for files outside, cache files.

So everything in Blender that looks after paths knows them: the first save makes them relative, saving elsewhere, appending and linking
keep them right, and External Data's Make Relative, Make Absolute, Report Missing and Find Missing do what they do for images.
Blender opens such a file only if it is Alembic's or USD's, and packs none.  Of a sequence, whose path is a folder or a pattern of names
and no file, the datablock names the first file, and a property of it says what that file stands for.

The functions import bpy when they are called, for the reason that updates.py gives.
"""
import os
from pathlib import Path

from ..fastgs_blender.formats.sequences import numbered_files, stands_for_many
from ..fastgs_blender.formats.streamed_sog import parted
from ..fastgs_blender.util.errors import FastGSError

SEQUENCE = "fastgs_sequence"
"""Custom property of a cache file that names the first file of a sequence: the pattern in that file's folder, or FOLDER; as bytes."""
FOLDER = "."


def get(settings) -> str:
    """The path that an object's settings (FASTGS_PG_object) hold; "" where there is none."""
    return "" if settings.file is None else _path_of(settings.file)


def shown(settings) -> str:
    """The same for the panel: Blender shows no text that is not UTF-8, which file names of Linux may not be."""
    return get(settings).encode("utf-8", "backslashreplace").decode()


def put(settings, path: str) -> None:
    """Let an object show the file at a path, absolute or beginning with // for the .blend's folder; "" for none."""
    import bpy

    path = bare(path)
    before = settings.file
    if before is None or _path_of(before) != path:
        settings.file = _of(path) if path else None
        if before is not None and not before.users and before.library is None:
            bpy.data.batch_remove([before])
    settings.id_data.update_tag()


def _of(path: str):
    """The cache file of a path; a new one where there is none."""
    import bpy

    files = bpy.data.cache_files
    found = next((file for file in files if file.library is None and _path_of(file) == path), None)
    if found is None:
        there = set(files)
        bpy.ops.cachefile.open(filepath=bpy.path.basename(path))  # gives it its name; the operator takes no // path
        found = next(file for file in files if file not in there)
        found.filepath, pattern = _first(path)
        if pattern:
            found[SEQUENCE] = os.fsencode(pattern)
        found.user_clear()  # the operator counts a user that it does not have
    return found


def _path_of(file) -> str:
    """The path that a cache file stands for."""
    path, pattern = file.filepath, file.get(SEQUENCE)
    if pattern is None:
        return path
    folder, _ = _parted(path)
    return bare(folder) if os.fsdecode(pattern) == FOLDER else folder + os.fsdecode(pattern)


def _first(path: str) -> tuple[str, str]:
    """(a path as Blender looks after it, the pattern in its folder or FOLDER): of a sequence the path of the first file, of a level that of
    its lod-meta.json; else "" """
    import bpy

    there = bpy.path.abspath(path)
    file, level = parted(Path(there))
    if level is not None:
        folder, name = _parted(path)
        return folder + file.name, name
    if not stands_for_many(there):
        return path, ""
    try:
        first = numbered_files(Path(there), below=False)[0][1].name
    except (FastGSError, OSError):  # whoever reads the sequence says why
        return path, ""
    if os.path.isdir(there):
        return path.rstrip("/\\") + "/" + first, FOLDER
    folder, pattern = _parted(path)
    return folder + first, pattern


def bare(path: str) -> str:
    r"""A path without / or \ at its end; the whole of a disk keeps it: on Windows, D: is another folder than D:\."""
    short = path.rstrip("/\\")
    return path if not short or short.endswith(":") else short


def _parted(path: str) -> tuple[str, str]:
    """The folder, with what divides it from the name, and the name; // at the beginning stays whole on every system."""
    end = max(path.rfind("/"), path.rfind("\\")) + 1
    return path[:end], path[end:]

# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps the paths of splat files in datablocks of Blender's own kind for files outside, cache files.

So everything in Blender that looks after paths knows them: the first save makes them relative, saving elsewhere, appending and linking
keep them right, and External Data's Make Relative, Make Absolute, Report Missing and Find Missing do what they do for images.
Blender opens such a file only if it is Alembic's or USD's, and packs none.

The functions import bpy when they are called, for the reason that updates.py gives.
"""
from __future__ import annotations

KEY = "filepath"
"""Where earlier versions stored the path, in the object's own property."""


def get(settings) -> str:
    """The path that an object's settings (FASTGS_PG_object) hold; "" where there is none."""
    return settings.file.filepath if settings.file is not None else _earlier(settings)


def shown(settings) -> str:
    """The same for the panel: Blender shows no text that is not UTF-8, which file names of Linux may not be."""
    return get(settings).encode("utf-8", "backslashreplace").decode()


def put(settings, path: str) -> None:
    """Let an object show the file at a path, absolute or beginning with // for the .blend's folder; "" for none."""
    import bpy

    before = settings.file
    if before is None or before.filepath != path:
        settings.file = _of(path) if path else None
        if before is not None and not before.users and before.library is None:
            bpy.data.batch_remove([before])
    _forget_earlier(settings)
    settings.id_data.update_tag()


def upgrade() -> None:
    """Take over the paths that an earlier version stored in the open .blend."""
    import bpy

    for obj in bpy.data.objects:
        _take_over(obj, None)


def after_import(context, _=None) -> None:
    """The same for what was appended: a path beginning with // is one beside the .blend that it comes from."""
    import bpy

    for item in context.import_items:
        if isinstance(item.id, bpy.types.Object) and item.source_library:
            _take_over(item.id, bpy.path.abspath(item.source_library.filepath))


def _take_over(obj, source):
    import os

    import bpy

    path = _earlier(obj.fastgs) if obj.is_editable and obj.fastgs.file is None else ""
    if path:
        put(obj.fastgs, path if source is None else os.path.normpath(bpy.path.abspath(path, start=os.path.dirname(source))))


def _of(path: str):
    """The cache file of a path; a new one where there is none."""
    import bpy

    files = bpy.data.cache_files
    found = next((file for file in files if file.library is None and file.filepath == path), None)
    if found is None:
        there = set(files)
        bpy.ops.cachefile.open(filepath=bpy.path.basename(path))  # gives it its name; the operator takes no // path
        found = next(file for file in files if file not in there)
        found.filepath = path
        found.user_clear()  # the operator counts a user that it does not have
    return found


def _stored(settings):
    return settings.bl_system_properties_get() if hasattr(settings, "bl_system_properties_get") else settings


def _earlier(settings) -> str:
    stored = _stored(settings)
    return "" if stored is None else stored.get(KEY, "")


def _forget_earlier(settings):
    stored = _stored(settings)
    if stored is not None and KEY in stored:
        del stored[KEY]

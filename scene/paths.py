# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps relative paths right when objects or .blend files move.  Blender does this for its own datablocks, not for an add-on's."""
from __future__ import annotations

import os

import bpy
from bpy.app.handlers import persistent

from . import objects

_before: list[tuple[bpy.types.Object, str]] = []
"""Objects whose paths were rewritten for the save that is under way, and what they held before."""


def rebased(path: str, old: str, new: str) -> str:
    """A `//` path beside the .blend file `old`, as it must read beside the .blend file `new`."""
    target = bpy.path.abspath(path, start=os.path.dirname(old))
    try:
        return bpy.path.relpath(target, start=os.path.dirname(new))
    except ValueError:  # on another drive
        return os.path.normpath(target)


def _relative():
    return [obj for obj in bpy.data.objects if obj.is_editable and obj.fastgs.filepath.startswith("//")]


@persistent
def before_save(target, _=None):
    """Save As, and saving a copy, into another folder."""
    _before.clear()
    current = bpy.data.filepath
    if current and os.path.dirname(current) != os.path.dirname(target):
        for obj in _relative():
            _before.append((obj, obj.fastgs.filepath))
            obj.fastgs.filepath = rebased(obj.fastgs.filepath, current, target)


@persistent
def after_save(target, _=None):
    """After a copy was written, or nothing at all, the open file stays what it was."""
    if bpy.data.filepath != target:
        for obj, path in _before:
            obj.fastgs.filepath = path
    _before.clear()


@persistent
def after_import(context, _=None):
    """Append from a .blend in another folder.  (Linked objects keep to their library's folder.)"""
    for item in context.import_items:
        obj = item.id
        if isinstance(obj, bpy.types.Object) and obj.library is None and item.source_library and objects.is_splat(obj):
            _move_here(obj, bpy.path.abspath(item.source_library.filepath))


@persistent
def after_update(_, depsgraph):
    """Append in Blender 4.2, which does not announce it: the object's mesh remembers the library that it came from."""
    for update in depsgraph.updates:
        obj = update.id.original
        if not (isinstance(obj, bpy.types.Object) and obj.library is None and obj.data and objects.is_splat(obj)):
            continue
        origin = obj.data.library_weak_reference
        if origin and not os.path.exists(objects.abspath(obj)):
            source = bpy.path.abspath(origin.filepath)
            if os.path.exists(bpy.path.abspath(obj.fastgs.filepath, start=os.path.dirname(source))):
                _move_here(obj, source)


def _move_here(obj, source: str):
    path = obj.fastgs.filepath
    if not path.startswith("//"):
        return
    if bpy.data.filepath:
        obj.fastgs.filepath = rebased(path, source, bpy.data.filepath)
    else:
        obj.fastgs.filepath = os.path.normpath(bpy.path.abspath(path, start=os.path.dirname(source)))

# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds splat objects and holds the models that they show in memory.

An object stores a path; the models live here, once for each file, and are dropped when no object shows them any more.
"""
import logging
import os
import threading
from dataclasses import dataclass

import bpy
from mathutils import Matrix

from .. import fastgs_blender as fg
from ..fastgs_blender.formats.sequences import place_of
from ..fastgs_blender.model.chapters import Chapters
from ..fastgs_blender.model.gaussians import Clip
from ..fastgs_blender.model.sequence import FreeClip, Sequence, Source
from ..fastgs_blender.util.identity import status_of
from ..fastgs_blender.util.reading import reading
from . import parts, paths

log = logging.getLogger(__name__)

MESHABLE = ('MESH', 'CURVE', 'SURFACE', 'FONT', 'META')
"""Types of objects that have triangles."""
SURFACES = (*MESHABLE, 'CURVES', 'POINTCLOUD', 'VOLUME')
"""Types of objects that are seen in renders, and can hide splats."""


@dataclass
class _Entry:
    """A file that was read: its status then, and its model or sequence, or the sentence that says why it has none."""

    status: tuple
    model: Source | None = None
    error: str | None = None


_entries: dict[str, _Entry] = {}
_earlier: dict[str, Source] = {}
"""What a file held before it was read again, for parts that are carried over (carrying.py)."""
_loading: dict[str, threading.Lock] = {}
_watched: set[str] = set()
_lock = threading.Lock()
_reloads = 0


def axes_matrix(axes: str) -> Matrix:
    """4 x 4 rotation from a model's axes ('RDF', 'RFU' or 'RUB') to Blender's: what an importer gives the object."""
    return {
        'RFU': Matrix.Identity(4),
        'RDF': Matrix(((1, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1))),
        'RUB': Matrix(((1, 0, 0, 0), (0, 0, -1, 0), (0, 1, 0, 0), (0, 0, 0, 1))),
    }[axes]


def is_splat(obj: bpy.types.Object | None) -> bool:
    """Whether an object shows a splat file."""
    return obj is not None and bool(paths.get(obj.fastgs))


def select_only(context, *chosen: bpy.types.Object) -> None:
    """Select these objects and no others; the first becomes the active one."""
    for obj in context.view_layer.objects.selected:
        obj.select_set(False)
    for obj in chosen:
        obj.select_set(True)
    context.view_layer.objects.active = chosen[0]


def check_editable(obj: bpy.types.Object, done: str) -> None:
    """Raise FastGSError, which says what cannot be done, where an object is linked from another file."""
    if not obj.is_editable:
        raise fg.FastGSError(f'"{obj.name}" is linked from another file and cannot be {done}; make it local, or an override.')


def duplicate(context, obj: bpy.types.Object) -> bpy.types.Object:
    """A copy of an object, which shows the same file by the same proxy; it is selected alone."""
    made = obj.copy()
    for collection in obj.users_collection:
        collection.objects.link(made)
    select_only(context, made)
    return made


def instances_splats(obj: bpy.types.Object) -> bool:
    """Whether an object that shows no splats may instance objects that do: by its collection, or by Geometry Nodes."""
    if is_splat(obj):
        return False
    if obj.instance_type == 'COLLECTION' and obj.instance_collection is not None:
        return any(is_splat(other) for other in obj.instance_collection.all_objects)
    return any(m.type == 'NODES' for m in obj.modifiers) and any(is_splat(other) for other in bpy.data.objects)


def abspath(obj: bpy.types.Object) -> str:
    """Absolute path of an object's file, "" where it shows none; `//` is the folder of the .blend that the path comes from."""
    path = paths.get(obj.fastgs)
    if not path:
        return ""
    origin = obj.original
    if origin.override_library:
        origin = origin.override_library.reference
    return _key(bpy.path.abspath(path, library=(origin.fastgs.file or origin).library))


def load_model(path: str) -> Source:
    """The model of a file, or the sequence that a path stands for, from memory where the file has not changed since it was read.

    Safe to call from several threads.  Raises FastGSError for a file that is missing or cannot be read; a broken file is
    not read again before it changes or reload() is called.
    """
    global _reloads
    path = _key(path)
    with _lock:
        loading = _loading.setdefault(path, threading.Lock())
    with loading:
        before = entry = _entries.get(path)
        if entry is None or entry.status != status_of(place_of(path)):
            entry = _read(path)
            with _lock:
                if before is not None and before.model is not None and entry.model is not None and path in _watched:
                    _earlier.setdefault(path, before.model)
                _entries[path] = entry
                _reloads += before is not None
    if entry.model is None:
        raise fg.FastGSError(entry.error)
    return entry.model


def watch(path: str) -> None:
    """Keep the earlier model of a file that is read again by itself, because something marks its Gaussians."""
    _watched.add(_key(path))


def earlier(path: str) -> Source | None:
    """What a file held when something of it was marked: the model that load_model() found last, or the one before that was replaced since
    reload() was called; None where neither is in memory.  Forgets it."""
    path = _key(path)
    with _lock:
        known = _entries.get(path)
        return _earlier.pop(path, None) or (known.model if known else None)


def source_of(obj: bpy.types.Object) -> Source:
    """What an object shows of its file: all, or its part, as a model of its own.  Raises FastGSError as load_model() and part_of() do."""
    return parts.part_of(load_model(abspath(obj)), obj.fastgs.part)


def load_one_model(obj: bpy.types.Object, done: str) -> fg.GaussianModel:
    """The whole model of an object's file.  Raises FastGSError where it cannot be read, or is a sequence, of which this cannot be done."""
    path = abspath(obj)
    model = load_model(path)
    if not isinstance(model, fg.GaussianModel):
        what = "clip in chapters" if isinstance(model, Chapters) else "sequence"
        raise fg.FastGSError(f"{path}: Gaussians of a {what} cannot be {done}; turn it into one model with fastgs convert.")
    return model


def is_sequence(obj: bpy.types.Object) -> bool:
    """Whether an object shows a model of its own on each frame, as far as is known without reading its file."""
    entry = _entries.get(abspath(obj))
    return entry is not None and isinstance(entry.model, Sequence) and not isinstance(entry.model, Chapters)


def clip_of(obj: bpy.types.Object) -> Clip:
    """The clip of an object's file, from what the object knows of it."""
    settings = obj.fastgs
    return Clip(settings.frame_count, settings.fps) if settings.fps else FreeClip(settings.frame_count)


def error_of(obj: bpy.types.Object) -> str | None:
    """Why an object cannot be shown, as a sentence, or None where nothing is known to be wrong.  Its file is not read.

    Cheap enough for a panel's draw().
    """
    path = abspath(obj)
    if not path:
        return None
    try:
        status = status_of(place_of(path))
    except fg.FastGSError as error:
        return str(error)
    entry = _entries.get(path)
    if entry is None or entry.status != status:
        return None
    return entry.error or parts.trouble(entry.model, obj.fastgs.part)


def reloads() -> int:
    """How often a file was, or is to be, read again.  Code that keeps models calls load_model() again when this number changes."""
    return _reloads


def reload(path: str):
    """Forget what is known of a file; the next load_model() reads it again."""
    global _reloads
    _reloads += 1
    with _lock:
        _entries.pop(_key(path), None)


def drop_unused():
    """Free the models, and the parts, that no object of the open file shows."""
    shown = [obj for obj in bpy.data.objects if is_splat(obj)]
    used = {abspath(obj) for obj in shown}
    parts.forget_all_but({obj.fastgs.part for obj in shown})
    with _lock:
        for known in (_entries, _earlier):
            for path in known.keys() - used:
                del known[path]


def clear():
    """Free all models."""
    with _lock:
        _entries.clear()
        _earlier.clear()
        _watched.clear()
        _loading.clear()


def loaded_bytes() -> int:
    """Bytes of the models in memory."""
    with _lock:
        return sum(e.model.nbytes for e in _entries.values() if e.model)


def _key(path: str) -> str:
    return os.path.normpath(os.path.abspath(path))


def _read(path: str) -> _Entry:
    status = status_of(place_of(path))
    try:
        with reading(path):
            return _Entry(status, model=fg.open_source(path))
    except fg.FastGSError as error:
        if error.__cause__ is not None:
            log.info("%s", error, exc_info=error.__cause__)
        return _Entry(status, error=str(error))

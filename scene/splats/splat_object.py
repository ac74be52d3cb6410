# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes splat objects and lets them follow their files; import, bake and reload use it."""
from pathlib import Path

import bpy
import numpy as np

from ...fastgs_blender.formats import fingerprint, identify
from ...fastgs_blender.formats.sequences import title
from ...fastgs_blender.model.sequence import Source
from ...fastgs_blender.util.errors import FastGSError, printable
from .. import model_space, objects, paths, upright
from . import proxy


def sentence(error: Exception) -> str:
    """An error's message as a report shows it: it begins with a capital and can be printed."""
    text = printable(error)
    return text[:1].upper() + text[1:]


def create(context, path: str, limit: int = proxy.LIMIT, orient: bool = True, relative: bool = False,
           up: str | None = None) -> bpy.types.Object:
    """A new object that shows the file, selected and active, at the world's origin; its clip starts with the scene.

    limit     the most points of its proxy
    orient    turn its model from the file's axes to Blender's; the object itself stays unrotated
    relative  keep the path relative to the .blend, where that is possible
    up        the axis that points up in a file that does not say it, a key of upright.TURNS; None: as is usual in its format

    Raises FastGSError for a file that cannot be read, before anything is made.
    """
    path = bpy.path.abspath(path)
    model = objects.load_model(path)
    name = printable(title(Path(path)))
    turn = np.array(objects.axes_matrix(model.axes), np.float64) if orient else np.eye(4)
    if up is not None and not says_axes(path, model):
        turn[:3, :3] = upright.TURNS[up]
    obj = bpy.data.objects.new(name, proxy.new_mesh(name, model, limit, turn))
    proxy.show_in_all_engines(obj)
    paths.put(obj.fastgs, _relative(path) if relative else path)
    obj.fastgs.start_frame = context.scene.frame_start
    write_facts(obj, model, path)
    _place(context, obj)
    return obj


def says_axes(path: str, model: Source) -> bool:
    """Whether a file says which of its axes points up; others have the axes that are usual in captures."""
    return model.axes != "RDF" or identify(path).says_axes


def write_facts(obj: bpy.types.Object, model: Source, path: str) -> None:
    """Store what panels show of a file on the object.  Raises FastGSError where the file cannot be read."""
    settings = obj.fastgs
    settings.gaussian_count = len(model)
    settings.frame_count = model.clip.frame_count
    settings.fps = 0.0 if model.clip.free else model.clip.fps
    settings.has_backdrop = model.surroundings.backdrop is not None
    settings.camera_count = len(model.surroundings.cameras)
    settings.file_hash = fingerprint(path)


def show_file(obj: bpy.types.Object, path: str) -> None:
    """Let an object show another file, its path relative to the .blend where it was.  Raises FastGSError as refresh() does."""
    before = paths.get(obj.fastgs)
    paths.put(obj.fastgs, _relative(path) if before.startswith("//") else path)
    try:
        refresh(obj)
    except FastGSError:
        paths.put(obj.fastgs, before)
        raise


def refresh(obj: bpy.types.Object) -> None:
    """Let an object's facts and proxy follow its file.  Raises FastGSError, and changes nothing, where the file cannot be read."""
    path = objects.abspath(obj)
    model = objects.source_of(obj)
    if not obj.is_editable:
        return
    write_facts(obj, model, path)
    if obj.type == 'MESH' and obj.data.is_editable:
        turn, limit = model_space.model_matrix(obj), proxy.limit_of(obj.data)
        if obj.data.users > 1:  # the others may show another file
            obj.data = proxy.new_mesh(obj.data.name, model, limit, turn)
        else:
            proxy.fill(obj.data, model, limit, turn)
    obj.update_tag()


def _relative(path: str) -> str:
    if not bpy.data.filepath:
        return path
    try:
        return bpy.path.relpath(path)
    except ValueError:  # on another drive
        return path


def _place(context, obj: bpy.types.Object) -> None:
    """Link the object where the user works, and make it the only selected one."""
    layer = context.view_layer
    active = layer.active_layer_collection
    usable = active.is_visible and not active.exclude and active.collection.is_editable
    (active.collection if usable else context.scene.collection).objects.link(obj)
    space = context.space_data
    if space and space.type == 'VIEW_3D' and space.local_view:
        obj.local_view_set(space, True)
    for other in layer.objects.selected:
        other.select_set(False)
    obj.select_set(True)
    layer.objects.active = obj

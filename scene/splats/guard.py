# SPDX-License-Identifier: GPL-3.0-or-later
"""Protects proxies against Blender's operators: restores deleted or moved points, converted and joined meshes, and reports it.

An extension cannot forbid an operator.  So after each evaluation the splat objects whose meshes changed are examined.  Points that were
deleted or moved are restored, converted meshes become proxies again, and joined objects are separated.
"""
from dataclasses import dataclass

import bmesh
import bpy
import numpy as np
from bpy.app.handlers import persistent
from mathutils import Matrix

from ...fastgs_blender.util.errors import FastGSError
from .. import arrays, model_space, notices, objects, paths
from . import proxy
from .proxy_nodes import GAUSSIAN, NAME, OFFSET, RADIUS, SHADE, give_modifier, modifier_of

SINGLE = ('The points of "{}" stand for its splats and cannot be changed one by one, so they were put back; move all of them together, '
          "or hide splats with a crop box.")
CONVERTED = ('"{}" shows splats and stays what it is: they are no mesh. Clear its file in Object properties > 4D Gaussians to have its '
             "points as a mesh.")
JOINED = '"{}" cannot be joined with others, because splats are no mesh; they stay apart. Parent them (Ctrl P) to move them as one.'
SHARED = '"{}" shows another file than the object whose data it was given, so it keeps points of its own.'
KEPT = f'The modifier "{NAME}" shows "{{}}" in other render engines, so it was put back.'
MODIFIER = ('The modifier "{}" changes the points of "{}" in other render engines, not its splats; choose Modifiers Change: '
            "Splats under Effects and Modifiers.")


@dataclass(frozen=True)
class _Record:
    """What a splat object was like at the last look, for when it is joined into another and gone."""

    name: str
    mesh: str
    model: np.ndarray
    world: Matrix
    parent: str
    collections: tuple[str, ...]
    settings: dict
    action: str
    modifier: bool


_records: dict[int, _Record] = {}
_meshes: dict[int, tuple[str, str]] = {}
"""Of the other mesh objects their names, and those of their meshes."""
_told: set[tuple[int, str]] = set()


def forget(*_) -> None:
    """Handler, when another file is opened: forget the records of splat objects."""
    _records.clear()
    _meshes.clear()
    _told.clear()


@persistent
def watch(scene, depsgraph) -> None:
    """Handler, after each evaluation: look at the meshes that changed, and remember what there is."""
    if depsgraph.mode != 'VIEWPORT':  # a render's own evaluation, perhaps in a thread
        return
    if not (_records or any(objects.is_splat(obj) for obj in bpy.data.objects)):
        return
    changed = [update.id.original for update in depsgraph.updates if update.is_updated_geometry]
    for obj in changed:
        if isinstance(obj, bpy.types.Object) and _ours(obj):
            if obj.type == 'MESH':
                _look_at(obj)
            elif obj.session_uid in _records:
                _make_again(obj)
    _remember()


def _ours(obj) -> bool:
    """Whether an object may be changed here, and nobody is at work in its mesh, by a linked duplicate either."""
    if obj.mode != 'OBJECT' or not obj.is_editable or obj.data is None or not obj.data.is_editable:
        return False
    return obj.data.users < 2 or all(other.mode == 'OBJECT' for other in bpy.data.objects if other.data == obj.data)


def _look_at(obj):
    mesh, splat = obj.data, objects.is_splat(obj)
    points = _points(mesh)
    if not splat:
        if points is not None and points.any() and not obj.fastgs.file_hash and _gone():
            _part(obj, points)
            notices.tell(JOINED.format(obj.name))
        elif (giver := _giver(obj)) is not None:
            _restore(obj.fastgs, _values(giver.fastgs))
            give_modifier(obj)
        elif not obj.fastgs.file_hash and GAUSSIAN not in mesh.attributes and modifier_of(obj) is not None:
            obj.modifiers.remove(modifier_of(obj))  # Copy Modifiers gave it to a mesh, which it would hide
        return
    _keep_modifier(obj)
    _tell_of_modifiers(obj)
    if obj.session_uid not in _records and _being_edited(paths.get(obj.fastgs)):
        bpy.data.objects.remove(obj)  # Separate made it: its points are those of the object that it comes from
        return
    text = SHARED if _of_another(obj) else _trouble(mesh, points)
    if text is None:
        return
    name = obj.name
    try:
        model = objects.source_of(obj)
    except FastGSError:  # the panel says why
        return
    if text is JOINED and not points.all():
        _split_off(obj, ~points)
    if text is JOINED:
        _bring_back()
    if text is SHARED:
        obj.data = proxy.new_mesh(obj.name, model, proxy.limit_of(mesh), _records[obj.session_uid].model)
    else:
        _put_back(obj, model, text is SINGLE)
    notices.tell(text.format(name))


def _of_another(obj) -> bool:
    """Whether an object has been given the mesh of a splat object that shows another file."""
    record = _records.get(obj.session_uid)
    return obj.data.users > 1 and record is not None and record.mesh != obj.data.name and any(
        other.data == obj.data and objects.abspath(other) != objects.abspath(obj) for other in bpy.data.objects if objects.is_splat(other))


def _giver(obj):
    """The splat object whose mesh was given to another (Link Object Data) or new object (Make Instance Face), which shows it from now on.

    None where there is none, or where the object has had that mesh before: then its file was cleared."""
    uid = obj.session_uid
    if uid in _records or _meshes.get(uid, ("", ""))[1] == obj.data.name:
        return None
    return next((other for other in bpy.data.objects if other.data == obj.data and objects.is_splat(other)), None)


def _make_again(obj):
    """Replace a splat object that was converted into another kind of object by a new one like it; the conversion itself cannot be
    undone."""
    name, chosen, active = obj.name, obj.select_get(), bpy.context.view_layer.objects.active == obj
    bpy.data.objects.remove(obj)
    for again in _bring_back():
        if again.name in bpy.context.view_layer.objects:
            again.select_set(chosen)
            if active:
                bpy.context.view_layer.objects.active = again
    notices.tell(CONVERTED.format(name))


def _being_edited(path: str) -> bool:
    """Whether somebody is at work in the mesh of an object that shows a file."""
    return any(obj.mode == 'EDIT' and paths.get(obj.fastgs) == path for obj in bpy.data.objects if obj.session_uid in _records)


def _trouble(mesh, points) -> str | None:
    """The sentence that describes what is wrong with a splat object's mesh; None where it is a proxy."""
    made_with = mesh.get(proxy.POINTS)
    if points is None:  # made without an importer
        return CONVERTED if len(mesh.edges) else None
    here = int(points.sum())
    if here < len(points) or (made_with is not None and here > made_with):
        return JOINED
    return SINGLE if here != made_with or model_space.misplaced(mesh) else None


def _points(mesh) -> np.ndarray | None:
    """Which vertices [M] bool are those of a proxy; None where a mesh has nothing of one."""
    if GAUSSIAN not in mesh.attributes or RADIUS not in mesh.attributes or OFFSET in mesh.attributes:
        return None
    return (arrays.read(mesh.attributes[RADIUS].data, "value") > 0) | (arrays.read(mesh.attributes[GAUSSIAN].data, "value", np.int32) < 0)


def _gone() -> list[_Record]:
    """The splat objects that existed at the last look and do not exist any more."""
    here = {obj.session_uid for obj in bpy.data.objects}
    return [record for uid, record in _records.items() if uid not in here]


def _put_back(obj, model, single: bool):
    """Give the object a new proxy in place of its mesh, wherever that is used."""
    old, record = obj.data, _records.get(obj.session_uid)
    turn = model_space.model_matrix(obj) if single or record is None else record.model
    new = proxy.new_mesh("", model, proxy.limit_of(old), turn)
    for material in old.materials:
        if material is None or not material.name.startswith(f".{NAME}"):
            new.materials.append(material)
    name = old.name
    if any(other.data == old and not objects.is_splat(other) for other in bpy.data.objects):  # Link Object Data gave it another's mesh
        own = record and bpy.data.meshes.get(record.mesh)
        obj.data = new if own is None else own
        if own is not None:
            bpy.data.meshes.remove(new)
    else:
        old.user_remap(new)
        bpy.data.meshes.remove(old)
        new.name = name if record is None else record.mesh
    if modifier_of(obj) is None:
        give_modifier(obj)


def _part(obj, points):
    """Take the points of proxies out of a mesh that they were joined into; the splat objects come back."""
    _leave(obj.data, ~points)
    _bring_back()


def _split_off(obj, foreign):
    """Move geometry that was joined into a proxy into an object of its own."""
    here = {other.session_uid for other in bpy.data.objects}
    names = [name for uid, (name, _) in _meshes.items() if uid not in here]
    mesh = obj.data.copy()
    _leave(mesh, foreign)
    other = bpy.data.objects.new(names[0] if len(names) == 1 else "Parted", mesh)
    for collection in obj.users_collection:
        collection.objects.link(other)
    other.matrix_world = obj.matrix_world


def _leave(mesh, chosen):
    """Leave only these vertices of a mesh, and nothing of a proxy."""
    edited = bmesh.new()
    edited.from_mesh(mesh)
    edited.verts.ensure_lookup_table()
    bmesh.ops.delete(edited, geom=[edited.verts[i] for i in np.flatnonzero(~chosen)], context='VERTS')
    edited.to_mesh(mesh)
    edited.free()
    mesh.update()
    for name in (model_space.PLACE, GAUSSIAN, RADIUS, SHADE):
        if name in mesh.attributes:
            mesh.attributes.remove(mesh.attributes[name])


def _bring_back() -> list:
    """Make the splat objects anew that were joined into another or converted: their meshes are still there."""
    made = []
    for record in _gone():
        mesh = bpy.data.meshes.get(record.mesh)
        if mesh is None:
            continue
        obj = bpy.data.objects.new(record.name, mesh)
        _restore(obj.fastgs, record.settings)
        homes = [bpy.data.collections.get(name) for name in record.collections]
        for home in [h for h in homes if h is not None] or [bpy.context.scene.collection]:
            home.objects.link(obj)
        obj.parent = bpy.data.objects.get(record.parent) if record.parent else None
        obj.matrix_world = record.world
        if record.action and record.action in bpy.data.actions:
            obj.animation_data_create().action = bpy.data.actions[record.action]
        give_modifier(obj)
        made.append(obj)
    return made


def _keep_modifier(obj):
    """Give an object its modifier back that Clear or Copy Modifiers took from it."""
    record = _records.get(obj.session_uid)
    if record is not None and record.modifier and OFFSET not in obj.data.attributes and modifier_of(obj) is None:
        give_modifier(obj)
        notices.tell(KEPT.format(obj.name))


def _tell_of_modifiers(obj):
    if obj.fastgs.points == 'ALL':
        return
    ours = modifier_of(obj)
    for modifier in obj.modifiers:
        key = obj.session_uid, modifier.name
        if modifier != ours and key not in _told:
            _told.add(key)
            notices.tell(MODIFIER.format(modifier.name, obj.name))


def _remember():
    _records.clear()
    _meshes.clear()
    for obj in bpy.data.objects:
        if obj.type != 'MESH' or obj.library is not None:
            continue
        if objects.is_splat(obj):
            action = obj.animation_data.action if obj.animation_data else None
            _records[obj.session_uid] = _Record(
                obj.name, obj.data.name, model_space.model_matrix(obj), obj.matrix_world.copy(), obj.parent.name if obj.parent else "",
                tuple(collection.name for collection in obj.users_collection), _values(obj.fastgs), action.name if action else "",
                modifier_of(obj) is not None)
        else:
            _meshes[obj.session_uid] = obj.name, obj.data.name


def _values(group) -> dict:
    """A property group's values as plain ones; datablocks by their names."""
    found = {}
    for prop in group.bl_rna.properties:
        value = None if prop.identifier in ("rna_type", "name") else getattr(group, prop.identifier)
        if prop.type == 'COLLECTION':
            found[prop.identifier] = [_values(item) for item in value]
        elif prop.type == 'POINTER':
            found[prop.identifier] = value.name if isinstance(value, bpy.types.Object) else None
        elif value is not None and not prop.is_readonly:
            found[prop.identifier] = tuple(value) if getattr(prop, "is_array", False) else value
    return found


def _restore(group, values: dict):
    for name, value in values.items():
        kind = group.bl_rna.properties[name].type
        if kind == 'COLLECTION':
            for item in value:
                _restore(getattr(group, name).add(), item)
        elif kind == 'POINTER':
            if value is not None:
                setattr(group, name, bpy.data.objects.get(value))
        else:
            setattr(group, name, value)

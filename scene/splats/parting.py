# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes parts of splat objects, which are ordinary objects, and joins them again."""
from dataclasses import replace

import bpy
import numpy as np
from mathutils import Matrix

from ...fastgs_blender.model.gaussians import GaussianModel
from ...fastgs_blender.model.parts import Parts
from ...fastgs_blender.rendering.masks import pack_mask
from ...fastgs_blender.util.errors import FastGSError
from .. import objects, selection
from ..cameras import keys
from . import splat_object

PLACES = ("location", "rotation_", "scale", "delta_")
"""How the paths of an object's own place begin."""


def separate(context, obj, chosen: np.ndarray, name: str = "Part") -> bpy.types.Object:
    """A new object, child of a splat object and like it, that shows some of its Gaussians [N] in its place; it is selected and active.

    Raises FastGSError where that is nothing or all.
    """
    own = selection.bits(obj, "part")
    chosen = own & chosen
    left = own & ~chosen
    if not chosen.any():
        raise FastGSError("nothing is selected that a part could be made of; select Gaussians first.")
    if not left.any():
        raise FastGSError(f'all of "{obj.name}" is selected, so nothing would be left of it; select less.')
    part = obj.copy()
    part.name = name
    for collection in obj.users_collection:
        collection.objects.link(part)
    _stand_in(part, obj)
    space = context.space_data
    if space and space.type == 'VIEW_3D' and space.local_view:
        part.local_view_set(space, True)
    for each, bits in ((part, chosen), (obj, left)):
        selection.clear(each)
        _show(each, bits)
    objects.select_only(context, part)
    return part


def join(context, target, others: list) -> int:
    """Give a splat object the Gaussians of others, which go; returns how many came.  Raises FastGSError where it cannot be."""
    path = objects.abspath(target)
    own, erased = selection.bits(target, "part"), selection.bits(target, "mask")
    before = int(own.sum())
    for other in others:
        if objects.abspath(other) != path:
            raise FastGSError(f'"{other.name}" shows another file than "{target.name}"; parts of one file can be joined.')
        bits = selection.bits(other, "part")
        if (bits & own).any():
            raise FastGSError(f'"{other.name}" and "{target.name}" show the same Gaussians; parts that share none can be joined.')
        own, erased = own | bits, erased | (bits & selection.bits(other, "mask"))
    objects.select_only(context, target)
    for other in others:
        _hand_over(other, target)
        data = other.data
        bpy.data.objects.remove(other)
        if data is not None and not data.users:
            bpy.data.batch_remove([data])
    selection.clear(target)
    selection.put(target, mask=erased)
    _show(target, own)
    return int(own.sum()) - before


def from_file(context, obj) -> list[bpy.types.Object]:
    """Make objects of the parts that the file of a splat object names.

    Of Gaussians of several parts the first has them; parts of none, and one that would leave nothing, are left out.
    """
    model, made = objects.load_model(objects.abspath(obj)), []
    for name, bits in model.parts.items() if isinstance(model, GaussianModel) else ():
        own = selection.bits(obj, "part")
        if (own & bits).any() and (own & ~bits).any():
            made.append(separate(context, obj, bits, name))
    if made:
        objects.select_only(context, obj)
    return made


def with_parts_joined(obj) -> GaussianModel:
    """What an object shows of its file, with what those of its children show that are parts of it, by their names.  Raises FastGSError."""
    model, own, named = objects.load_one_model(obj, "exported as one model"), selection.bits(obj, "part"), {}
    for child in obj.children_recursive:
        if objects.is_splat(child) and child.fastgs.part and objects.abspath(child) == objects.abspath(obj):
            named[child.name] = selection.bits(child, "part")
            own = own | named[child.name]
    if not named and not obj.fastgs.part:
        return model
    return replace(model.take(own), parts=Parts.of({name: bits[own] for name, bits in named.items()}))


def _show(obj, bits: np.ndarray) -> None:
    """Let an object show these Gaussians [N] of its file."""
    objects.watch(objects.abspath(obj))
    obj.fastgs.part = "" if bits.all() else pack_mask(bits)
    splat_object.refresh(obj)


def _stand_in(part, obj) -> None:
    """Let a copy of an object stand where that stands, as its child, whatever moves it."""
    part.parent, part.parent_type, part.matrix_parent_inverse = obj, 'OBJECT', Matrix()
    part.constraints.clear()
    part.matrix_basis = Matrix()
    part.delta_location, part.delta_scale = (0, 0, 0), (1, 1, 1)
    part.delta_rotation_euler, part.delta_rotation_quaternion = (0, 0, 0), (1, 0, 0, 0)
    animation = part.animation_data
    if animation is None:
        return
    for curve in [curve for curve in animation.drivers if curve.data_path.startswith(PLACES)]:
        animation.drivers.remove(curve)
    if any(curve.data_path.startswith(PLACES) for curve in keys.curves(part)):
        slot = getattr(animation, "action_slot", None)
        animation.action = animation.action.copy()
        if slot is not None:
            animation.action_slot = animation.action.slots[slot.identifier]
        curves = keys.curves(part)
        for curve in [curve for curve in curves if curve.data_path.startswith(PLACES)]:
            curves.remove(curve)


def _hand_over(other, target) -> None:
    """Make the children of an object those of another one, where they stand."""
    for child in other.children:
        if child != target:
            world = child.matrix_world.copy()
            child.parent = target
            child.matrix_world = world
    if target.parent == other:
        world = target.matrix_world.copy()
        target.parent = other.parent
        target.matrix_world = world

# SPDX-License-Identifier: GPL-3.0-or-later
"""Carries parts, erasing and selections over to a retrained file, whose Gaussians are others: by place and colour."""
import bpy
import numpy as np
from mathutils.kdtree import KDTree

from ..fastgs_blender.model.edits import state_of
from ..fastgs_blender.model.gaussians import GaussianModel
from ..fastgs_blender.model.slicing import positions_at
from ..fastgs_blender.rendering.masks import pack_mask, unpack_mask
from ..fastgs_blender.training.initial.neighbours import neighbour_distance
from . import objects, parts

MASKS = ("part", "mask", "selection", "wanted", "refused", "unsure")
MOMENTS = (1 / 6, 1 / 2, 5 / 6)
"""Of the clip, at which places are compared."""
NEAR = 4
"""So many of the nearest are compared by colour."""
TINT = 0.1
"""Difference of colours that counts as much as the usual distance of neighbours."""
FAR = 4.0
"""Usual distances of neighbours beyond which a Gaussian lies where there was none."""
MOST = 0.5
"""Share of such Gaussians from which on the file is taken to hold another scene."""
WORTH = 0.02
"""Share of such Gaussians that is worth a sentence."""
STRANGE = ('"{}": the file holds other Gaussians than those of which its parts, erasing or selection were made, and {} They are kept, and '
           "count again as soon as the earlier file is back.")


def marked(obj) -> bool:
    """Whether an object has a part or a mask."""
    return any(getattr(obj.fastgs, name) for name in MASKS)


def follows(obj, reloaded: list) -> bool:
    """Whether an object has marks of a file that others have reloaded, and must follow it."""
    return (objects.is_splat(obj) and obj not in reloaded and marked(obj)
            and objects.abspath(obj) in {objects.abspath(other) for other in reloaded})


def carry(path: str, earlier) -> list[str]:
    """Carry over what objects that show a file have marked of its earlier version; returns sentences on what is not sure.

    earlier  the model of that version, None where it is not known any more
    Raises FastGSError where the file cannot be read.
    """
    holders = [obj for obj in bpy.data.objects
               if objects.is_splat(obj) and objects.abspath(obj) == path and marked(obj) and obj.is_editable]
    if not holders:
        return []
    now = objects.load_model(path)
    if not isinstance(earlier, GaussianModel) or not isinstance(now, GaussianModel):
        size = len(now) if isinstance(now, GaussianModel) else None
        return [STRANGE.format(obj.name, "the earlier version is not in memory.") for obj in holders
                if any(parts.count_of(getattr(obj.fastgs, name)) not in (None, size) for name in MASKS)]
    if len(earlier) == len(now) and np.array_equal(earlier.position, now.position):
        return []
    origin, sure = matched(earlier, now)
    new = 1 - sure.mean()
    if new > MOST:
        return [STRANGE.format(obj.name, "they lie elsewhere.") for obj in holders]
    for obj in holders:
        for name in MASKS:
            text = getattr(obj.fastgs, name)
            if parts.count_of(text) == len(earlier):
                bits = unpack_mask(text, len(earlier))[origin]
                setattr(obj.fastgs, name, pack_mask(bits if name == "part" else bits & sure))
    names = ", ".join(f'"{obj.name}"' for obj in holders)
    return [f"{new:.0%} of the Gaussians lie where the earlier file had none; look at what is part of {names}."] if new > WORTH else []


def matched(earlier: GaussianModel, now: GaussianModel) -> tuple[np.ndarray, np.ndarray]:
    """(which of the earlier Gaussians each of the new ones [N] is most like, [N] whether it lies among them)."""
    (old, old_colour), (new, colour) = (_places(model) for model in (earlier, now))
    usual = np.maximum(neighbour_distance(old), 1e-12)
    usual = np.where(np.isfinite(usual), usual, 1.0)
    tree = KDTree(len(old))
    for number, place in enumerate(old.tolist()):
        tree.insert(place, number)
    tree.balance()
    found = [tree.find_n(place, NEAR) for place in new.tolist()]
    count = min(NEAR, len(old))
    index = np.array([[hit[1] for hit in hits] for hits in found], np.int64).reshape(len(new), count)
    away = np.array([[hit[2] for hit in hits] for hits in found]).reshape(len(new), count) / usual[index]
    unlike = away**2 + (np.abs(colour[:, None] - old_colour[index]).max(2) / TINT) ** 2
    best = unlike.argmin(1)[:, None]
    return np.take_along_axis(index, best, 1)[:, 0], np.take_along_axis(away, best, 1)[:, 0] <= FAR


def _places(model: GaussianModel) -> tuple[np.ndarray, np.ndarray]:
    """Mean places [N, 3] over the clip, and colours [N, 3]."""
    place = np.nan_to_num(np.mean([positions_at(model, t) for t in MOMENTS], 0))
    return place, state_of(model, 0.5).colour

# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the subject of a capture: the moving or the selected objects of a scene, and a sphere that contains their motion."""
from dataclasses import dataclass

import numpy as np

from ...fastgs_blender.util.errors import FastGSError
from ...fastgs_blender.util.rotations import transformed
from .. import arrays
from ..objects import SURFACES

MOST_POINTS, MOST_INSTANCES, LOOKS = 300, 20_000, 16


@dataclass(frozen=True, eq=False)
class Subject:
    """The subject of a capture: its objects' names (as in Cryptomatte), those of all objects that pictures show; centre [3] and radius
    of its sphere; its lowest height."""

    names: set[str]
    everything: set[str]
    centre: np.ndarray
    radius: float
    floor: float


def find(studio, frames, chosen: set[str] | None = None) -> Subject:
    """The subject in these frames: the objects named in `chosen`, else what moves with all that hangs on the same parent, else everything.

    Raises FastGSError where nothing is to be seen.
    """
    looks = [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, min(LOOKS, len(frames))).round().astype(int))]
    seen = []
    for frame in looks:
        studio.go_to(frame)
        seen.append(_outlines(studio.depsgraph))
    everything = {key: item.top for outlines in seen for key, item in outlines.items()}
    if chosen is not None:
        keys = {key for key in everything if chosen & {key, *_ancestors(studio.scene, key)}}
    else:
        tops = {everything[key] for key in everything if _moves([outlines[key].points for outlines in seen if key in outlines])}
        keys = {key for key, top in everything.items() if top in tops} or set(everything)
    if not keys:
        raise FastGSError("there is nothing to capture: no object with a surface is visible in renders; show or select some.")
    found = [outlines[key] for outlines in seen for key in keys if key in outlines]
    points = np.concatenate([item.points for item in found])
    centre = (points.min(0) + points.max(0)) / 2
    radius = max(float(np.linalg.norm(points - centre, axis=1).max()), 1e-3)
    return Subject(set().union(*(item.names for item in found)), set(everything), centre, radius, float(points[:, 2].min()))


@dataclass(eq=False)
class _Outline:
    top: str
    names: set[str]
    points: np.ndarray


def _outlines(depsgraph) -> dict[str, _Outline]:
    """Some points of every visible object's surface, by the object that brings it into the scene."""
    found: dict[str, list] = {}
    for number, instance in enumerate(depsgraph.object_instances):
        obj = instance.object
        owner = (instance.parent if instance.is_instance else obj).original
        if number >= MOST_INSTANCES:
            break
        if obj.type not in SURFACES or owner.hide_render or obj.original.hide_render or not instance.show_self:
            continue
        matrix = np.array(instance.matrix_world)
        found.setdefault(owner.name, [owner, set(), []])
        found[owner.name][1].add(obj.original.name)
        found[owner.name][2].append(transformed(_points(obj), matrix))
    return {name: _Outline(_top(owner).name, names, np.concatenate(points)) for name, (owner, names, points) in found.items()}


def _points(obj) -> np.ndarray:
    vertices = obj.data.vertices if obj.type == 'MESH' else ()
    if not len(vertices):
        return np.array(obj.bound_box, np.float64)
    return arrays.points(obj.data)[:: max(1, len(vertices) // MOST_POINTS)]


def _moves(outlines) -> bool:
    first = outlines[0]
    size = max(float(np.ptp(first, axis=0).max()), 1e-6)
    return any(later.shape != first.shape or np.abs(later - first).max() > 1e-3 * size for later in outlines[1:])


def _top(obj):
    while obj.parent:
        obj = obj.parent
    return obj


def _ancestors(scene, name: str) -> set[str]:
    obj, found = scene.objects.get(name), set()
    while obj is not None and obj.parent:
        obj = obj.parent
        found.add(obj.name)
    return found

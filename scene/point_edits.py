# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads back how modifiers have changed the points of a splat object.

With *Modifiers Change: Splats* (splats/feeding.py) a splat object's mesh has a point for each Gaussian, as it is on the frame, with the
attributes below.  What is evaluated after the object's modifiers is copied here, for whoever takes a snapshot of the scene; in the
snapshot's thread it is compared with what the points were given, and becomes an edit of the model.
"""
from __future__ import annotations

import itertools
import threading
from dataclasses import dataclass, field

import numpy as np

from ..fastgs_blender.model.deformation import local_maps
from ..fastgs_blender.model.edits import Edit, State, state_of
from ..fastgs_blender.model.gaussians import GaussianModel
from ..fastgs_blender.rendering.colour import linear_to_srgb, srgb_to_linear
from ..fastgs_blender.util.errors import FastGSError
from ..fastgs_blender.util.rotations import transformed
from . import arrays, model_space, proxies
from .colour import rec709_to_working

ID, TIME = "id", "time"
"""Attributes of points: which Gaussian, counted from 0 (-1: none), and the model's time that they show."""
COLOR, OPACITY, SCALE, HIDDEN = "color", "opacity", "scale", "hidden"
"""Attributes that may be changed: scene-linear colour; 0..1; standard deviations in the object's space; whether it is not shown."""
VELOCITY, AGE = "velocity", "age"
"""Attributes to read: in the object's space a second; how much of its lifetime has passed, 0..1."""
STILL, STILL_OPACITY = "still_position", "still_opacity"
"""Attributes to read: position and opacity on the object's still frame; of sequences those of the frame itself."""
ATTRIBUTES = {ID: 'INT', TIME: 'FLOAT', COLOR: 'FLOAT_COLOR', OPACITY: 'FLOAT', SCALE: 'FLOAT_VECTOR', VELOCITY: 'FLOAT_VECTOR',
              AGE: 'FLOAT', STILL: 'FLOAT_VECTOR', STILL_OPACITY: 'FLOAT'}
"""What points have, and the types."""
DEFORMERS = ('ARMATURE', 'CAST', 'CORRECTIVE_SMOOTH', 'CURVE', 'DISPLACE', 'HOOK', 'LAPLACIANDEFORM', 'LATTICE', 'MESH_DEFORM',
             'SHRINKWRAP', 'SIMPLE_DEFORM', 'SMOOTH', 'LAPLACIANSMOOTH', 'SURFACE_DEFORM', 'WARP', 'WAVE')
"""Modifiers that bend space smoothly: Gaussians turn and stretch with them."""
READ = "fastgs_read"
"""Custom property of an evaluated mesh that has been read: the number of what was found in it."""
ROUNDED = 4
"""Units in the last place within which a number counts as unchanged: Blender rounds on the way."""
LARGEST_COLOUR = 100.0

_numbers = itertools.count(1)
_latest: dict[tuple[int, str], Carried] = {}
_states: dict[int, tuple[GaussianModel, State]] = {}
_lock = threading.Lock()


@dataclass(frozen=True, eq=False)
class Carried:
    """The attributes of M points after the modifiers of their object.

    number    of its own, by which snapshots are compared
    t         the model's time at which the points were made
    matrix    [4, 4] from the model's space to the object's
    working   [3, 3] from linear Rec.709 to the scene's colours
    index     [M] which Gaussians they are
    position  [M, 3] in the object's space
    rest      by attribute: scale [M, 3], opacity [M], color [M, 3], hidden [M] bool; those that are there
    follow    whether Gaussians turn and stretch with the points around them
    """

    number: int
    t: float
    matrix: np.ndarray
    working: np.ndarray
    index: np.ndarray
    position: np.ndarray
    rest: dict[str, np.ndarray]
    follow: bool
    _made: dict = field(default_factory=dict, repr=False)

    def same(self, other: Carried) -> bool:
        """Whether another one says the same of the same points."""
        names = self.rest.keys()
        return (self.t, self.follow, names) == (other.t, other.follow, other.rest.keys()) and all(np.array_equal(a, b) for a, b in (
            (self.index, other.index), (self.position, other.position), (self.matrix, other.matrix), (self.working, other.working),
            *((self.rest[name], other.rest[name]) for name in names)))

    def shown(self, model: GaussianModel, t: float, make: bool = True) -> tuple[GaussianModel, float]:
        """(the model to show instead of a model at time t, and the time at which it shows that); the same where nothing was changed.

        Kept; raises FastGSError where it is not there yet and is not to be made.
        """
        key = id(model), t
        with _lock:
            found = self._made.get(key)
        if found is None:
            if not make:
                raise FastGSError("its points are not read yet.")
            edit = self._edit(model)
            found = model, (model, t) if edit is None else (edit.applied(model, t), 0.0)
            with _lock:
                self._made[key] = found  # the model is held, so that its id stays its own
        return found[1]

    def _edit(self, model: GaussianModel) -> Edit | None:
        """What was changed; None: nothing."""
        count, before = len(model), state(model, self.t)
        index, first = self.index, np.arange(len(self.index))
        if not np.array_equal(index, np.arange(count)):  # points are gone, or there several times
            index, first = np.unique(index, return_index=True)
            index, first = index[index < count], first[index < count]
        hidden = np.ones(count, bool)
        hidden[index] = self.rest[HIDDEN][first] if HIDDEN in self.rest else False
        fed, found = given(before, self.matrix, model, self.working), {}
        moved = _changed(self.position[first], fed["position"][index])
        linear = np.linalg.inv(self.matrix[:3, :3]) if moved.any() else np.eye(3)
        after = self.position[first][moved].astype(np.float64)
        deform = None
        if moved.any():
            found["position"] = _rows(count, index[moved], before.position[index[moved]] + (
                after - fed["position"][index[moved]]) @ linear.T)
            if self.follow:
                maps = local_maps(fed["position"][index], self.position[first])
                deform = np.tile(np.eye(3), (count, 1, 1))
                deform[index] = linear @ maps @ self.matrix[:3, :3]
        for name in (SCALE, OPACITY, COLOR):
            if name not in self.rest:
                continue
            value, old = self.rest[name][first], fed[name][index]
            rows = _changed(value, old)
            if not rows.any():
                continue
            value = value[rows].astype(np.float64)
            if name == SCALE:
                value = before.scale[index[rows]] * value / np.maximum(old[rows].astype(np.float64), 1e-38)
            if name == COLOR:
                value = np.clip(value @ np.linalg.inv(self.working.astype(np.float64)).T, 0, None)
                value = value if model.colour_space == "linear" else linear_to_srgb(value)
                same = ~_changed(self.rest[name][first][rows].ravel(), old[rows].ravel()).reshape(-1, 3)
                value = np.where(same, before.colour[index[rows]], value)
            found["colour" if name == COLOR else name] = _rows(count, index[rows], value)
        if not found and not hidden.any():
            return None
        return Edit(self.t, hidden=hidden if hidden.any() else None, deform=deform, **found)


def state(model: GaussianModel, t: float) -> State:
    """The model's Gaussians at a time; the last one of each model is kept."""
    with _lock:
        found = _states.get(id(model))
    if found is None or found[0] is not model or found[1].t != t:
        found = model, state_of(model, t)
        with _lock:
            _states[id(model)] = found
            while len(_states) > 8:
                del _states[next(iter(_states))]
    return found[1]


def given(now: State, matrix: np.ndarray, model: GaussianModel, working: np.ndarray) -> dict[str, np.ndarray]:
    """What points are given of a state: by attribute [N, ...] float32, and "position"; in the object's space and the scene's colours."""
    size = np.float32(np.cbrt(abs(np.linalg.det(matrix[:3, :3]))))
    colour = np.clip(now.colour, 0, LARGEST_COLOUR)
    linear = colour if model.colour_space == "linear" else srgb_to_linear(colour)
    return {
        "position": transformed(now.position, matrix).astype(np.float32), SCALE: now.scale * size, OPACITY: now.opacity,
        COLOR: (linear @ working.T).astype(np.float32), VELOCITY: (now.velocity @ matrix[:3, :3].T).astype(np.float32), AGE: now.age,
    }


def carried_of(obj, depsgraph) -> Carried | None:
    """The attributes of the points of an evaluated splat object; None where no modifier can have changed them."""
    mesh = obj.data
    if obj.type != 'MESH' or obj.fastgs.points != 'ALL' or not modifiers(obj, depsgraph) or ID not in mesh.attributes:
        return None
    key = obj.original.session_uid, depsgraph.mode
    latest = _latest.get(key)
    if latest is not None and mesh.get(READ) == latest.number:
        return latest
    found = _read(obj, mesh, any(m.type in DEFORMERS for m in modifiers(obj, depsgraph)))
    if found is not None:  # Blender evaluates a frame several times, and F12 after the viewport: what its edit cost is kept
        others = [latest for (uid, _), latest in _latest.items() if uid == key[0] and latest is not None]
        found = next((other for other in others if other.same(found)), found)
        mesh[READ] = found.number
    _latest[key] = found
    return found


def modifiers(obj, depsgraph) -> list:
    """The modifiers of an object, switched on in an evaluation, that are not the extension's own."""
    render = depsgraph.mode == 'RENDER'
    return [m for m in obj.modifiers if (m.show_render if render else m.show_viewport)
            and not (m.type == 'NODES' and m.node_group is not None and m.node_group.name.startswith(proxies.GROUP))]


def forget(*_) -> None:
    """Handler, when another file is opened: forget the states of models."""
    _latest.clear()
    _states.clear()


def _read(obj, mesh, follow) -> Carried | None:
    index, shown = _values(mesh, ID, 1), _values(mesh, proxies.OFFSET, 3)
    time = _values(mesh, TIME, 1)
    if index is None or time is None:
        return None
    take = index >= 0 if shown is None else (index >= 0) & ~shown.any(1)
    rest = {name: _values(mesh, name, width) for name, width in ((SCALE, 3), (OPACITY, 1), (COLOR, 3), (HIDDEN, 1))}
    rest = {name: value[take] for name, value in rest.items() if value is not None}
    if HIDDEN in rest:
        rest[HIDDEN] = rest[HIDDEN] > 0.5
    t = float(time[take][0]) if take.any() else 0.0
    return Carried(next(_numbers), t, model_space.model_matrix(obj), rec709_to_working(), index[take].astype(np.int64),
                   arrays.points(mesh)[take], rest, follow and obj.fastgs.follow_points)


KINDS = {'FLOAT': ("value", 1, np.float32), 'INT': ("value", 1, np.int32), 'BOOLEAN': ("value", 1, bool), 'INT8': ("value", 1, np.int8),
         'FLOAT_VECTOR': ("vector", 3, np.float32), 'FLOAT_COLOR': ("color", 4, np.float32), 'BYTE_COLOR': ("color", 4, np.float32)}
"""Of each type of attribute: the member that holds its value, how many numbers that has, and of which type."""


def _values(mesh, name: str, width: int):
    """An attribute of the vertices as [M] or [M, width]; a single number stands for all.  None where there is no such attribute."""
    attribute = mesh.attributes.get(name)
    if attribute is None or attribute.domain != 'POINT' or attribute.data_type not in KINDS or len(attribute.data) != len(mesh.vertices):
        return None
    member, items, kind = KINDS[attribute.data_type]
    values = arrays.read(attribute.data, member, kind, items).reshape(-1, items)
    if width == 1:
        return values[:, 0] if items == 1 else values[:, :3].mean(1)
    return np.repeat(values, width, 1) if items == 1 else values[:, :width]


def _changed(after: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Which rows [M] differ by more than rounding."""
    slack = ROUNDED * np.spacing(np.abs(before))
    if before.ndim == 1:
        return ~(np.abs(after - before) <= slack)
    return ~(np.abs(after - before) <= slack.max(1, keepdims=True)).all(1)


def _rows(count: int, index: np.ndarray, values: np.ndarray) -> np.ndarray:
    """An array of `count` rows, NaN but for these."""
    out = np.full((count, *values.shape[1:]), np.nan)
    out[index] = values
    return out

# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes the Gaussians of the current frame into the points of splat objects with *Modifiers Change: Splats*, as the input of modifiers.

Blender evaluates modifiers from the object's own mesh, so the points are written there: before a new frame is evaluated, with the object's
previous settings, and again after it if keyframes have changed these.  The same happens on the sub-frames of a render.
"""
import weakref

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...fastgs_blender.model.edits import State, state_of
from ...fastgs_blender.util.errors import FastGSError
from .. import arrays, model_space, objects, point_edits, snapshot
from ..colour import rec709_to_working
from ..time import clip_frame
from . import proxy
from .proxy_nodes import keep_last, modifier_of

SHOWN, RESTING = "fastgs_time", "fastgs_still"
"""Custom properties of a mesh: the model's times that its points show, and that their still attributes show."""
STEADY = 1e-5
"""Difference of two maps of the same mesh that is rounding."""

_fed: dict[int, tuple[weakref.ref, np.ndarray, int]] = {}
"""By mesh: the model whose Gaussians its points are, the map from the model's space to the object's, and for which object."""


@persistent
def before(scene, depsgraph=None) -> None:
    """Handler, before a frame is evaluated."""
    for obj in bpy.data.objects:
        if objects.is_splat(obj) and not obj.rigid_body:  # a simulation may be reading its mesh on the new frame (bodies.py)
            feed(obj, obj, scene)


@persistent
def after(scene, depsgraph=None) -> None:
    """Handler, after each evaluation: Blender evaluates once more, and calls no handler then, where something was written."""
    for obj in bpy.data.objects if depsgraph is not None else ():
        if objects.is_splat(obj):
            evaluated = obj.evaluated_get(depsgraph)
            if evaluated.is_evaluated:
                feed(obj, evaluated, depsgraph.scene)


def feed(obj, settings, scene) -> None:
    """Update the points of a splat object to a frame of the scene.

    settings  the object whose settings count: itself, or it evaluated
    """
    every = obj.fastgs.points == 'ALL'
    mesh = obj.data
    if obj.type != 'MESH' or mesh is None or not mesh.is_editable or mesh.is_editmode:
        return
    if not every and proxy.limit_of(mesh) != proxy.EVERY:
        return
    try:
        source = objects.source_of(obj)
        if not every:
            proxy.fill(mesh, source, proxy.LIMIT, model_space.model_matrix(obj))
            obj.data.update_tag()
            return
        frame, fps = snapshot.clock(scene)
        retime = snapshot.retime_of(settings, frame)
        at = clip_frame(frame, fps, retime, source.clip)
        model, t = source.moment(source.clip.t_of_frame(at or 0.0), retime.hold)
    except FastGSError:  # the panel says why
        return
    t = float(np.float32(t))
    still = settings.fastgs.still_frame
    rest = float(np.float32(source.clip.t_of_frame(still if np.isfinite(still) else 0.0))) if model is source else t
    known = _fed.get(mesh.session_uid)
    fresh = known is None or known[0]() is not model or proxy.limit_of(mesh) != proxy.EVERY
    if not fresh and (mesh.get(SHOWN), mesh.get(RESTING)) == (t, rest):
        return
    turn = model_space.model_matrix(obj)
    if known is not None and np.abs(known[1] - turn).max() < STEADY:
        turn = known[1]  # found anew from rounded points it would drift from frame to frame
    if not fresh and known[2] != obj.session_uid and any(
            other.session_uid == known[2] and other.data == mesh and other.fastgs.points == 'ALL' for other in bpy.data.objects):
        mesh = obj.data = mesh.copy()  # linked duplicates at different times cannot share their points
    if fresh:
        _make(obj, model, turn)
    given = point_edits.given(point_edits.state(model, t), turn, model, rec709_to_working())
    if fresh or mesh.get(RESTING) != rest:
        still = given if rest == t else point_edits.given(state_of(model, rest), turn, model, rec709_to_working())
        given |= {point_edits.STILL: still["position"], point_edits.STILL_OPACITY: still[point_edits.OPACITY]}
    _write(mesh, point_edits.state(model, t), given)
    mesh[SHOWN], mesh[RESTING] = t, rest
    _fed[mesh.session_uid] = weakref.ref(model), turn, obj.session_uid


def _make(obj, model, turn):
    """Make a point for each Gaussian, and the corners of the box."""
    same = proxy.limit_of(obj.data) == proxy.EVERY and len(obj.data.vertices) == len(model) + len(proxy.CORNERS)
    if not same:  # else vertex groups and what else hangs on the points stays
        proxy.fill(obj.data, model, proxy.EVERY, turn)
    modifier = modifier_of(obj)
    if modifier is not None:
        keep_last(modifier)


def _write(mesh, state: State, given: dict[str, np.ndarray]):
    """Write what point_edits.given() says of a state, and the state's own places, to the first vertices; the others keep theirs."""
    number, count = len(state.position), len(mesh.vertices)
    at, place = arrays.points(mesh), arrays.read(mesh.attributes[model_space.PLACE].data, "vector", np.float32, 3)
    at[:number], place[:number] = given.pop("position"), state.position
    mesh.vertices.foreach_set("co", at.ravel())
    mesh.attributes[model_space.PLACE].data.foreach_set("vector", place.ravel())
    given |= {point_edits.ID: np.arange(number, dtype=np.int32), point_edits.TIME: np.full(number, state.t, np.float32)}
    for name, values in given.items():
        kind = point_edits.ATTRIBUTES[name]
        member, width, dtype = point_edits.KINDS[kind]
        whole = np.full((count, width), -1 if name == point_edits.ID else 0, dtype)
        whole[:number, :1 if values.ndim == 1 else values.shape[1]] = values if values.ndim == 2 else values[:, None]
        if kind == 'FLOAT_COLOR':
            whole[:, 3] = 1
        attribute = mesh.attributes.get(name)
        if attribute is None:
            attribute = mesh.attributes.new(name, kind, 'POINT')
        attribute.data.foreach_set(member, whole.ravel())
    mesh.update()
    mesh.update_tag()

# SPDX-License-Identifier: GPL-3.0-or-later
"""Moves proxies with time: other engines' final renders, and viewports that do not draw the splats themselves, show the frame's points.

It writes to the evaluated mesh of a depsgraph, after the evaluation and before that mesh is drawn.  A final render has a depsgraph of its
own, so that rendering changes nothing in the open file, and sub-frames are those of the render.  FAST-GS' own final renders draw no points.
"""
import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...fastgs_blender.rendering.crops import kept_by
from ...fastgs_blender.rendering.filters import hidden
from ...fastgs_blender.rendering.looks import look_numbers
from ...fastgs_blender.util.errors import FastGSError
from ...fastgs_blender.util.rotations import transformed
from .. import arrays, mesh_scene, model_space, objects, point_edits, snapshot
from ..colour import rec709_to_working
from ..time import shown_frames
from .proxy_nodes import COLOUR, GAUSSIAN, LARGER, NONE, OFFSET, RADIUS
from .proxy_points import Shown, choose, shared_out, show

MOVED = "fastgs_moved"
"""Custom property of an evaluated mesh that was written here."""


class _Chosen:
    """The Gaussians of one proxy as a model of their own, sorted.

    Frames of a sequence that have another number of Gaussians than its first one get a choice of their own, no more than the points.
    """

    def __init__(self, model, mesh, usual: int):
        self.model, self.key = model, arrays.read(mesh.attributes[GAUSSIAN].data, "value", np.int32)
        self.index = np.unique(self.key[(self.key >= 0) & (arrays.read(mesh.attributes[RADIUS].data, "value") > 1e10 * NONE)])
        taken = self.index
        if len(model) != usual:
            taken = np.sort(choose(model, len(self.index)).index)
            self.index = self.index[:len(taken)]
        self.taken = taken
        self.part = model.take(taken) if len(taken) and taken[-1] < len(model) else None

    def of(self, model, mesh) -> bool:
        return self.model is model and np.array_equal(self.key, arrays.read(mesh.attributes[GAUSSIAN].data, "value", np.int32))


_chosen: dict[tuple[int, int], _Chosen] = {}
"""By the mesh's session_uid, and the place of a frame among those that show at once."""


@persistent
def follow(scene, depsgraph=None) -> None:
    """Handler, after each evaluation: put the points of all proxies where their Gaussians are."""
    splats = [obj for obj in bpy.data.objects if objects.is_splat(obj)]
    there = {obj.data.session_uid for obj in splats if obj.data is not None}
    for key in [key for key in _chosen if key[0] not in there]:
        _chosen.pop(key, None)  # a render runs in a thread of its own
    if depsgraph is not None and mesh_scene.is_one(depsgraph.scene):
        mesh_scene.hide(depsgraph)
        return
    if depsgraph is not None and depsgraph.mode == 'RENDER' and depsgraph.scene.render.engine == 'FASTGS':
        return
    for obj in splats if depsgraph is not None else ():
        evaluated = obj.evaluated_get(depsgraph)
        if obj.rigid_body and depsgraph.mode == 'VIEWPORT':  # its mesh stays from frame to frame (bodies.py)
            continue
        if evaluated.is_evaluated and evaluated.type == 'MESH' and _shows_points(evaluated.data):
            _move(evaluated, depsgraph)


def _shows_points(mesh) -> bool:
    """Whether a mesh is a proxy's, evaluated with its octahedra, and has not been written yet."""
    return mesh is not None and OFFSET in mesh.attributes and GAUSSIAN in mesh.attributes and MOVED not in mesh


def _move(obj, depsgraph):
    stored = obj.original.data
    try:
        source = objects.source_of(obj)
        frame, fps = snapshot.clock(depsgraph.scene)
        retime, settings = snapshot.retime_of(obj, frame), snapshot.settings_of(obj, depsgraph)
        frames = shown_frames(frame, fps, retime, source.clip)
        moments = [source.moment(source.clip.t_of_frame(frame), retime.hold) for frame, _ in frames or [(0.0, 0.0)]]
    except FastGSError:  # the panel, and FAST-GS itself, say why; the points stay where they were made
        return
    if stored.is_editmode or GAUSSIAN not in stored.attributes:
        return
    parts = [_chosen_of(stored, number, model, len(source)) for number, (model, _) in enumerate(moments)]
    if any(chosen.part is None for chosen in parts):
        return
    larger = stored.get(LARGER, 1.0)
    carried = point_edits.carried_of(obj, depsgraph)
    looks = [_seen(chosen, *_edited(chosen, t, carried), settings, larger) for chosen, (_, t) in zip(parts, moments)]
    if not frames:
        looks = [(shown, np.zeros_like(seen)) for shown, seen in looks]
    shares = [share for _, share in frames] or [1.0]
    _write(obj, *_together(parts, looks, shares))


def _chosen_of(stored, number: int, model, usual: int) -> _Chosen:
    key = stored.session_uid, number
    found = _chosen.get(key)
    if found is None or not found.of(model, stored):
        found = _chosen[key] = _Chosen(model, stored, usual)
    return found


def _edited(chosen: _Chosen, t: float, carried):
    """(the chosen Gaussians as modifiers have left them, and the time to show them at)."""
    model, at = (chosen.model, t) if carried is None else carried.shown(chosen.model, t)
    return (chosen.part, t) if model is chosen.model else (model.take(chosen.taken), at)


def _seen(chosen: _Chosen, part, t: float, settings, larger: float):
    """(how the chosen Gaussians look at a time, which of them the object's crops, filters and mask leave)."""
    shown = show(part, t, larger, look_numbers(settings, chosen.model.colour_space))
    seen = np.ones(len(chosen.index), bool)
    if settings.crops:
        seen &= kept_by(settings.crops, shown.position.astype(np.float64))
    if settings.filters or settings.mask:
        seen &= ~hidden(chosen.model, settings.filters, settings.mask)[chosen.taken]
    return shown, seen


def _together(parts: list[_Chosen], looks, shares: list[float]):
    """(index, Shown, seen) of all frames that show at once, echoes and fading loops.  Each frame gets its share of the points.

    Together they cover what their opacities let them: the points grow as the frames become more.
    """
    if len(parts) == 1 and shares[0] == 1:
        return parts[0].index, *looks[0]
    mine = [np.flatnonzero(shared_out(len(chosen.index), shares) == number) for number, chosen in enumerate(parts)]
    index = np.concatenate([chosen.index[m] for chosen, m in zip(parts, mine)])
    order = np.argsort(index, kind="stable")
    position, axes, colour = (np.concatenate([getattr(shown, name)[m] for (shown, _), m in zip(looks, mine)])[order]
                              for name in ("position", "axes", "colour"))
    seen = np.concatenate([seen[m] for (_, seen), m in zip(looks, mine)])[order]
    return index[order], Shown(position, axes * np.float32(np.sqrt(np.sum(shares))), colour), seen


def _write(obj, index, shown: Shown, seen):
    """Move every vertex of an octahedron to the ellipsoid of its Gaussian; octahedra without a Gaussian shrink to a point."""
    mesh, turn = obj.data, model_space.model_matrix(obj)
    number = arrays.read(mesh.attributes[GAUSSIAN].data, "value", np.int32)
    row = np.minimum(np.searchsorted(index, number), len(index) - 1)
    at = arrays.points(mesh)
    offset = arrays.read(mesh.attributes[OFFSET].data, "vector", np.float32, 3)
    drawn = offset.any(1) | (point_edits.OPACITY not in mesh.attributes)  # of all points, modifiers have the last word
    ours = (index[row] == number) & drawn
    row, offset = row[ours], offset[ours]
    place = shown.position[row] + np.einsum("mij,mj->mi", shown.axes[row], offset * seen[row, None])
    at[ours] = transformed(place, turn)
    at[drawn & ~ours & (number >= 0)] = transformed(shown.position[:1], turn)
    mesh.vertices.foreach_set("co", at.ravel())
    colour = arrays.read(mesh.attributes[COLOUR].data, "color", np.float32, 4)
    colour[ours, :3] = (shown.colour @ rec709_to_working().T)[row]
    mesh.attributes[COLOUR].data.foreach_set("color", colour.ravel())
    mesh[MOVED] = True

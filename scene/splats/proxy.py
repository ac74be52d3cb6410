# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the small mesh that stands for a 4D model in the scene: coloured points, never the Gaussians.

Points alone are drawn by no other engine, so one Geometry Nodes group (shared by all splat objects of a .blend, proxy_nodes.py) puts
a small octahedron on each while Blender evaluates the scene; moving.py then gives it the place and the form that its Gaussian has at
the time.  What is stored stays the points.  Where viewports draw the splats themselves (scene/proxies.py), all that is left of the
points there is the edges of the box around their subject.
"""
from dataclasses import replace

import bpy
import numpy as np

from ...fastgs_blender.model.sequence import Source
from ...fastgs_blender.rendering.colour import linear_to_srgb
from .. import model_space, point_edits
from ..colour import linear, rec709_to_working
from .proxy_nodes import COLOUR, GAUSSIAN, LARGER, LEVELS, NONE, RADIUS, SHADE, give_modifier
from .proxy_points import GOLDEN, LIMIT, Points, choose

__all__ = ["EVERY", "LIMIT", "fill", "limit_of", "new_mesh", "prepare", "show_in_all_engines"]

CORNERS = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]], bool)
"""Of the subject's box, those that are vertices too: they hold its extent, and with them few or flat points have a place in space."""
FLAT = 1e-3
POINTS = "fastgs_points"
"""Custom property of a proxy's mesh: how many vertices it was made with."""
LIMITED = "fastgs_limit"
"""Custom property: the most points that were asked for."""
EVERY = -1
"""As a limit: a point for each Gaussian, as *Modifiers Change: Splats* wants it.  No more octahedra than otherwise are drawn for them."""


def new_mesh(name: str, model: Source, limit: int = LIMIT, matrix: np.ndarray | None = None) -> bpy.types.Mesh:
    """A mesh of the model's most important Gaussians (at most `limit`), with the attributes that proxy_nodes.py reads.

    matrix  [4, 4] from the model's space to the object's; by default they are the same
    """
    mesh = bpy.data.meshes.new(name)
    fill(mesh, model, limit, matrix)
    return mesh


def limit_of(mesh: bpy.types.Mesh) -> int:
    """The largest number of points that was asked for when the mesh was made."""
    return mesh.get(LIMITED, LIMIT)


def fill(mesh: bpy.types.Mesh, model: Source, limit: int = LIMIT, matrix: np.ndarray | None = None) -> None:
    """Replace the mesh's points by those of the model; materials and everything else that hangs on the mesh stay."""
    points = _every(model) if limit == EVERY else prepare(model, limit)
    place = np.concatenate([points.position, _corners(points.subject)]).astype(np.float64)
    mesh.clear_geometry()
    for name in (COLOUR, RADIUS, GAUSSIAN, SHADE, *point_edits.ATTRIBUTES):
        if mesh.attributes.get(name) is not None:
            mesh.attributes.remove(mesh.attributes[name])
    mesh.vertices.add(len(place))
    model_space.write(mesh, place, np.eye(4) if matrix is None else matrix)
    _write(mesh, points, len(place))
    mesh[POINTS], mesh[LIMITED], mesh[LARGER] = len(place), limit, points.larger
    mesh.update()


def prepare(model: Source, limit: int = LIMIT) -> Points:
    """Choose the Gaussians of a proxy and cache them.  This takes most of the time; a thread may do it beforehand for models that stay
    in memory."""
    return choose(model, min(LIMIT if limit == EVERY else limit, LIMIT - len(CORNERS)))


def _every(source: Source) -> Points:
    """All Gaussians, of a sequence those of its first frame, in their order; those that prepare() chooses have a radius."""
    model, _ = source.moment(0.0, hold=True)
    chosen = prepare(model)
    now = point_edits.state(model, chosen.t)
    radius = np.full(len(model), NONE, np.float32)
    radius[chosen.index] = chosen.radius
    return replace(chosen, index=np.arange(len(model)), position=now.position, colour=linear(now.colour, model.colour_space), radius=radius)


def _write(mesh, points: Points, count: int):
    def padded(values, last):
        return np.concatenate([values, np.full((count - len(values), *values.shape[1:]), last, values.dtype)])

    colour = mesh.color_attributes.new(COLOUR, 'FLOAT_COLOR', 'POINT')
    rgb = padded((points.colour @ rec709_to_working().T).astype(np.float32), 0)
    colour.data.foreach_set("color", np.c_[rgb, np.ones(count, np.float32)].ravel())
    mesh.color_attributes.active_color = colour
    mesh.color_attributes.render_color_index = mesh.color_attributes.find(COLOUR)
    mesh.attributes.new(RADIUS, 'FLOAT', 'POINT').data.foreach_set("value", padded(points.radius, 0))
    mesh.attributes.new(GAUSSIAN, 'INT', 'POINT').data.foreach_set("value", padded(points.index.astype(np.int32), -1))
    mesh.attributes.new(SHADE, 'INT8', 'POINT').data.foreach_set("value", padded(_shades(points.colour), 0))


def _corners(box: np.ndarray) -> np.ndarray:
    """Four corners [4, 3] of a box [2, 3], which lie in no plane; a flat box is made a little thicker."""
    extent = box[1] - box[0]
    thin = FLAT * extent.max() if extent.max() > 0 else 1.0
    low, high = box[0] - 0.5 * np.maximum(thin - extent, 0), box[1] + 0.5 * np.maximum(thin - extent, 0)
    return np.where(CORNERS, high, low)


def _shades(colour: np.ndarray) -> np.ndarray:
    """Number [M] of the palette's material for each linear colour [M, 3].  Rounding errors are diffused to neighbours; channels are
    rounded alike, so that greys become greys."""
    spread = (np.arange(len(colour))[:, None] * GOLDEN) % 1
    level = np.clip(np.floor(linear_to_srgb(np.clip(colour, 0, 1)) * (LEVELS - 1) + spread), 0, LEVELS - 1).astype(np.int32)
    return level @ np.array([LEVELS * LEVELS, LEVELS, 1], np.int32)


def show_in_all_engines(obj: bpy.types.Object) -> None:
    """Give the object the modifier that makes its points visible in Solid view and in every render engine."""
    give_modifier(obj)

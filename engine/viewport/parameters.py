# SPDX-License-Identifier: GPL-3.0-or-later
"""What changes from frame to frame, as one small texture: a row for the view and one for each object (glsl.py reads it)."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...fastgs_blender.cameras.camera import Camera
from ...fastgs_blender.model.motion import Basis
from ...fastgs_blender.rendering.instances import ViewedInstance
from .atlas import Atlas
from .textures import WIDTH

NONE, WEIGHTS, POWERS = range(3)


@dataclass(frozen=True)
class Depths:
    """How a window's depth 0..1 follows from the distance z along the view: a + b / z, or a + b z in orthographic views."""

    a: float = 0.0
    b: float = 0.0


def table(camera: Camera, parts: list[ViewedInstance], atlas: Atlas, count: int, groups: dict[int, int], depths: Depths | None,
          depth_size=(1, 1)) -> np.ndarray:
    """float32 [1 + objects, width, 4].

    count      Gaussians that are drawn
    groups     which group of colours (picture.py) a part belongs to, by its place in parts
    depths     of the depth picture to test against, which has depth_size; None: no test
    """
    rows, first = [_view(camera, len(parts), count, depths, depth_size)], 0
    for number, part in enumerate(parts):
        rows.append(_object(camera, part, atlas, first, groups[number]))
        first += len(part.model)
    out = np.zeros((len(rows), max(len(row) for row in rows), 4), np.float32)
    for line, row in zip(out, rows):
        line[:len(row)] = row
    return out


def _view(camera, objects, count, depths, depth_size):
    test = depths or Depths()
    return [
        (camera.width, camera.height, camera.fx, camera.fy),
        (camera.cx, camera.cy, camera.orthographic, objects),
        camera.tangent_limits(),
        (test.a, test.b, depths is not None, 0),
        # whole numbers beyond 2^24 do not fit into a float: split
        (count // WIDTH, count % WIDTH, *depth_size),
    ]


def _object(camera, part, atlas, first, group):
    model, place, raster = part.model, atlas.place(part.model), part.model.raster
    plan = place.plan
    to_camera, to_model = part.model_to_camera, part.camera_to_model
    moving, move_first, move_weights = _basis(model.basis, part.t, 4)
    turning, turn_first, turn_weights = _basis(model.rotation_basis, part.t, 1)
    eye = to_model[:3, 2 if camera.orthographic else 3]
    return [
        *to_camera[:3],
        (*eye, raster.antialiased),
        (place.geometry // WIDTH, place.geometry % WIDTH, plan.geometry, plan.look),
        (place.colour // WIDTH, place.colour % WIDTH, plan.colour, plan.degree),
        (part.t, model.temporal_kind.code, moving, plan.groups),
        (move_first, len(move_weights), turning, plan.turns),
        (turn_first, len(turn_weights), group, first // WIDTH),
        (part.near, raster.alpha_max, raster.alpha_cut, raster.blur),
        (first % WIDTH, 0, 0, 0),
        *move_weights, *((w[0], 0, 0, 0) for w in turn_weights),
    ]


def _basis(basis: Basis, t: float, size: int):
    """(mode, first run that counts, weights of the runs that count [m, size]); a run is `size` terms."""
    if basis.terms == 0:
        return NONE, 0, np.zeros((0, size))
    if basis.centred:
        return POWERS, 0, np.zeros((0, size))
    weights = np.zeros(-(-basis.terms // size) * size)
    weights[:basis.terms] = basis.weights(t)
    runs = weights.reshape(-1, size)
    used = np.flatnonzero(runs.any(1))
    first, last = (used[0], used[-1] + 1) if len(used) else (0, 0)
    return WEIGHTS, int(first), runs[first:last]

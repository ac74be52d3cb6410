# SPDX-License-Identifier: GPL-3.0-or-later
"""The parameters of shaders that change from frame to frame, as one small texture: a row for the view and one for each instance.

The splats' shaders (splat.py) read it by the same names.
"""
from collections.abc import Callable, Collection
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from ...cameras.camera import Camera
from ...model.gaussians import GaussianModel
from ...model.motion import Basis
from ...rendering.instances import ViewedInstance
from ...rendering.looks import LOOK_NUMBERS
from . import model_texels
from .model_texels import WIDTH

ORDER_WIDTH = 4096
"""Entries in a row of the texture that holds the order of the splats; filled into the shaders."""

NOTHING = -1.0
"""A farthest depth that leaves nothing to draw."""

NONE, WEIGHTS, POWERS = range(3)
"""How a basis reaches the shader: it has no terms, as weights of its terms at this time, or as powers of t - mu_tau."""


class ViewTexel(IntEnum):
    """Places in the view's row.

    SIZE    width, height, fx, fy
    CENTRE  cx, cy, orthographic, number of instances
    LIMITS  of the Jacobian's tangents, see Camera.tangent_limits()
    DEPTHS  see Depths; whether there is a depth picture; number of the colour group that is drawn
    COUNTS  Gaussians that are drawn, in rows of WIDTH and the rest; width and height of the depth picture
    """

    SIZE = 0
    CENTRE = 1
    LIMITS = 2
    DEPTHS = 3
    COUNTS = 4


class InstanceTexel(IntEnum):
    """Places in an instance's row, before the weights of its bases.

    TO_CAMERA  three rows from the model's space to the camera's
    EYE        the camera's centre (orthographic: its direction) in the model's space; antialiased
    GEOMETRY   first texel, in rows of WIDTH and the rest; texels of a Gaussian; what the colour texels hold
    COLOUR     first texel, likewise; texels of a Gaussian; degree of the harmonics
    CHANGES    of the colours: how their basis comes, its terms, first run of its weights, number of runs
    TIME       t, code of the temporal opacity, how the motion's basis comes, texels of an axis of the motion
    BASES      first run of the motion's weights, number of runs; how the rotation's basis comes, its terms
    GROUP      first run of the rotation's weights, number of runs; colour group; rows of FIRST
    RASTER     near, alpha_max, alpha_cut, blur
    FIRST      place of the first Gaussian among those of all instances, beyond its rows of WIDTH; depth of the farthest to draw; of
               ViewedInstance.sampling (distance.py): pixel, zoom
    BEYOND     the ball that holds the capture's cameras: centre, radius
    SAMPLING   coarse, least, reach, number of the cameras, which follow the weights of the bases with two texels each
    LOOK       five texels of the instance's looks, see rendering/looks.py
    """

    TO_CAMERA = 0
    EYE = 3
    GEOMETRY = 4
    COLOUR = 5
    CHANGES = 6
    TIME = 7
    BASES = 8
    GROUP = 9
    RASTER = 10
    FIRST = 11
    BEYOND = 12
    SAMPLING = 13
    LOOK = 14


HEAD = InstanceTexel.LOOK + LOOK_NUMBERS // 4
"""Texels of an instance's row before the weights of its bases."""


@dataclass(frozen=True)
class Depths:
    """How a window's depth 0..1 follows from the distance z along the view: a + b / z, or a + b z in orthographic views."""

    a: float = 0.0
    b: float = 0.0


def frame_table(camera: Camera, instances: list[ViewedInstance], place: Callable[[GaussianModel], model_texels.Place], count: int,
                groups: dict[int, int], depths: Depths | None, depth_size: tuple[int, int] = (1, 1),
                gone: Collection[int] = frozenset()) -> np.ndarray:
    """The table as float32 [1 + instances, width, 4].

    place       where the texels of an instance's model begin
    count       how many Gaussians are drawn
    groups      number of the colour group (picture.py) of each instance, by its place in `instances`
    depths      of the depth picture that hides splats; None: nothing hides them
    depth_size  width and height of that picture
    gone        places in `instances` of those of which nothing is drawn
    """
    rows, first = [_view_row(camera, len(instances), count, depths, depth_size)], 0
    for number, instance in enumerate(instances):
        rows.append(_instance_row(instance, place(instance.model), first, groups[number], NOTHING if number in gone else instance.far))
        first += len(instance.model)
    out = np.zeros((len(rows), max(len(row) for row in rows), 4), np.float32)
    for line, row in zip(out, rows):
        line[:len(row)] = row
    return out


def _view_row(camera: Camera, instances: int, count: int, depths: Depths | None, depth_size: tuple[int, int]) -> list[tuple]:
    test = depths or Depths()
    return [
        (camera.width, camera.height, camera.fx, camera.fy),
        (camera.cx, camera.cy, camera.orthographic, instances),
        camera.tangent_limits(),
        (test.a, test.b, depths is not None, 0),
        # whole numbers beyond 2^24 do not fit into a float: split
        (count // WIDTH, count % WIDTH, *depth_size),
    ]


def _instance_row(instance: ViewedInstance, texels: model_texels.Place, first: int, group: int, far: float) -> list[tuple]:
    """The texels of an instance's row; `first` is its first Gaussian's place among all, texels where its texels begin."""
    model, raster, layout, sampling = instance.model, instance.model.raster, texels.layout, instance.sampling
    to_camera, to_model = instance.model_to_camera, instance.camera_to_model
    moving, move_first, move_weights = _basis(model.basis, instance.t, 4)
    turning, turn_first, turn_weights = _basis(model.rotation_basis, instance.t, 1)
    changing, change_first, change_weights = _basis(model_texels.changes_of(model), instance.t, 1)
    eye = to_model[:3, 2 if instance.camera.orthographic else 3]
    head = [
        *to_camera[:3],
        (*eye, raster.antialiased),
        (texels.geometry // WIDTH, texels.geometry % WIDTH, layout.geometry, layout.colours),
        (texels.colour // WIDTH, texels.colour % WIDTH, layout.colour, layout.degree),
        (changing, layout.changes, change_first, len(change_weights)),
        (instance.t, model.temporal_kind.code, moving, layout.groups),
        (move_first, len(move_weights), turning, layout.turns),
        (turn_first, len(turn_weights), group, first // WIDTH),
        (instance.near, raster.alpha_max, raster.alpha_cut, raster.blur),
        (first % WIDTH, far, sampling.pixel, sampling.zoom),
        sampling.ball,
        (sampling.coarse, sampling.least, sampling.reach, len(sampling.cameras)),
        *instance.look.reshape(-1, 4),
    ]
    assert len(head) == HEAD
    return [*head, *move_weights, *((w[0], 0, 0, 0) for w in (*turn_weights, *change_weights)), *sampling.cameras.reshape(-1, 4)]


def _basis(basis: Basis, t: float, size: int) -> tuple[int, int, np.ndarray]:
    """(NONE, WEIGHTS or POWERS; the first run of terms whose weights are not 0; weights [m, size] from it to the last such run).

    A run is `size` terms, which one texel of the model holds.
    """
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

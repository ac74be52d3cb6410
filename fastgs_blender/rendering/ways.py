# SPDX-License-Identifier: GPL-3.0-or-later
"""The ways of light: which share of what a point of a lamp sends comes past meshes and splats to points of a scene.

A camera stands at the point of the lamp, and the scene's points are asked for one by one (passing.py).  So shadows have no pixels of their
own: they are as sharp as what throws them, and they do not flicker while things move.
"""
from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from typing import Any

import numpy as np

from ..cameras.camera import Camera
from ..model.appearance import RGB
from ..model.gaussians import GaussianModel
from ..model.slicing import Slice, opacities_at, still
from ..util import rotations
from ..util.threads import product, taken
from .holdout import between
from .instances import Instance

WIDEST = 8.0
"""Tangent up to which a picture from a point of a lamp reaches to each side."""
NARROW = 0.4
"""Cosine of the angle around its middle up to which one picture is taken from a lamp; six are where it shines farther around."""
REACH = 3.5
"""Standard deviations up to which a Gaussian may throw a shadow."""
BLUR = 0.025
"""Variance in pixels^2 by which splats are wider in a picture: just so much that hardly any falls between pixels at a tile's border."""
FEW = 1024
"""Points up to which one picture shows them all, and of more, about as many as tell where a picture looks and where most of them lie."""
APART = 4
"""How many times as wide a picture of all points has to be as one of the crowd, for each of the two to have one."""
SEEN = 1.5
"""How many times as large a splat may be in a picture: its projection is linearised."""


@dataclass(frozen=True, eq=False)
class Side:
    """What may throw shadows on the points that a picture from a lamp shows: instances, or parts of them, and triangles [F, 3, 3] at each
    moment (Ways)."""

    instances: list[Instance]
    moments: Sequence[np.ndarray]

    @cached_property
    def corners(self) -> np.ndarray:
        """Of a box around the triangles at all moments [3, 8]."""
        found = np.concatenate([_bounds(each.reshape(-1, 3).T) for each in self.moments])
        return _bounds(found.T)[_CHOICES, np.arange(3)].T

    def throws(self, eye: Camera) -> bool:
        """Whether any of its triangles may lie before a camera."""
        if not self.moments or not len(self.moments[0]):
            return False
        x, y, z = product(eye.world_to_camera[:3, :3], self.corners) + eye.world_to_camera[:3, 3:]
        x, y, deep = eye.fx * x, eye.fy * y, np.ones(8) if eye.orthographic else z
        beside = x + eye.cx * deep < 0, x + (eye.cx - eye.width) * deep > 0, y + eye.cy * deep < 0, y + (eye.cy - eye.height) * deep > 0
        return not (any(outside.all() for outside in beside) or (z < eye.near).all() or (z > eye.far).all())


@dataclass(frozen=True, eq=False)
class Sides:
    """The pictures from each point of a lamp that show all points well: one, or those through the sides of a cube.

    ways    the scene that the light crosses
    light   the lamp's points (shadow.Light)
    whole   what the one shows; None: there is a cube
    centre  of the cube [3]
    radius  how far from it the lamp's points lie
    deep    how far from it points lie, at most, along an axis
    found   the cube's sides by their numbers, once they have been asked for
    """

    ways: Ways
    light: Any
    whole: Side | None
    centre: np.ndarray
    radius: float
    deep: float
    found: dict[int, Side] = field(default_factory=dict)

    def past(self, number: int, places: np.ndarray, size: int, over_meshes: float = 0.0,
             over_splats: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Which share of the light of the lamp's point `number` comes past the meshes, and past the splats, to points: [P] each.

        places  [3, S, P] each point as several places, over which the shadows of meshes are averaged; splats', which are soft, are those
                of the first
        size   pixels of the longer side of the picture, or of a right angle of it
        over_meshes, over_splats  how near to a point these throw no shadow on it, in units of the world: a number, of splats also [P]
        """
        (_, several, count), backend = places.shape, self.ways.backend
        meshes, splats = np.ones(several * count, np.float32), np.ones(count, np.float32)
        over = np.broadcast_to(np.float64(over_splats), count)
        for side, there, among in self._split(places.reshape(3, -1)):
            for eye, points, rows in self._views(number, there, among, size):
                if side.throws(eye):
                    last = len(side.moments) - 1
                    at = 0.0 if self.light.times is None else self.light.times[number] * last
                    triangles = between(side.moments[int(at)], side.moments[min(int(at) + 1, last)], at % 1)
                    found = backend.past_triangles(triangles, eye, points, np.full(len(rows), float(over_meshes)))
                    meshes[rows] = backend.numpy(found)
                viewed, first = [each.viewed(eye) for each in side.instances], np.searchsorted(rows, count)  # those of first places
                if viewed and first:
                    found = backend.past_splats(viewed, eye, points[:, :first], over[rows[:first]])
                    splats[rows[:first]] = backend.numpy(found)
        return meshes.reshape(several, count).mean(0), splats

    def _views(self, number: int, points: np.ndarray, rows: np.ndarray, size: int) -> Iterator[tuple[Camera, np.ndarray, np.ndarray]]:
        """Pictures that show points [3, Q] well, of those rows [Q] among more: (camera, the points that it shows, their rows) of each."""
        ways, light = self.ways, self.light
        eye = view_from(light.parallel, light.points[number], points, ways.around, size, ways.backend) if len(rows) else None
        if eye is None:
            return
        crowd = _crowd(eye, points)
        if crowd is None:
            yield eye, points, rows
            return
        for some in (crowd, ~crowd):
            yield from self._views(number, points[:, some], rows[some], size)

    def _split(self, points: np.ndarray) -> Iterator[tuple[Side, np.ndarray, np.ndarray]]:
        """Points [3, P] by the side that shows them: the side, its points, and which they are."""
        if self.whole is not None:
            yield self.whole, points, np.arange(points.shape[1])
            return
        towards = points - self.centre[:, None]
        x, y, z = np.abs(towards)
        by_x, ahead = x >= np.maximum(y, z), towards > 0
        by_y = (y >= z) & ~by_x
        for axis, mine in enumerate((by_x, by_y, ~(by_x | by_y))):
            for sign, mask in enumerate((mine & ~ahead[axis], mine & ahead[axis])):
                rows = np.flatnonzero(mask)
                if len(rows):
                    yield self._through(2 * axis + sign), np.take(points, rows, 1), rows

    def _through(self, number: int) -> Side:
        """A side of the cube; number: two for each axis, the negative side first."""
        if number not in self.found:
            axis, sign = number // 2, 2 * (number % 2) - 1

            def may_shade(position: np.ndarray, reach: np.ndarray) -> np.ndarray:
                """Which balls around positions [3, N] light may touch on its way: [M]."""
                towards, reach = position - self.centre.astype(np.float32)[:, None], reach + np.float32(self.radius)
                ahead = sign * towards[axis]
                inside, beside = (ahead >= -reach) & (ahead <= self.deep + reach), ahead + np.float32(2**0.5) * reach
                for k in {0, 1, 2} - {axis}:
                    inside &= np.abs(towards[k]) <= beside
                return np.flatnonzero(inside)

            ways = self.ways
            inside = [(each, may_shade(*balls)) for each, balls in zip(ways.instances, ways.balls, strict=True)]
            triangles = may_shade(*ways.circles) if ways.moments else np.zeros(0, int)
            self.found[number] = Side([each.part(index) for each, index in inside if len(index)],
                                      [each[triangles] for each in ways.moments])
        return self.found[number]


class Ways:
    """A scene as light crosses it.

    backend    a loaded backend (util/backends.py)
    instances  whose splats throw shadows
    meshes     triangles [F, 3, 3] float32 in the world that throw shadows, or None
    once       whether they are looked at only once
    moments    the meshes at times evenly spread over an exposure; empty: they stand still
    """

    def __init__(self, backend: Any, instances: Sequence[Instance], meshes: np.ndarray | None, once: bool = False,
                 moments: Sequence[np.ndarray] = ()):
        self.backend, self.moments = backend, moments or [each for each in (meshes,) if each is not None and len(each)]
        self.instances = [_plain(each) if once else _bare(each, backend) for each in instances if len(each.model)]

    def of_lamp(self, name: str, clear: np.ndarray | None = None) -> Ways:
        """The scene without what lets through the light of a lamp of that name: instances that say so, and triangles of a mask [F]."""
        opaque = [each for each in self.instances if name not in each.settings.clear_to]
        if clear is None and len(opaque) == len(self.instances):
            return self
        made = Ways(self.backend, [], None, moments=self.moments if clear is None else [each[~clear] for each in self.moments])
        made.instances = opaque
        return made

    def sides(self, light: Any, points: np.ndarray, beside: np.ndarray | float = 0.0) -> Sides:
        """The pictures from a lamp (shadow.Light) for points [3, P], or for places so far beside them, at most: [P] or a number."""
        centre, everything = light.points.mean(0), Side(self.instances, self.moments)
        if light.parallel or not points.size:
            return Sides(self, light, everything, centre, 0.0, 0.0)
        radius, towards = float(np.linalg.norm(light.points - centre, axis=1).max()), points - centre[:, None]
        (x, y, z), middle = towards, _bounds(towards).mean(0)
        one = (product(middle, towards) >= NARROW * np.sqrt((x * x + y * y + z * z) * (middle @ middle))).all()
        return Sides(self, light, everything if one else None, centre, radius, float((np.abs(towards).max(0) + beside).max()))

    @cached_property
    def around(self) -> np.ndarray:
        """Points [Q, 3] around all that may throw shadows."""
        boxes = [_bounds(each.reshape(-1, 3).T)[_CHOICES, np.arange(3)] for each in self.moments if len(each)]
        return np.concatenate([_corners(self.instances), *boxes])

    @cached_property
    def balls(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Of each instance, its Gaussians' centres [3, N] in the world and how far from these they may be seen [N]."""
        found = []
        for each in self.instances:
            size = SEEN * REACH * np.linalg.norm(each.placement[:3, :3], 2) * each.settings.splat_scale
            largest = np.exp(reduce(np.maximum, each.model.scale.T))
            reach = np.maximum(np.float32(size) * largest, np.float32(SEEN * each.settings.min_size))
            centre = product(each.placement[:3, :3], each.model.position.T) + each.placement[:3, 3:]
            found.append((centre.astype(np.float32), reach))
        return found

    @cached_property
    def circles(self) -> tuple[np.ndarray, np.ndarray]:
        """Of each triangle the centre [3, F] and the radius [F] of a ball that holds it at all moments."""
        corners = np.concatenate([each.T for each in self.moments], 1)
        low, high = corners.min(1), corners.max(1)
        return (low + high) / 2, np.sqrt(((high - low) ** 2).sum(0)) / 2


def without_colours(model: GaussianModel) -> GaussianModel:
    """A model all of whose Gaussians are black."""
    return replace(model, features=np.zeros((len(model), 3), np.float32), appearance=RGB())


def _plain(instance: Instance) -> Instance:
    """The instance without colours, which are nothing to shadows; its splats hide as much in a picture of few pixels as in one of many."""
    raster = replace(instance.model.raster, blur=BLUR, antialiased=True)
    return replace(instance, model=replace(without_colours(instance.model), raster=raster))


def _bare(instance: Instance, backend: Any) -> Instance:
    """The same as it is at its time, without those of its Gaussians that have faded away."""
    instance = _plain(instance)
    model = instance.model
    opacity = opacities_at(model, instance.t)
    index = np.flatnonzero(opacity >= model.raster.alpha_cut)
    place, turn, _ = backend.posed(instance, index)
    scale, black = np.exp(taken([model.scale], index)[0]), np.zeros((len(index), 3), np.float32)
    now = Slice(index, place, turn, scale, opacity[index], black, black)
    return replace(instance.part(index, still(model, now)), t=0.0)


def _bounds(points: np.ndarray) -> np.ndarray:
    """The least and the largest coordinates [2, 3] of points [3, P]."""
    return np.array([[row.min(), row.max()] for row in points]).T


def view_from(parallel: bool, place: np.ndarray, points: np.ndarray, around: np.ndarray, size: int, backend: Any) -> Camera | None:
    """The camera at a point of a lamp that sees all points [3, P], None where they all lie behind it.

    around  [Q, 3] points around what may throw shadows on them: the rays of a sun begin before these
    size    pixels of the picture's longer side, or of a right angle where it is wider
    backend  a loaded backend (util/backends.py)
    """
    some = points[:, ::max(points.shape[1] // FEW, 1)] - place[:, None]
    forward = -place if parallel else (some / np.maximum(np.sqrt((some * some).sum(0)), 1e-30)).mean(1)  # places far away count no more
    forward = forward / max(np.linalg.norm(forward), 1e-30)
    right, down = across(forward)
    axes = np.stack([right, down, forward])
    if parallel:  # from before everything
        low, high = backend.view_box(points, np.eye(3, 4), True)
        middle = (low + high) / 2
        reach = max(np.linalg.norm(high - low) / 2, np.linalg.norm(around - middle, axis=1).max(initial=0))
        place = middle - 4 * reach * forward
    pose = rotations.transform(axes, -axes @ place)
    box = backend.view_box(points, pose[:3], parallel)
    if not np.isfinite(box).all():
        return None
    low, high = box[:, :2] if parallel else np.clip(box[:, :2], -WIDEST, WIDEST)
    extent = max((high - low).max(), 1e-9 * max(np.abs([low, high]).max(), 1))
    focal = size / (extent if parallel else min(extent, 2.0))
    width, height = np.ceil((high - low) * focal).astype(int) + 3
    cx, cy = 1.5 - low * focal
    return Camera(int(width), int(height), focal, focal, cx, cy, pose, orthographic=parallel, near=0.0, far=float(box[1, 2]))


def _crowd(eye: Camera, points: np.ndarray) -> np.ndarray | None:
    """Which of points [3, P] lie close together in a picture while the others make it far wider: [P].  None where it shows all well.

    A capture's backdrop has a few Gaussians of its whole size.  In one picture with them the rest would lie in a few pixels.  (Tukey's
    fences: two widths of the middle half to each side of its middle.)
    """
    if points.shape[1] < FEW:
        return None

    def pixels(points: np.ndarray) -> np.ndarray:
        return eye.pixels((product(eye.world_to_camera[:3, :3], points) + eye.world_to_camera[:3, 3:]).T)

    some = pixels(points[:, ::points.shape[1] // FEW])
    quarter = len(some) // 4
    low, high = np.array([np.partition(axis, (quarter, -1 - quarter))[[quarter, -1 - quarter]] for axis in some.T]).T
    reach = np.maximum(2 * (high - low), 1)
    if not 2 * APART * reach.max() <= max(eye.width, eye.height):
        return None
    near = (np.abs(pixels(points) - (low + high) / 2) <= reach).all(1)
    return None if near.all() or not near.any() else near


def across(direction: np.ndarray) -> np.ndarray:
    """Two unit vectors [2, 3] that make a right-handed system with a unit vector."""
    (x, y, z), least = direction.tolist(), int(np.abs(direction).argmin())
    first = np.array([(0, -z, y), (z, 0, -x), (-y, x, 0)][least])  # an axis x the direction
    a, b, c = first = first / np.linalg.norm(first)
    return np.array([first, (y * c - z * b, z * a - x * c, x * b - y * a)])


def _corners(instances: Sequence[Instance]) -> np.ndarray:
    """The corners [8 K, 3] of the boxes around the Gaussians of K instances, twice as large for their motion, in the world."""
    found = [np.zeros((0, 3))]
    for instance in instances:
        low, high = _bounds(instance.model.position.T).astype(np.float64)
        middle, half = (low + high) / 2, high - low
        found.append(rotations.transformed(middle + _SIGNS * half, instance.placement))
    return np.concatenate(found)


_CHOICES = np.stack(np.meshgrid(*[(0, 1)] * 3), -1).reshape(-1, 3)
_SIGNS = 2 * _CHOICES - 1

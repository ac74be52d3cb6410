# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera moves around what given cameras look at: an orbit, a dolly, a path through them.  moves.py has the curves.

A function takes cameras of one world, whatever its axes, and gives a camera for each frame.  What points up is what these cameras hold
upwards.
"""
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..util import rotations
from ..util.arguments import integer, numbers, real, shown
from ..util.errors import FastGSError
from . import moves, poses
from .camera import Camera


def focus(cameras: Sequence[Camera]) -> np.ndarray:
    """The point [3] nearest to the optical axes of all cameras, in the least-squares sense; their mean place where these are parallel."""
    matrices = np.array([camera.world_to_camera for camera in cameras]).reshape(-1, 4, 4)
    if not len(matrices):
        return np.zeros(3)
    centres = -np.einsum("nij,ni->nj", matrices[:, :3, :3], matrices[:, :3, 3])
    across = np.eye(3) - np.einsum("ni,nj->nij", matrices[:, 2, :3], matrices[:, 2, :3])
    system = across.sum(0)
    if np.linalg.cond(system) > 1e6:
        return centres.mean(0)
    return np.linalg.solve(system, np.einsum("nij,nj->i", across, centres))


def orbit(cameras: Sequence[Camera], frames: int, *, centre: np.ndarray | None = None, turns: float = 1.0, elevation: float | None = None,
          distance: float | None = None, rise: float = 0.0, ease: float = 0.0) -> list[Camera]:
    """A camera for each frame, around a centre and looking at it; it begins where the first camera stands.

    centre     [3], default: what the cameras look at
    turns      of the whole move, negative: the other way round
    elevation  above the horizon in degrees, and distance from the centre; default: those of the first camera
    rise       by how many degrees the elevation changes
    ease       share of the time that is spent starting and stopping

    Example:
        path = fg.orbit([view.camera for view in fg.load_cameras("examples/cameras.json")], 48)
    """
    first = _first(cameras)
    middle = focus(cameras) if centre is None else _point(centre)
    turns, rise = real(turns, "the number of turns"), real(rise, "the rise")
    upright = _upright(cameras)
    away = upright @ (poses.inverse(first.world_to_camera)[:3, 3] - middle)
    radius = float(np.linalg.norm(away)) if distance is None else real(distance, "the distance")
    if not radius > 1e-9:
        raise FastGSError("an orbit needs a distance from its centre; the first camera stands in it, so give one.")
    above = np.arctan2(away[2], np.hypot(away[0], away[1])) if elevation is None else np.radians(real(elevation, "the elevation"))
    path = moves.orbit(_shares(frames, ease, closed=turns.is_integer() and not rise), np.zeros(3), radius, above,
                       np.arctan2(away[1], away[0]), turns, first.fx, np.radians(rise))
    turned = upright.T @ rotations.to_matrices(path.rotation) @ poses.OPENGL[:3, :3]
    return _cameras(first, path.position @ upright + middle, turned, path.focal)


def dolly(camera: Camera, frames: int, *, distance: float, subject: float | None = None, ease: float = 0.0) -> list[Camera]:
    """A camera for each frame, straight on by a distance (negative: backwards), its view turned as it is.

    subject  distance of what keeps its size in the picture (a dolly zoom); None: the lens stays

    Example:
        closer = fg.dolly(fg.load_cameras("examples/cameras.json")[0].camera, 48, distance=1.5)
    """
    pose = poses.inverse(_first([camera]).world_to_camera)
    distance, subject = real(distance, "the distance"), None if subject is None else real(subject, "the distance of the subject")
    path = moves.dolly(_shares(frames, ease), pose[:3, 3], rotations.from_matrices(pose[None, :3, :3])[0], pose[:3, 2], distance, camera.fx,
                       subject)
    return _cameras(camera, path.position, rotations.to_matrices(path.rotation), path.focal)


def through(cameras: Sequence[Camera], frames: int, *, closed: bool = False, ease: float = 0.0) -> list[Camera]:
    """A camera for each frame on a smooth path through the cameras in their order; closed: back to the first.

    Example:
        path = fg.through([view.camera for view in fg.load_cameras("examples/cameras.json")[:4]], 48)
    """
    first = _first(cameras)
    placed = np.array([poses.inverse(camera.world_to_camera) for camera in cameras])
    focal = np.array([camera.fx * first.width / camera.width for camera in cameras])
    keys = moves.Path(placed[:, :3, 3], rotations.one_sign(rotations.from_matrices(placed[:, :3, :3])), focal)
    path = moves.through(_shares(frames, ease, closed), keys, closed)
    return _cameras(first, path.position, rotations.to_matrices(path.rotation), path.focal)


def outside(path: Sequence[Camera], cameras: Sequence[Camera]) -> np.ndarray:
    """How far [M] each camera of a path lies outside of the region that the given cameras span."""
    places, region = (np.array([poses.inverse(camera.world_to_camera)[:3, 3] for camera in each]) for each in (path, cameras))
    still = moves.Path(places, np.zeros((len(places), 4)), np.zeros(len(places)))
    return moves.inside(still, region, 0.05 * float(np.linalg.norm(np.ptp(region, axis=0))))


def _first(cameras: Sequence[Camera]) -> Camera:
    if not len(cameras):
        raise FastGSError("a camera move needs a camera to begin with.")
    return cameras[0]


def _point(centre: np.ndarray) -> np.ndarray:
    point = numbers(centre, "the centre", "[3]")
    if point.shape != (3,) or not np.isfinite(point).all():
        raise FastGSError(f"the centre must be three finite numbers, not {shown(centre)}.")
    return point


def _shares(frames: int, ease: float, closed: bool = False) -> np.ndarray:
    """The share of the way at each frame; a closed way ends a frame before its beginning, so that it can be repeated."""
    frames = integer(frames, "the number of frames of a camera move", 1, moves.MOST_FRAMES)
    return moves.ease(np.arange(frames) / max(frames if closed else frames - 1, 1), real(ease, "the ease"))


def _upright(cameras: Sequence[Camera]) -> np.ndarray:
    """The rotation [3, 3] of the world after which the cameras' mean upward direction is +z."""
    up = -np.mean([camera.world_to_camera[1, :3] for camera in cameras], 0)
    if np.linalg.norm(up) < 0.1:
        up = -cameras[0].world_to_camera[1, :3]
    up = up / np.linalg.norm(up)
    right = np.cross(np.eye(3)[np.argmin(np.abs(up))], up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(up, right), up])


def _cameras(base: Camera, position: np.ndarray, turned: np.ndarray, focal: np.ndarray) -> list[Camera]:
    """Cameras like `base` at positions [M, 3], with camera-to-world rotations [M, 3, 3] in OpenCV axes and focal lengths [M]."""
    found = []
    for place, turn, fx in zip(position, turned, focal, strict=True):
        pose = poses.inverse(rotations.transform(turn, place))
        found.append(replace(base, fx=float(fx), fy=float(fx * base.fy / base.fx), world_to_camera=pose))
    return found

# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds where a camera looks, or stands, that was bumped after it was calibrated: its features are matched without its pose.

A camera that is off by more than a few pixels has no matches along the given lines, so that bundle adjustment cannot move it.  Points on
which other cameras agree, and which its features look like, say where it is: turned where it stands, or else moved, too.
"""
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...cameras.camera import Camera
from ...util import rotations
from . import features
from .features import Features, Track

FEW = 0.4
"""A camera with fewer points than this share of what cameras usually have is looked at."""
NEIGHBOURS = 8
"""Cameras whose points are looked for in its picture."""
TURNED, MOVED, SHARE = 6, 24, 0.35
"""Points that must agree on a turn, or on a turn and a move, and their share of those that were matched: fewer agree by chance."""
RIGHT, MORE = 16, 4
"""Points that a camera must have where it is put, and how many times as many as where it was."""
AS_GOOD = 0.8
"""A turn alone is taken where this share of the points that agree on a turn and a move agree on it."""
AGREE, CLOSE = 4.0, 2.0
"""Pixels within which a point votes for a pose, and within which it agrees with it."""
OFF = 1.5
"""Pixels by which the given pose must miss half of the points that agree."""
TRIED, ROUNDS = 64, 4
"""Points of which all pairs are tried, and rounds in which those that vote are turned together."""


def placed_again(found: Sequence[Features], within: float, count: int) -> tuple[dict[int, np.ndarray], list[Track]]:
    """World-to-camera [4, 4] of each picture, by its number, whose features say that its camera stands or looks elsewhere; and the tracks
    of the features with these.

    found          features of the pictures of one moment, with the given cameras
    within, count  as features.tracks() has them
    Raises FastGSError where pycolmap is not installed.
    """
    tracks, points, seen, number = _agreed(found, within, count)
    few = np.flatnonzero(number < FEW * np.median(number)).tolist()
    poses = {k: pose for k in few if (pose := _pose(found, k, points, seen)) is not None}
    while poses:
        again, _, _, now = _agreed([at(each, poses.get(k)) for k, each in enumerate(found)], within, count)
        right = {k: pose for k, pose in poses.items() if now[k] >= max(RIGHT, MORE * number[k])}
        if len(right) == len(poses):
            return poses, again
        poses = right
    return {}, tracks


def at(found: Features, pose: np.ndarray | None) -> Features:
    """The features, with their camera at another pose, if there is one."""
    return found if pose is None else replace(found, camera=replace(found.camera, world_to_camera=pose))


def _agreed(found: Sequence[Features], within: float, count: int) -> tuple[list[Track], np.ndarray, list[Track], np.ndarray]:
    """All tracks; points [P, 3] on which three pictures agree, and their tracks; how many of these each picture has."""
    tracks = features.tracks(list(found), within, count)
    points, seen = features.triangulated(list(found), 3, tracks)
    return tracks, points, seen, np.bincount(np.array([k for track in seen for k, _ in track], np.int64), minlength=len(found))


def pose_by_points(places: np.ndarray, points: np.ndarray, camera: Camera) -> np.ndarray | None:
    """World-to-camera [4, 4] of a pinhole camera that sees points [N, 3] at places [N, 2], some of them wrong; None where that is not sure,
    or where its given pose does as well."""
    if len(places) < TURNED:
        return None
    given, found = _errors(camera, places, points), []
    for pose in (turned_by_points(places, points, camera), _moved(places, points, camera)):
        near = np.zeros(len(places), bool) if pose is None else _errors(replace(camera, world_to_camera=pose), places, points) < CLOSE
        found.append((pose, int(near.sum()), near.any() and np.median(given[near]) > OFF))
    pose, agree, off = found[0] if found[0][1] >= AS_GOOD * found[1][1] else found[1]
    least = TURNED if pose is found[0][0] else MOVED
    return pose if off and agree >= max(least, SHARE * len(places)) else None


def turned_by_points(places: np.ndarray, points: np.ndarray, camera: Camera) -> np.ndarray:
    """World-to-camera [4, 4] of a camera that sees points [N, 3] at places [N, 2], N >= 2, and stands where it was.

    Two rays fix a turn: that of the pair with which most points agree, and then of all of these together (Kabsch).
    """
    step = -(-len(places) // TRIED)
    plane = (places - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    own, world = _unit(np.c_[plane, np.ones(len(plane))]), _unit(points - camera.centre)
    a, b = np.triu_indices(len(places[::step]), 1)
    turns = _frames(own[::step][a], own[::step][b]) @ _frames(world[::step][a], world[::step][b]).swapaxes(1, 2)
    local = np.einsum("tij,nj->tni", turns, world)
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.linalg.norm((local[..., :2] / local[..., 2:] - plane) * (camera.fx, camera.fy), axis=-1)
    votes = ((off < AGREE) & (local[..., 2] > 0)).sum(1)
    pose = _there(camera, turns[votes.argmax()])
    for _ in range(ROUNDS):
        near = _errors(replace(camera, world_to_camera=pose), places, points) < AGREE
        if near.sum() < 2:
            break
        left, _, right = np.linalg.svd(own[near].T @ world[near])
        pose = _there(camera, left @ np.diag([1, 1, np.sign(np.linalg.det(left @ right))]) @ right)
    return pose


def _pose(found: Sequence[Features], k: int, points: np.ndarray, seen: Sequence[Track]) -> np.ndarray | None:
    """Where picture k's camera must be by the points of other pictures; None where that is not sure, or where it is given."""
    of = {entry: p for p, track in enumerate(seen) for entry in track if entry[0] != k}
    own, alone = found[k], features.alone(found[k])
    matched: dict[int, int] = {}
    for pair in features.neighbours([each.camera for each in found], NEIGHBOURS):
        if k in pair:
            j = sum(pair) - k
            rows = features.distinct(features.matches(own, found[j], np.inf), own, found[j], alone, features.alone(found[j]))
            for mine, other in rows.tolist():
                if (j, other) in of:
                    matched.setdefault(mine, of[j, other])
    return pose_by_points(own.places[list(matched)], points[list(matched.values())], own.camera) if matched else None


def _moved(places: np.ndarray, points: np.ndarray, camera: Camera) -> np.ndarray | None:
    """The pose of a camera that may have been moved, too: perspective-n-point, by pycolmap's LO-RANSAC."""
    pycolmap = features.pycolmap_module()
    lens = pycolmap.Camera(model="PINHOLE", width=camera.width, height=camera.height, params=[camera.fx, camera.fy, camera.cx, camera.cy])
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac.max_error, options.ransac.random_seed = AGREE, 1
    result = pycolmap.estimate_and_refine_absolute_pose(places, points, lens, options)
    return None if result is None else np.vstack([result["cam_from_world"].matrix(), (0, 0, 0, 1)])


def _errors(camera: Camera, places: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Pixels [N] between places [N, 2] and the images of points [N, 3]; huge behind the camera."""
    return np.nan_to_num(np.linalg.norm(camera.pixels(camera.local(points)) - places, axis=1), nan=1e6)


def _there(camera: Camera, turn: np.ndarray) -> np.ndarray:
    return rotations.transform(turn, -turn @ camera.centre)


def _unit(rays: np.ndarray) -> np.ndarray:
    return rays / np.maximum(np.linalg.norm(rays, axis=-1, keepdims=True), 1e-12)


def _frames(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Orthonormal axes [T, 3, 3], as columns, of pairs of rays [T, 3]."""
    across = _unit(np.cross(a, b))
    return np.stack([a, across, np.cross(a, across)], -1)

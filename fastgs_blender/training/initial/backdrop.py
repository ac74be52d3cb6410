# SPDX-License-Identifier: GPL-3.0-or-later
"""Starting points far behind the scene, in the colours of the pictures there: sky and smooth walls have no features to triangulate.

Without them training reproduces the background with Gaussians directly in front of each camera, wrong for all other cameras.
"""
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...cameras.camera import Camera
from ...captures.capture import Capture, Points, Shot
from ...captures.pixels.store import FrameStore
from ...model.filmed_from import directions
from ...training.core.settings import Settings
from .dense import picture, shown_part, spread
from .geometry import project, unproject, visible

DISTANCE = 3.0
"""Radius of the backdrop in distances of the cameras from what they look at, and no nearer than the farthest of nearly all points."""
SIDE = 128
"""Pixels of the pictures that are looked at, along the longer side."""
EMPTY = 5
"""Pixels around a pixel in which no point lies, for it to show the backdrop."""
MOST_SHOTS, MOMENTS = 40, 5
"""Poses whose pictures are looked at; and pictures of each, whose median has nothing in it that passes by."""
BEYOND = 25.0
"""Degrees by which the backdrop extends beyond the directions that pictures show, for later cameras that look there."""


COVER = 1.2
"""Standard deviation of the backdrop's Gaussians in their distances: there is nothing behind that may show through."""


def with_backdrop(capture: Capture, store: FrameStore, settings: Settings, points: Points) -> Points:
    """The points, and up to settings.backdrop times settings.init_points more on a sphere around them, in directions where pictures show
    none and near there.

    Where pictures are cut out by masks there is no backdrop.
    """
    count = int(settings.backdrop * settings.init_points)
    if not count:
        return points
    centre = capture.focus
    radius = DISTANCE * float(np.median(np.linalg.norm(capture.centres() - centre, axis=1)))
    radius = max(radius, capture.extent, float(np.percentile(np.linalg.norm(points.xyz - centre, axis=1), 98)) if len(points) else 0.0)
    clouds = []
    for shots in spread(_of_each_pose(capture.training), MOST_SHOTS):
        some = spread(shots, MOMENTS)
        if any(shown_part(capture, settings, shot, store.pixels(shot)) is not None for shot in some):
            continue
        pictures = [picture(capture, store, settings, shot, SIDE) for shot in some]
        image, camera = np.median([image for image, _, _ in pictures], axis=0), pictures[0][1]
        h, w = image.shape[:2]
        free = np.ones((h, w), bool)
        unknown = np.zeros((h, w), bool)
        for inside in (inside for _, _, inside in pictures if inside is not None):
            unknown |= inside < 1
        seen = visible(camera, points.xyz)
        places = project(camera, points.xyz[seen])[0].astype(int)
        free[places[:, 1], places[:, 0]] = False
        rows, columns = np.nonzero(_eroded(free, EMPTY) & ~unknown)
        pixels = np.stack([columns + 0.5, rows + 0.5], 1)
        clouds.append((_on_sphere(camera, pixels, centre, radius), image[rows, columns]))
    if not clouds or not sum(len(xyz) for xyz, _ in clouds):
        return points
    xyz, rgb = (np.concatenate(parts) for parts in zip(*clouds))
    seen, rgb = _merged((xyz - centre) / radius, rgb)
    everywhere = directions(count)
    near, nearest = _nearest(everywhere, seen)
    kept = near > np.cos(np.radians(BEYOND))
    xyz, rgb = centre + radius * everywhere[kept], rgb[nearest[kept]]
    t = np.full(len(points), np.nan) if points.t is None else np.asarray(points.t)
    apart = COVER * radius * np.sqrt(4 * np.pi / count)
    velocity = None if points.velocity is None else np.concatenate([points.velocity, np.zeros_like(xyz)]).astype(np.float32)
    return Points(np.concatenate([points.xyz, xyz]).astype(np.float32), np.concatenate([points.rgb, rgb]).astype(np.float32),
                  np.concatenate([t, np.full(len(xyz), np.nan)]).astype(np.float32),
                  np.concatenate([np.full(len(points), np.nan), np.full(len(xyz), apart)]).astype(np.float32), velocity)


def _of_each_pose(shots: Sequence[Shot]) -> list[list[Shot]]:
    """The shots of each camera pose, a list of lists."""
    poses: dict[tuple, list[Shot]] = {}
    for shot in shots:
        camera: Any = shot.camera
        poses.setdefault((camera.world_to_camera.tobytes(), camera.width, camera.height), []).append(shot)
    return list(poses.values())


def _eroded(mask: np.ndarray, reach: int) -> np.ndarray:
    """Where all of mask [h, w] within `reach` pixels along rows and columns is true; beyond the border nothing is known."""
    for axis in (0, 1):
        padded = np.pad(mask, [(reach, reach) if k == axis else (0, 0) for k in (0, 1)], constant_values=True)
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis)
        mask = windows.all(-1)
    return mask


def _on_sphere(camera: Camera, pixels: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """Where the rays through pixels leave the sphere."""
    eye = camera.centre
    rays = unproject(camera, pixels, np.ones(len(pixels))) - eye
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    along = rays @ (centre - eye)
    reach = np.sqrt(np.maximum(radius**2 - ((centre - eye) ** 2).sum() + along**2, 0))
    return eye + rays * (along + reach)[:, None]


def _merged(directions: np.ndarray, rgb: np.ndarray, cells: int = 48) -> tuple[np.ndarray, np.ndarray]:
    """One direction of each cell of a grid, and the mean colour there."""
    key = np.floor((directions + 1) * cells / 2).astype(int) @ [1, 1000, 1_000_000]
    _, first, group, counts = np.unique(key, return_index=True, return_inverse=True, return_counts=True)
    sums = np.stack([np.bincount(group.reshape(-1), rgb[:, c], len(first)) for c in range(3)], 1)
    return directions[first], sums / counts[:, None]


def _nearest(wanted: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cosine to the nearest known unit vector and its index, for each wanted one."""
    best, index = np.empty(len(wanted)), np.empty(len(wanted), int)
    for start in range(0, len(wanted), 1024):
        cosine = wanted[start:start + 1024] @ known.T
        index[start:start + 1024] = cosine.argmax(1)
        best[start:start + 1024] = cosine.max(1)
    return best, index

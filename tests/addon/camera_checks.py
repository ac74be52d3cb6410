# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes random cameras, and checks whether two cameras project points to the same pixels."""
from __future__ import annotations

from dataclasses import replace

import by_hand
import numpy as np

POSE, PIXELS = 1e-5, 1e-4
"""What a round trip may lose: in poses, and at places of the picture."""


def make_camera(fg, rng, width=320, height=240, full=True):
    """A camera that looks about; full: unequal focal lengths, principal point off the middle."""
    eye = rng.uniform(-4, 4, 3)
    focal = width * rng.uniform(0.6, 1.6)
    centre, stretch = (rng.uniform(0.4, 0.6, 2), rng.uniform(0.9, 1.1)) if full else ((0.5, 0.5), 1.0)
    return fg.Camera(width, height, focal, focal * stretch, centre[0] * width, centre[1] * height,
                     by_hand.look_at(eye, eye + rng.normal(size=3), up=rng.normal(size=3)))


def seen(camera, rng, count=30):
    """Points of the world within the camera's picture."""
    at, z = rng.uniform(0, 1, (count, 2)) * [camera.width, camera.height], rng.uniform(1, 8, count)
    local = np.stack([(at[:, 0] - camera.cx) / camera.fx * z, (at[:, 1] - camera.cy) / camera.fy * z, z], 1)
    return (local - camera.world_to_camera[:3, 3]) @ camera.world_to_camera[:3, :3]


def project(camera, world):
    x, y, z = (world @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]).T
    return np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], 1)


def assert_same(got, wanted, pixels=PIXELS):
    assert (got.width, got.height) == (wanted.width, wanted.height)
    np.testing.assert_allclose(got.world_to_camera, wanted.world_to_camera, atol=POSE)
    points = seen(wanted, np.random.default_rng(0))
    np.testing.assert_allclose(project(got, points), project(wanted, points), atol=pixels)


def in_world(camera, matrix):
    """The camera of a capture's world in Blender's, to which `matrix` leads."""
    return replace(camera, world_to_camera=camera.world_to_camera @ np.linalg.inv(np.array(matrix, float)), window=None)

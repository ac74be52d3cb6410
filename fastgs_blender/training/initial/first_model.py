# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the model that training begins with: one Gaussian for each starting point."""
from dataclasses import replace
from typing import Any

import numpy as np

from ...captures.capture import Capture
from ...model.gaussians import Clip, GaussianModel
from ...model.points import Points
from ...model.temporal import Radial
from ..core.model import empty_model
from ..core.settings import Settings
from .geometry import project, visible
from .neighbours import neighbour_distance
from .velocity import straight

MOVING = 0.12
"""init_duration of points that begin with a velocity: they are right for longer."""
ENOUGH = 100
"""Points in pictures from which a distance is taken."""


def depth_of(points: Points, capture: Capture) -> float:
    """How far away what the cameras film is: the median depth of the starting points in the pictures, at least the capture's extent.

    Cameras around a subject stand as far from it as from each other.  A rig that looks forward films what is several times farther
    away than its cameras are apart, and there a step as long as the cameras' spread allows is a small part of a pixel.  Points of
    the backdrop, which have a size, do not count.
    """
    xyz = np.asarray(points.xyz, np.float64)
    if points.size is not None:
        xyz = xyz[~np.isfinite(points.size)]
    cameras = {shot.camera.world_to_camera.tobytes(): shot.camera for shot in capture.training if shot.camera is not None}
    depths = np.concatenate([np.empty(0), *(project(camera, xyz)[1][visible(camera, xyz)] for camera in cameras.values())])
    return max(capture.extent, float(np.median(depths)) if len(depths) >= ENOUGH else 0.0)


def model_from_points(points: Points, settings: Settings, clip: Clip, axes: str, extent: float) -> GaussianModel:
    """The model that training begins with: one Gaussian per point; a point with t = NaN is visible at all times.

    Isotropic, as large as the point says, else init_scale times the mean distance to the three nearest points of the same time
    (3DGS, 3.1 of the recipe).  A timed point with a velocity moves along a straight line while it is seen, others are at rest.
    """
    xyz = np.asarray(points.xyz, np.float32)
    n = len(xyz)
    time = np.full(n, np.nan) if points.t is None else np.asarray(points.t, np.float64)
    timed = np.isfinite(time)
    size = np.full(n, extent)
    for moment in np.unique(np.where(timed, time, -1.0)):
        rows = np.flatnonzero(np.where(timed, time, -1.0) == moment)
        size[rows] = neighbour_distance(xyz[rows], seed=settings.seed)
    size = np.clip(np.where(np.isfinite(size), size, 0.01 * extent), 1e-5 * extent, 0.1 * extent) * settings.init_scale
    if points.size is not None:
        size = np.where(np.isfinite(points.size), points.size, size)
    empty = empty_model(settings, clip, axes)
    arrays: dict[str, Any] = {name: np.zeros(shape, np.float32) for name, shape in empty.shapes(n).items()}
    arrays["position"][:] = xyz
    arrays["rotation"][:, 0] = 1
    arrays["scale"][:] = np.log(size)[:, None]
    arrays["opacity"][:] = np.log(settings.init_opacity / (1 - settings.init_opacity))
    arrays["features"][:] = empty.appearance.features_of(np.asarray(points.rgb, np.float64))
    arrays["mu_tau"][:] = np.where(timed, time, 0.5)
    velocity = np.zeros((n, 3)) if points.velocity is None else points.velocity
    moving = timed & (np.any(velocity, axis=1) if empty.basis.terms else False)
    if isinstance(empty.temporal_kind, Radial):
        life = np.where(moving, MOVING, np.where(timed, settings.init_duration, settings.init_duration_static))
        arrays["temporal"][:, 0] = -2 * np.log(life)
    last = (clip.frame_count - 1) / clip.frame_count
    for moment in np.unique(time[moving]):
        rows = np.flatnonzero(moving & (time == moment))
        motion = straight(empty.basis, moment, MOVING, last)[:, None] * velocity[rows][:, None]
        arrays["motion"][rows] = motion
        arrays["position"][rows] -= np.einsum("k,nkd->nd", empty.basis.weights(0.0 if empty.basis.centred else moment), motion)
    return replace(empty, **arrays)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Opens a closed surface: leaves out what the cameras of the capture did not see, and tidies its borders."""
import numpy as np

from ..cameras.viewpoints import camera_of
from ..model.gaussians import GaussianModel
from ..model.slicing import freeze
from ..model.surroundings import Viewpoint
from ..rendering.api import render
from .carving import AGREE, Surface
from .quads import Mesh
from .views import SOLID, Subject

CAMERAS = 24
"""Cameras that are asked at most."""
BEHIND = 2.0
"""Voxels behind what a camera sees, to which something still counts as seen."""
FACED, TIDY = 20, 30
"""How often the surface is averaged with its neighbourhood before it is asked which way it faces, and then its border."""
HOLE = 0.04
"""Share of what is left of the surface, below which a piece that would be left out inside of it is a hole, and is kept."""


def opened(surface: Surface, model: GaussianModel, subject: Subject, voxel: float, least: float) -> Surface:
    """What is left of a surface where it was filmed; without knowing the cameras, where any view sees it.

    least  share of what is left that a piece must have to stay
    """
    mesh = Mesh.of(surface.quads, len(surface.vertices))
    keep, cameras = surface.seen >= AGREE, model.surroundings.cameras
    if cameras:
        normal, filmed = mesh.normals(mesh.smoothed(surface.vertices, FACED)), np.zeros(len(keep), bool)
        still = freeze(subject.model, subject.t)
        for i in np.unique(np.linspace(0, len(cameras) - 1, CAMERAS).astype(int)):
            rows = np.flatnonzero(((np.array(cameras[i].position) - surface.vertices) * normal).sum(1) > 0)
            filmed[rows] |= _seen(surface.vertices[rows], still, cameras[i], subject, voxel)
        keep &= filmed
    keep = mesh.smoothed(keep.astype(float), TIDY) > 0.5
    for kind, share in ((False, HOLE), (True, least)):
        piece = Mesh.of(surface.quads[(keep == kind)[surface.quads].all(1)], len(keep)).pieces()
        few = np.bincount(piece, minlength=len(piece)) < share * keep.sum()
        keep ^= (keep == kind) & few[piece]
    return surface.take(keep)


def _seen(x: np.ndarray, still: GaussianModel, view: Viewpoint, subject: Subject, voxel: float) -> np.ndarray:
    """Which of the places [V, 3] a camera has in its picture, and not behind what it sees of a model that stands still."""
    camera = camera_of(view)
    away = float(np.linalg.norm(camera.centre - (subject.low + subject.high) / 2))
    finer = min(1.0, away / (voxel * camera.fx))  # a pixel is no smaller than a voxel
    camera = camera.stretched(max(1, round(finer * camera.width)), max(1, round(finer * camera.height)))
    passes = render(still, camera, passes=["alpha", "median_depth"])
    depth = np.pad(np.where(passes["alpha"] >= SOLID, passes["median_depth"], -np.inf), 1, constant_values=-np.inf)
    behind = np.max([depth[i:i + camera.height, j:j + camera.width] for i in range(3) for j in range(3)], axis=0)
    column, row, z = camera.local(x).T
    with np.errstate(divide="ignore", invalid="ignore"):
        column, row = camera.fx * column / z + camera.cx, camera.fy * row / z + camera.cy
        inside = (z > 0) & (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
    seen = np.zeros(len(x), bool)
    there = behind[row[inside].astype(int), column[inside].astype(int)]
    seen[inside] = (z[inside] < there + BEHIND * voxel) | np.isneginf(there)
    return seen

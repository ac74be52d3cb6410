# SPDX-License-Identifier: GPL-3.0-or-later
"""Panorama: a camera that sees more than a plane can hold, equirectangular or through a fisheye lens."""
from dataclasses import dataclass

import numpy as np

from ..util import rotations
from ..util.errors import FastGSError
from .camera import Camera

MARGIN = np.radians(9.0)
"""How far the faces reach beyond a cube's, and over what angle two of them fade into each other on either side of an edge."""
SHARPNESS = 1.3
"""Pixels of a face for each of the panorama's."""
FACES = np.array([
    [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 0, -1], [0, 1, 0], [1, 0, 0]], [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
    [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], [[1, 0, 0], [0, 0, 1], [0, -1, 0]]], float)
"""[6, 3, 3]: right, down and forward of the pinhole cameras that see all around, in the panorama's axes."""


@dataclass(frozen=True, eq=False)
class Panorama:
    """A camera that is no pinhole; its axes are those of Camera: x right, y down, z to the middle of the picture.

    width, height    size of the whole image in pixels
    world_to_camera  [4, 4], a rotation and a shift
    projection       "equirectangular": longitude along x, latitude along y; "equidistant": a fisheye whose circle fills the picture,
                     radius by angle; "equisolid": a fisheye by its focal length, radius 2 f sin(angle / 2)
    longitude, latitude   equirectangular: the picture's edges, left and right, lower and upper, in radians
    fov              fisheyes: the angle of view, in radians; nothing is seen beyond it
    focal            equisolid: focal length in pixels
    near, far        nothing nearer or farther than this is drawn
    window           (x, y, width, height) of the part of the image to render; None: all of it
    """

    width: int
    height: int
    world_to_camera: np.ndarray
    projection: str = "equirectangular"
    longitude: tuple[float, float] = (-np.pi, np.pi)
    latitude: tuple[float, float] = (-np.pi / 2, np.pi / 2)
    fov: float = np.pi
    focal: float = 0.0
    near: float = 0.0
    far: float = np.inf
    window: tuple[int, int, int, int] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if self.projection not in ("equirectangular", "equidistant", "equisolid"):
            raise FastGSError(f"a panorama is equirectangular, equidistant or equisolid, not {self.projection!r}.")
        if self.projection == "equisolid" and not self.focal > 0:
            raise FastGSError("an equisolid fisheye needs a focal length above 0.")
        object.__setattr__(self, "window", tuple(self.window or (0, 0, self.width, self.height)))

    def directions(self) -> np.ndarray:
        """Unit directions [h, w, 3] in the camera's axes through the window's pixel centres; NaN where nothing is seen."""
        x0, y0, w, h = self.window
        x, y = (np.arange(x0, x0 + w) + 0.5)[None, :], (np.arange(y0, y0 + h) + 0.5)[:, None]
        if self.projection == "equirectangular":
            (left, right), (lower, upper) = self.longitude, self.latitude
            along, up = left + (right - left) * x / self.width, upper + (lower - upper) * y / self.height
            return np.stack(np.broadcast_arrays(np.cos(up) * np.sin(along), -np.sin(up), np.cos(up) * np.cos(along)), -1)
        if self.projection == "equidistant":
            u, v = 2 * x / self.width - 1, 2 * y / self.height - 1
            r = np.hypot(u, v)
            angle = np.where(r <= 1, r * self.fov / 2, np.nan)
        else:
            u, v = (x - self.width / 2) / self.focal, (y - self.height / 2) / self.focal
            r = np.hypot(u, v)
            with np.errstate(invalid="ignore"):
                angle = 2 * np.arcsin(np.where(r <= 2, r / 2, np.nan))
            angle = np.where(angle <= self.fov / 2, angle, np.nan)
        outwards = np.sin(angle) / np.maximum(r, 1e-30)
        return np.stack([outwards * u, outwards * v, np.cos(angle)], -1)

    def rays(self, model_to_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Camera centre [3] and unit ray directions [h, w, 3] in model space, as Camera.rays(); forward where nothing is seen."""
        camera_to_model = np.linalg.pinv(model_to_camera)
        seen = self.directions()
        rays = np.where(np.isnan(seen), [0.0, 0, 1], seen) @ camera_to_model[:3, :3].T
        return camera_to_model[:3, 3], rays / np.maximum(np.linalg.norm(rays, axis=-1, keepdims=True), 1e-30)

    def face(self, index: int) -> Camera:
        """The pinhole camera of one of the FACES."""
        if self.projection == "equirectangular":
            density = max(self.width / (self.longitude[1] - self.longitude[0]), self.height / (self.latitude[1] - self.latitude[0]))
        else:
            density = self.focal if self.projection == "equisolid" else max(self.width, self.height) / self.fov
        focal = SHARPNESS * density
        side = int(np.ceil(2 * focal * np.tan(np.pi / 4 + MARGIN))) + 2
        pose = rotations.transform(FACES[index]) @ self.world_to_camera
        return Camera(side, side, focal, focal, side / 2, side / 2, pose, near=self.near, far=self.far)

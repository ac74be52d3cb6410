# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera: OpenCV axes (x right, y down, z forward), pixel centres at +0.5, the first row at the top."""
from __future__ import annotations

from dataclasses import dataclass, replace
from numbers import Real
from typing import NamedTuple

import numpy as np

from ..util.arguments import integer, numbers, real, shown
from ..util.errors import FastGSError
from ..util.rotations import transformed

LARGEST_SIDE = 65_536
"""Pixels of the longer side of a picture that a file may claim."""


class Rays(NamedTuple):
    """The rays through a camera's pixels: where they begin [3], and their directions of length 1 [h, w, 3]."""

    centre: np.ndarray
    directions: np.ndarray


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole or orthographic camera with any principal point.

    width, height   size of the whole image in pixels
    fx, fy          focal lengths in pixels; orthographic: pixels per unit of length
    cx, cy          principal point in pixels from the top left corner
    world_to_camera [4, 4], affine
    orthographic    parallel projection along z
    near, far       nothing nearer or farther than this is drawn, along z (a model's own near plane holds as well)
    window          (x, y, width, height) of the part of the image to render; None: all of it.
                    A part has exactly the pixels that the whole image has there.

    Example:
        camera = fg.Camera(640, 360, fx=500, fy=500, cx=320, cy=180, world_to_camera=np.eye(4))
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_to_camera: np.ndarray
    orthographic: bool = False
    near: float = 0.0
    window: tuple[int, int, int, int] = None  # type: ignore[assignment]
    far: float = np.inf

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        for name in ("width", "height"):
            set_(self, name, integer(getattr(self, name), f"a camera's {name} in pixels", -1 << 31, 1 << 31))
        if self.width < 1 or self.height < 1:
            raise FastGSError(f"a camera's image must be at least 1 x 1 pixel, not {self.width} x {self.height}.")
        for name in ("fx", "fy", "cx", "cy", "near"):
            real(getattr(self, name), f"a camera's {name}")
        matrix = numbers(self.world_to_camera, "a camera's world_to_camera", "(4, 4)").copy()
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise FastGSError("a camera's world_to_camera must be a 4 x 4 matrix of finite numbers.")
        if np.linalg.matrix_rank(matrix[:3, :3]) < 3:
            raise FastGSError("a camera's world_to_camera must tell three directions; its upper left 3 x 3 numbers are a rotation.")
        if self.fx == 0 or self.fy == 0:
            raise FastGSError("a camera's focal lengths must not be 0.")
        if not isinstance(self.far, Real) or not self.far > self.near:
            raise FastGSError(f"a camera's far plane must lie beyond its near plane at {self.near:g}, not at {shown(self.far)}.")
        set_(self, "world_to_camera", matrix)
        window = (0, 0, self.width, self.height) if self.window is None else self.window
        if np.shape(window) != (4,):
            raise FastGSError(f"a camera's window must be (x, y, width, height) in pixels, not {shown(window)}.")
        x, y, w, h = (integer(v, "a number of a camera's window", -1 << 31, 1 << 31) for v in window)
        if x < 0 or y < 0 or w < 1 or h < 1 or x + w > self.width or y + h > self.height:
            raise FastGSError(f"the window {self.window} does not lie within the image of {self.width} x {self.height} pixels.")
        set_(self, "window", (x, y, w, h))

    @property
    def centre(self) -> np.ndarray:
        """Where the camera stands in the world [3], if its matrix is a rotation and a shift."""
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]

    def stretched(self, width: int, height: int) -> Camera:
        """The camera of the same picture, whole, at another size."""
        x, y = width / self.width, height / self.height
        return replace(self, width=width, height=height, fx=self.fx * x, fy=self.fy * y, cx=self.cx * x, cy=self.cy * y,
                       window=(0, 0, width, height))

    def tangent_limits(self) -> tuple[float, float, float, float]:
        """x/z low and high, y/z low and high, to which the projection's Jacobian is clamped.

        The view's edges widened by 15 % of the image (gsplat `_persp_proj`; INRIA's 1.3 tan(fov / 2) when centred).
        """
        mx, my = 0.15 * self.width / self.fx, 0.15 * self.height / self.fy
        x = sorted((-self.cx / self.fx - mx, (self.width - self.cx) / self.fx + mx))
        y = sorted((-self.cy / self.fy - my, (self.height - self.cy) / self.fy + my))
        return x[0], x[1], y[0], y[1]

    def local(self, points: np.ndarray) -> np.ndarray:
        """Places [..., 3] in the camera's axes of points [..., 3] of the world."""
        return transformed(points, self.world_to_camera)

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Pixels [..., 2] of the image, from its top left corner, of points [..., 3] in the camera's axes; NaN behind the camera."""
        depth = np.ones_like(points[..., 2:]) if self.orthographic else np.where(points[..., 2:] > 0, points[..., 2:], np.nan)
        return points[..., :2] / depth * (self.fx, self.fy) + (self.cx, self.cy)

    def from_middle(self) -> tuple[np.ndarray, np.ndarray]:
        """x [w] and y [h] of the centres of the window's pixels, from the middle of the image."""
        x0, y0, w, h = self.window
        return np.arange(x0, x0 + w) + 0.5 - self.width / 2, np.arange(y0, y0 + h) + 0.5 - self.height / 2

    def points(self, depth: np.ndarray) -> np.ndarray:
        """The points [h, w, 3] in the world at a depth [h, w] on the rays through the window's pixel centres."""
        x, y = self.from_middle()
        spread = np.ones_like(depth) if self.orthographic else depth
        u, v = (x + self.width / 2 - self.cx) / self.fx, (y + self.height / 2 - self.cy) / self.fy
        points = np.stack([u * spread, v[:, None] * spread, depth], -1)
        return transformed(points, np.linalg.pinv(self.world_to_camera))

    def rays(self, model_to_camera: np.ndarray) -> Rays:
        """Camera centre [3] and unit ray directions [h, w, 3] through the window's pixel centres, in model space (model_to_camera [4, 4]).

        An orthographic camera has no centre: it gives the directions it looks along and, as centre, the point of the
        image plane's principal axis.
        """
        x0, y0, w, h = self.window
        matrix = numbers(model_to_camera, "model_to_camera", "(4, 4)")
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise FastGSError("model_to_camera must be a 4 x 4 matrix of finite numbers.")
        camera_to_model = np.linalg.pinv(model_to_camera)
        u = (np.arange(x0, x0 + w) + 0.5 - self.cx) / self.fx
        v = (np.arange(y0, y0 + h) + 0.5 - self.cy) / self.fy
        rays = np.zeros((h, w, 3))
        if not self.orthographic:
            rays[..., 0], rays[..., 1] = u[None, :], v[:, None]
        rays[..., 2] = 1
        rays = rays @ camera_to_model[:3, :3].T
        length = np.linalg.norm(rays, axis=-1, keepdims=True)
        return Rays(camera_to_model[:3, 3], rays / np.maximum(length, 1e-30))

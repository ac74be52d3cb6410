# SPDX-License-Identifier: GPL-3.0-or-later
"""Converts Blender's camera to the library's and back: sensor fit, shift, pixel aspect, orthographic scale, clipping, border."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import fastgs_blender as fg
from ..fastgs_blender.cameras.panorama import Panorama

OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
"""From Blender's camera axes (y up, looking along -z) to the library's."""


@dataclass(frozen=True)
class RenderArea:
    """The picture's size in pixels, and the part of it to render as window (x, y, width, height), y counted from the top."""

    width: int
    height: int
    window: tuple[int, int, int, int]

    @classmethod
    def full(cls, width: int, height: int) -> RenderArea:
        """The area of the whole picture."""
        return cls(width, height, (0, 0, width, height))


def render_area(render) -> RenderArea:
    """Size and border of RenderSettings, truncated to pixels exactly as Blender does it (C integers, single precision).

    Raises FastGSError where nothing is left.
    """
    width = render.resolution_x * render.resolution_percentage // 100
    height = render.resolution_y * render.resolution_percentage // 100
    window = (0, 0, width, height)
    if render.use_border:
        x0, x1 = (int(np.float32(v) * np.float32(width)) for v in (render.border_min_x, render.border_max_x))
        y0, y1 = (int(np.float32(v) * np.float32(height)) for v in (render.border_min_y, render.border_max_y))
        window = (x0, height - y1, x1 - x0, y1 - y0)
    if min(window[2:]) < 1:
        raise fg.FastGSError("the render region is smaller than one pixel; enlarge it or the resolution.")
    return RenderArea(width, height, window)


def camera_of(obj, area: RenderArea, depsgraph, model_matrix=None, shift_x: float | None = None,
              aspect: tuple[float, float] | None = None) -> fg.Camera:
    """The library's camera for an evaluated camera object.

    model_matrix, shift_x   where a view of a stereo pair stands and how far it is shifted, if not as the object itself
    aspect                  the pixels' width and height, if not as the scene renders them
    Raises FastGSError for the kinds of camera that splats cannot be projected through.
    """
    data = obj.data
    if obj.type != 'CAMERA' or data.type not in ('PERSP', 'ORTHO'):
        kind = data.type.lower() if obj.type == 'CAMERA' else obj.type.lower()
        raise fg.FastGSError(f'the camera "{obj.name}" is of the type {kind}, which FAST-GS does not render; '
                             "set it to Perspective or Orthographic.")
    render = depsgraph.scene.render
    width, height = area.width, area.height
    aspect_x, aspect_y = aspect or (render.pixel_aspect_x, render.pixel_aspect_y)
    if not data.clip_end > data.clip_start:
        raise fg.FastGSError(f'the camera "{obj.name}" has its Clip End at {data.clip_end:g}, not beyond its Clip Start at '
                             f"{data.clip_start:g}; enlarge Clip End.")
    p = np.array(obj.calc_matrix_camera(depsgraph, x=width, y=height, scale_x=aspect_x, scale_y=aspect_y), np.float64)
    orthographic = data.type == 'ORTHO'
    # OpenGL's projection of (X, Y, -z): the principal point is where x = y = 0 lands
    centre_x, centre_y = (p[0, 3], p[1, 3]) if orthographic else (-p[0, 2], -p[1, 2])
    cx, cy = width / 2 * (1 + centre_x), height / 2 * (1 - centre_y)
    if shift_x is not None:
        cx -= (shift_x - data.shift_x) * _shift_unit(data.sensor_fit, width, height, aspect_x, aspect_y)
    pose = _unscaled(obj, np.array(obj.matrix_world if model_matrix is None else model_matrix, np.float64))
    return fg.Camera(width, height, fx=width / 2 * p[0, 0], fy=height / 2 * p[1, 1], cx=cx, cy=cy,
                     world_to_camera=OPENCV @ np.linalg.inv(pose), orthographic=orthographic,
                     near=data.clip_start, far=data.clip_end, window=area.window)


def panorama_of(obj, area: RenderArea, model_matrix=None) -> Panorama:
    """The library's panorama for an evaluated camera object of that type, as Cycles reads its settings.

    Raises FastGSError for the kinds of panorama that there are not.
    """
    data = obj.data
    kinds = data if hasattr(data, "panorama_type") else data.cycles  # before Blender 5 they are Cycles' own
    pose = _unscaled(obj, np.array(obj.matrix_world if model_matrix is None else model_matrix, np.float64))
    common = dict(width=area.width, height=area.height, world_to_camera=OPENCV @ np.linalg.inv(pose), near=data.clip_start,
                  far=data.clip_end, window=area.window)
    if kinds.panorama_type == 'EQUIRECTANGULAR':
        return Panorama(**common, longitude=(kinds.longitude_min, kinds.longitude_max), latitude=(kinds.latitude_min, kinds.latitude_max))
    if kinds.panorama_type == 'FISHEYE_EQUIDISTANT':
        return Panorama(**common, projection="equidistant", fov=kinds.fisheye_fov)
    if kinds.panorama_type == 'FISHEYE_EQUISOLID':
        horizontal = data.sensor_fit == 'HORIZONTAL' or (data.sensor_fit == 'AUTO' and area.width >= area.height)
        sensor = data.sensor_height if data.sensor_fit == 'VERTICAL' else data.sensor_width
        focal = kinds.fisheye_lens / sensor * (area.width if horizontal else area.height)
        return Panorama(**common, projection="equisolid", fov=kinds.fisheye_fov, focal=focal)
    kind = kinds.panorama_type.lower().replace("_", " ")
    raise fg.FastGSError(f'the camera "{obj.name}" is a panorama of the type {kind}, which FAST-GS does not render; '
                         "set it to Equirectangular, Fisheye Equidistant or Fisheye Equisolid.")


def _unscaled(obj, pose: np.ndarray) -> np.ndarray:
    """A camera's pose [4, 4] without its scale, which does not count.  Raises FastGSError where no directions are left."""
    length = np.linalg.norm(pose[:3, :3], axis=0)
    if not np.isfinite(pose).all() or length.min() < 1e-30:
        problem = "has a scale of 0" if np.isfinite(pose).all() else "stands or is turned by numbers that are not finite"
        raise fg.FastGSError(f'the camera "{obj.name}" {problem}; give it a scale of 1 and look at its transform and its parents.')
    pose[:3, :3] /= length
    if abs(np.linalg.det(pose[:3, :3])) < 1e-9:
        raise fg.FastGSError(f'the camera "{obj.name}" is sheared flat by its parents; clear their scale.')
    return pose


def _shift_unit(fit: str, width: int, height: int, aspect_x: float, aspect_y: float) -> float:
    """Pixels by which a shift of 1 moves the picture: the side that the sensor is fitted to, measured in pixel widths."""
    tall = height * aspect_y / aspect_x
    horizontal = fit == 'HORIZONTAL' or (fit == 'AUTO' and width >= tall)
    return width if horizontal else tall


@dataclass(frozen=True)
class Optics:
    """What Blender's camera and render settings must hold to project as a library camera does; sensor_fit is 'HORIZONTAL'."""

    lens: float
    sensor_width: float
    shift_x: float
    shift_y: float
    pixel_aspect_x: float
    pixel_aspect_y: float


def optics_of(camera: fg.Camera, sensor_width: float = 36.0) -> Optics:
    """The inverse of camera_of(): the numbers in Blender's panels for a perspective camera, at the camera's own picture size."""
    lens = camera.fx / camera.width * sensor_width
    if lens < 1:  # the shortest that Blender takes
        lens, sensor_width = 1.0, camera.width / camera.fx
    tall = camera.fx / camera.fy  # height of a pixel in widths of a pixel
    return Optics(
        lens, sensor_width, (camera.width / 2 - camera.cx) / camera.width, (camera.cy - camera.height / 2) * tall / camera.width,
        pixel_aspect_x=max(1 / tall, 1.0), pixel_aspect_y=max(tall, 1.0))


def pose_of(camera: fg.Camera) -> np.ndarray:
    """Camera-to-world [4, 4] of a library camera in Blender's camera axes: what a Blender camera's matrix must be."""
    return np.linalg.inv(camera.world_to_camera) @ OPENCV

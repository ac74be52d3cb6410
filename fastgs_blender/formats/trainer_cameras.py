# SPDX-License-Identifier: GPL-3.0-or-later
"""The cameras of its capture that a trainer of the INRIA family left beside a model: in cameras.json, beside its cfg_args.

cameras.json has the size of the pictures in the dataset, not of those that were trained on.  The trainer made them smaller, as its cfg_args
say (INRIA's utils/camera_utils.py, loadCam): `images` may name a folder of smaller ones (images_4: a quarter, as in the Mip-NeRF 360 data),
and `resolution` is a divisor of 1, 2, 4 or 8, a width in pixels, or -1: at most WIDEST pixels wide.
"""
import re
import warnings
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from ..cameras.camera import Camera
from ..cameras.cameras_json import View, load_cameras
from ..cameras.flights import focus
from ..cameras.viewpoints import viewpoint_of
from ..model.gaussians import GaussianModel
from ..model.surroundings import Viewpoint, evenly
from ..util.errors import FastGSError, LossWarning
from ..util.identity import status_of
from . import cfg_args

WIDEST = 1600
WRITTEN = re.compile(r"point_cloud\.ply|chkpnt.*\.pth")
"""What trainers call their models: files of other names in their folders may be edited, moved or turned, away from these cameras."""


def with_cameras(model: GaussianModel, path: Path) -> GaussianModel:
    """The model of a trainer's file, with the cameras that lie beside it if it knows none; a LossWarning where they cannot be read."""
    settings = None if model.surroundings.cameras or not WRITTEN.fullmatch(path.name) else cfg_args.find(path)
    file = settings and settings.with_name("cameras.json")
    if not (settings and file and file.is_file()):
        return model
    try:
        cameras = _viewpoints(file, settings, status_of(str(file)), status_of(str(settings)))
    except FastGSError as error:
        warnings.warn(LossWarning(f"{error} So {path.name} is shown without the cameras of its capture."), stacklevel=4)
        return model
    return replace(model, surroundings=replace(model.surroundings, cameras=cameras))


@lru_cache(maxsize=16)
def _viewpoints(file: Path, settings: Path, *_state: tuple[int, ...]) -> tuple[Viewpoint, ...]:
    said = cfg_args.read(settings)
    views = evenly(list({view.camera.world_to_camera.tobytes(): view for view in load_cameras(file)}.values()))
    middle = focus([view.camera for view in views])
    return tuple(_viewpoint(view, _trained(view.camera, said), middle) for view in views)


def _viewpoint(view: View, camera: Camera, middle: np.ndarray) -> Viewpoint:
    place = camera.world_to_camera[:3] @ [*middle, 1.0]
    return viewpoint_of(camera, view.name, max(float(place[2]), 0.0))


def _trained(camera: Camera, said: dict) -> Camera:
    """The camera with pictures of the size that was trained on."""
    folder = re.search(r"_(\d{1,2})$", str(said.get("images", "")))
    width = camera.width / max(int(folder[1]) if folder else 1, 1)
    resolution = cfg_args.number(said, "resolution", -1, -1, 1 << 16)
    if resolution in (1, 2, 4, 8):
        width /= resolution
    else:
        width = resolution if resolution > 0 else min(width, WIDEST)
    share = width / camera.width
    return camera.stretched(max(round(width), 1), max(round(camera.height * share), 1))

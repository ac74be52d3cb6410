# SPDX-License-Identifier: GPL-3.0-or-later
"""FAST-GS: dynamic scenes as 4D Gaussians.  The library: models, files, rendering.  It knows nothing of Blender.

    import fastgs_blender as fg
    model = fg.load("capture.safetensors")
    camera = fg.Camera(1280, 720, fx=900, fy=900, cx=640, cy=360, world_to_camera=matrix)
    image = fg.render(model, camera, t=0.25)["rgb"]
"""
from .cameras.camera import Camera
from .cameras.cameras_json import load_cameras
from .formats import load, open_source, save
from .model.appearance import RGB, SH, Changing, Features
from .model.gaussians import Clip, GaussianModel, Raster
from .model.motion import Cosine, Fourier, Keyframes, Polynomial, Static
from .model.sequence import Sequence
from .model.slicing import Slice, freeze, slice_model
from .model.temporal import Always, Radial, Window, WindowedRadial
from .rendering.api import render
from .surfaces.bake import BakeReport, bake
from .util.errors import FastGSError, LossWarning
from .util.version import VERSION

__version__ = VERSION
__all__ = [
    "RGB", "SH", "Always", "BakeReport", "Camera", "Changing", "Clip", "Cosine", "FastGSError", "Features", "Fourier", "GaussianModel",
    "Keyframes", "LossWarning", "Polynomial", "Radial", "Raster", "Sequence", "Slice", "Static", "Window", "WindowedRadial", "bake",
    "freeze", "load", "load_cameras", "open_source", "render", "save", "slice_model",
]

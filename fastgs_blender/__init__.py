# SPDX-License-Identifier: GPL-3.0-or-later
"""FAST-GS: dynamic scenes as 4D Gaussians.  This is the library, which knows nothing of Blender.

    import fastgs_blender as fg

    model = fg.load("examples/fireside.safetensors")              # files
    camera = fg.load_cameras("examples/cameras.json")[4].camera   # cameras
    image = fg.render(model, camera, t=0.25)["rgb"]               # pictures
    capture = fg.open_capture("my-capture")                       # films of several cameras
    problems = fg.check("my-capture").verdict                     # what would make a model of them poor
    trained = fg.train("my-capture", "run", preset="draft")       # a model of these
    measures = fg.evaluate(trained, capture)["average"]           # how close it is
    baked, report = fg.bake(positions, triangles)                 # a model of an animated mesh, without training

What goes wrong raises FastGSError, whose message is one sentence; what is lost on the way is told by a LossWarning.
"""
from .util import stopping as stopping  # first: signals may come while the rest is imported

# isort: split
from .cameras.camera import Camera
from .cameras.cameras_json import View, load_cameras, save_cameras
from .cameras.moving import dolly, orbit, through
from .captures import Capture, open_capture
from .captures.clocks.files import Clocks, write_clocks
from .captures.clocks.find import find_offsets
from .checks import check
from .checks.report import CheckReport
from .evaluation.evaluate import evaluate
from .formats import load, open_source, save
from .model.appearance import RGB, SH, Changing, Features
from .model.gaussians import Clip, GaussianModel, Raster
from .model.motion import Cosine, Fourier, Keyframes, Polynomial, Static
from .model.sequence import Sequence
from .model.slicing import Slice, freeze, slice_model
from .model.surroundings import Backdrop, Surroundings, Viewpoint
from .model.temporal import Always, Radial, Window, WindowedRadial
from .rendering.api import render
from .surfaces.bake import BakeReport, bake
from .training.run.launch import train
from .util.errors import FastGSError, LossWarning
from .util.version import VERSION

__version__ = VERSION
__all__ = [
    "RGB", "SH", "Always", "Backdrop", "BakeReport", "Camera", "Capture", "Changing", "CheckReport", "Clip", "Clocks", "Cosine",
    "FastGSError", "Features", "Fourier", "GaussianModel", "Keyframes", "LossWarning", "Polynomial", "Radial", "Raster", "Sequence",
    "Slice", "Static", "Surroundings", "View", "Viewpoint", "Window", "WindowedRadial", "bake", "check", "dolly", "evaluate",
    "find_offsets", "freeze", "load", "load_cameras", "open_capture", "open_source", "orbit", "render", "save", "save_cameras",
    "slice_model", "through", "train", "write_clocks",
]

# SPDX-License-Identifier: GPL-3.0-or-later
"""FAST-GS: dynamic scenes as 4D Gaussians.  This is the library, which knows nothing of Blender.

    import fastgs_blender as fg

    model = fg.load("examples/fireside.safetensors")              # files
    camera = fg.load_cameras("examples/cameras.json")[4].camera   # cameras
    image = fg.render(model, camera, t=0.25)["rgb"]               # pictures
    capture = fg.open_capture("my-capture")                       # films of several cameras
    problems = fg.check("my-capture").verdict                     # what would make a model of them poor
    trained = fg.train("my-capture", "run", preset="draft")       # a model of these
    cleaned = model.take(~fg.clean(model).taken)                  # without floaters and haze
    measures = fg.evaluate(trained, capture)["average"]           # how close it is
    baked, report = fg.bake(positions, triangles)                 # a model of an animated mesh, without training
    meshes = fg.make_mesh(model, t=0.25)                          # and a mesh of a model, which moves as it does

What goes wrong raises FastGSError, whose message is one sentence; what is lost on the way is told by a LossWarning.
"""
from .util import stopping as stopping  # first: signals may come while the rest is imported

# isort: split
import importlib.util
from typing import TYPE_CHECKING, Any

from .util.errors import FastGSError, LossWarning
from .util.importing import import_quickly
from .util.version import VERSION

if TYPE_CHECKING:  # the same names as in PLACES; a test compares them
    from .cameras.camera import Camera
    from .cameras.cameras_json import View, load_cameras, save_cameras
    from .cameras.flights import dolly, orbit, through
    from .cameras.poses import look_at
    from .captures import Capture, open_capture
    from .captures.clocks.files import Clocks, write_clocks
    from .captures.clocks.find import find_offsets
    from .checks import check
    from .checks.report import CheckReport
    from .evaluation.evaluate import evaluate
    from .evaluation.metrics import psnr
    from .formats import load, open_source, save
    from .model.appearance import RGB, SH, Changing, Features
    from .model.chapters import Chapters
    from .model.cutting import chapters
    from .model.edits import Edit
    from .model.gaussians import Clip, GaussianModel, Raster
    from .model.joining import concatenate
    from .model.motion import Cosine, Fourier, Keyframes, Polynomial, Static
    from .model.parts import Parts
    from .model.sequence import Sequence
    from .model.slicing import Slice, freeze, slice_model
    from .model.surroundings import Backdrop, Surroundings, Viewpoint
    from .model.temporal import Always, Radial, Window, WindowedRadial
    from .rendering.api import render
    from .rendering.crops import Crop
    from .rendering.exposure import Aperture, Exposure
    from .rendering.images import save_image
    from .rendering.instances import Instance, ObjectSettings
    from .rendering.passes import PassSettings
    from .selecting.clean import Cleaning, clean
    from .stitching.fitting import Alignment, align
    from .stitching.grading import Grade, match_grade
    from .stitching.loops import Loop, find_loop
    from .stitching.similarity import Similarity, similarity
    from .surfaces.bake import BakeReport, bake
    from .surfaces.making import MovingMesh, make_mesh
    from .training.run.launch import train

PLACES = {
    "cameras.camera": "Camera", "cameras.cameras_json": "View load_cameras save_cameras", "cameras.flights": "dolly orbit through",
    "cameras.poses": "look_at", "captures": "Capture open_capture", "captures.clocks.files": "Clocks write_clocks",
    "captures.clocks.find": "find_offsets", "checks": "check", "checks.report": "CheckReport", "evaluation.evaluate": "evaluate",
    "evaluation.metrics": "psnr", "formats": "load open_source save", "model.appearance": "RGB SH Changing Features", "model.edits": "Edit",
    "model.chapters": "Chapters", "model.cutting": "chapters",
    "model.gaussians": "Clip GaussianModel Raster", "model.joining": "concatenate",
    "model.motion": "Cosine Fourier Keyframes Polynomial Static", "model.parts": "Parts", "model.sequence": "Sequence",
    "model.slicing": "Slice freeze slice_model", "model.surroundings": "Backdrop Surroundings Viewpoint",
    "model.temporal": "Always Radial Window WindowedRadial", "rendering.api": "render", "rendering.crops": "Crop",
    "rendering.exposure": "Aperture Exposure", "rendering.images": "save_image", "rendering.instances": "Instance ObjectSettings",
    "rendering.passes": "PassSettings", "selecting.clean": "Cleaning clean", "stitching.fitting": "Alignment align",
    "stitching.grading": "Grade match_grade", "stitching.loops": "Loop find_loop", "stitching.similarity": "Similarity similarity",
    "surfaces.bake": "BakeReport bake",
    "surfaces.making": "MovingMesh make_mesh", "training.run.launch": "train",
}
"""The modules that define the public names; each is imported when one of its names is used first."""
_place_of = {name: place for place, names in PLACES.items() for name in names.split()}

__version__ = VERSION
__all__ = [
    "RGB", "SH", "Alignment", "Always", "Aperture", "Backdrop", "BakeReport", "Camera", "Capture", "Changing", "Chapters",
    "CheckReport", "Cleaning",
    "Clip", "Clocks", "Cosine", "Crop", "Edit", "Exposure", "FastGSError", "Features", "Fourier", "GaussianModel", "Grade", "Instance",
    "Keyframes", "Loop", "LossWarning", "MovingMesh", "ObjectSettings", "Parts", "PassSettings", "Polynomial", "Radial", "Raster",
    "Sequence", "Similarity", "Slice", "Static", "Surroundings", "View", "Viewpoint", "Window", "WindowedRadial", "align", "bake",
    "chapters", "check",
    "clean", "concatenate", "dolly", "evaluate", "find_loop", "find_offsets", "freeze", "load", "load_cameras", "look_at", "make_mesh",
    "match_grade", "open_capture", "open_source", "orbit", "psnr", "render", "save", "save_cameras", "save_image", "similarity",
    "slice_model", "through", "train", "write_clocks",
]


def __getattr__(name: str) -> Any:
    """A public name, or one of the library's rooms, imported now (PEP 562)."""
    if name in _place_of:
        found = getattr(import_quickly(f".{_place_of[name]}", __name__), name)
    elif not name.startswith("_") and importlib.util.find_spec(f"{__name__}.{name}"):
        return import_quickly(f".{name}", __name__)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

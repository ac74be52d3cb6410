# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of a training run: the panel stores them in the scene; the operator takes them from there unless they are given."""
import math

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ...fastgs_blender.training.core import costs
from ...fastgs_blender.training.core.presets import PRESETS
from ...fastgs_blender.training.core.settings import Settings
from ..filming.options import CaptureOptions
from ..settings import BLEND_RELATIVE
from . import installation

EXISTING = (
    ('REFUSE', "Refuse", "Say so", 0),
    ('RESUME', "Go On", "Continue it from its last checkpoint, with the options that it began with", 1),
    ('OVERWRITE', "Begin Anew", "Delete it, and train from the beginning", 2),
    ('NEW', "New Folder", "Keep it, and train into the next free folder beside it", 3),
)
"""What becomes of a run that is in the folder already."""
TITLES = {"paper": "As in the Paper", "stg": "As in STG"}
"""Names of presets in menus, where they are not the preset's own."""
PREVIEWS = 30
"""Number of preview pictures that a run makes."""


class TrainingOptions:
    """Shared by the scene's settings and the operator that starts a run."""

    source: EnumProperty(
        name="Source", description="What to train on",
        items=(
            ('FOLDER', "Capture", "A folder with a multi-view capture", 0),
            ('CAMERAS', "Cameras", "The scene's cameras that have an image sequence or a film as background", 1),
            ('SCENE', "This Scene", "The open scene itself, filmed with its own render engine", 2),
        ), default='FOLDER')
    capture: StringProperty(
        name="Capture", description="The capture's folder, or a file that describes it", subtype='DIR_PATH',
        options=BLEND_RELATIVE)
    scan: StringProperty(
        name="Scan", description="Photographs of the place in the capture's world, such as of a walk around it while it is empty: a "
        "folder or a file that describes them. With few cameras they help much", subtype='DIR_PATH', options=BLEND_RELATIVE)
    out: StringProperty(
        name="Results", description="Folder for the model and all files of the run; empty: a new folder beside the .blend",
        subtype='DIR_PATH', options=BLEND_RELATIVE)
    preset: EnumProperty(
        name="Preset", description="How long to train, and how large the model may become",
        items=tuple((name.upper(), TITLES.get(name, name.capitalize()),
                     "{:,} steps, at most {:,} Gaussians".format(*costs.size_of(name, pixels=math.inf)), number)
                    for number, name in enumerate(PRESETS)), default='STANDARD')
    iterations: IntProperty(name="Steps", description="Number of training steps; 0: as in the preset", default=0, min=0)
    max_gaussians: IntProperty(name="Most Gaussians", description="Largest number of Gaussians; 0: as in the preset", default=0, min=0)
    order: IntProperty(
        name="Motion Terms", description="How many terms describe the path of each Gaussian: more follow faster motion. "
        "0: as many as suit the clip's length, or the bake that training begins with", default=0, min=0, max=64)
    motion_weight: FloatProperty(
        name="Motion Smoothing", description="How strongly training prefers simple motion; 0 leaves it free",
        default=Settings.motion_weight, min=0.0, soft_max=10.0, precision=3)
    scale: FloatProperty(
        name="Picture Scale", description="Factor on the size of the pictures; 0: as the capture's layout has it, and smaller for drafts "
        "of large ones",
        default=0.0, min=0.0, max=1.0)
    frames: StringProperty(name="Frames", description='Part of the capture, as in "0:99", counted from 0; empty for all of it')
    held_out: StringProperty(
        name="Held-Out Views", description="Cameras to evaluate with instead of training on them, separated by commas; empty for the "
        "capture's own choice")


class FASTGS_PG_training(CaptureOptions, TrainingOptions, bpy.types.PropertyGroup):
    """The training panel's settings."""

    existing: EnumProperty(
        name="Existing Run", description="What becomes of the run that is in the folder already", items=EXISTING[1:], default='NEW')
    import_result: BoolProperty(
        name="Import When Done", description="Add the finished model to the scene, where its cameras are", default=True)
    hide_originals: BoolProperty(
        name="Hide Originals", description="Hide the objects that were filmed once their model is in the scene, in viewports and renders",
        default=True)


def arguments(options) -> list[str]:
    """The options as `fastgs train` takes them."""
    steps, _ = costs.size_of(options.preset, options.iterations)
    chosen = ["--preset", options.preset.lower(), "--set", f"preview_every={max(steps // PREVIEWS, 1)}"]
    if abs(options.motion_weight - Settings.motion_weight) > 1e-9:  # else the preset's
        chosen += ["--motion-weight", f"{options.motion_weight:.6g}"]
    for name, flag in (("iterations", "--iterations"), ("max_gaussians", "--max-gaussians"), ("order", "--order")):
        if getattr(options, name):
            chosen += [flag, str(getattr(options, name))]
    if options.scan.strip():
        chosen += ["--scan", installation.capture_path(options.scan)]
    return chosen + capture_arguments(options)


def capture_arguments(options) -> list[str]:
    """Those of them that choose a part of the capture, as `fastgs check` takes them too."""
    names = ",".join(name.strip() for name in options.held_out.split(",") if name.strip())
    given = {"--scale": f"{options.scale:.6g}" if options.scale else "", "--frames": options.frames.strip(), "--held-out": names}
    return [word for flag, value in given.items() if value for word in (flag, value)]

# SPDX-License-Identifier: GPL-3.0-or-later
"""Object > Bake to 4D Gaussians: animated objects become a model, without training."""
from __future__ import annotations

import threading
import time
import warnings
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from .. import fastgs_blender as fg
from ..fastgs_blender.surfaces.bake import bake, surface_colours, surface_samples
from ..scene.meshes import baked_light
from ..scene.meshes.material_colour import MaterialColours
from ..scene.meshes.surface import Recorder, bakeable, frame_kept, go_to, whole_frames_only
from ..scene.splats import splat_object
from .stepwise import BUDGET, Stepwise


@dataclass(frozen=True)
class Settings:
    """What to bake, and how; as in the operator's properties."""

    frame_start: int
    frame_end: int
    count: int = 100_000
    tolerance: float = 0.005
    max_order: int = 0
    basis: str = "auto"
    samples_per_frame: int = 2
    lighting: str = 'NONE'
    light_samples: int = 64
    light_frames: int = 8


def frame_times(first: int, last: int, per_frame: int) -> list[float]:
    """Frames from first to last, whole or not; none lies outside."""
    return [first + i / per_frame for i in range((last - first) * per_frame + 1)]


def bake_steps(context, objects, settings: Settings, in_background: bool):
    """A generator that bakes: it yields the share that is done, and returns (model, report, notes).

    In between the scene stands on other frames; the frame of before is restored at the end, also when the generator is closed
    early or an error ends it.  With in_background the long pieces that need no Blender run in a thread.
    """
    scene = context.scene
    with frame_kept(scene):
        recorder = Recorder(context, objects)
        simulated = any(whole_frames_only(obj) for obj in objects)
        times = frame_times(settings.frame_start, settings.frame_end, 1 if simulated else settings.samples_per_frame)
        if simulated:  # a simulation knows no frame to which it has not been played
            for frame in range(scene.frame_start, settings.frame_start):
                go_to(scene, frame)
                yield 0.0
        for number, frame in enumerate(times):
            recorder.record(frame)
            yield 0.4 * (number + 1) / len(times)
        positions, triangles = np.stack(recorder.positions), recorder.triangles()
        samples = yield from _run(lambda _: surface_samples(positions, triangles, settings.count), in_background, 0.4, 0.5)
        materials = MaterialColours(recorder.pieces)
        colours = surface_colours(materials, positions, triangles, samples)
        if settings.lighting == 'CYCLES':
            colours = yield from _scaled(
                baked_light.apply(context, recorder, times, colours, samples, settings.light_samples, settings.light_frames), 0.5, 0.6)
    part, patch, fps = recorder.parts(), recorder.patches(), scene.render.fps / scene.render.fps_base
    provenance = {"objects": ", ".join(obj.name for obj in objects)[:1000]}

    def fit(progress):
        with warnings.catch_warnings():  # what they say stands in the report too, and Blender's user reads that
            warnings.simplefilter("ignore", UserWarning)
            return bake(
                positions, triangles, colours, frames=np.array(times) - settings.frame_start,
                frame_count=settings.frame_end - settings.frame_start + 1, fps=fps,
                start_frame=settings.frame_start, count=settings.count, tolerance=settings.tolerance, max_order=settings.max_order,
                basis=settings.basis, part=part, patch=patch, samples=samples, provenance=provenance, progress=progress)

    model, report = yield from _run(fit, in_background, 0.6, 1.0)
    return model, report, materials.notes


def _scaled(steps, begin, end):
    """The steps of a part of the work, as shares of the whole; returns its result."""
    while True:
        try:
            yield begin + (end - begin) * next(steps)
        except StopIteration as stop:
            return stop.value


def _run(work, in_background, begin, end):
    """Yields progress while work(progress) runs, and returns its result; closing the generator cancels the work."""
    if not in_background:
        yield begin
        return work(None)
    state = {"done": 0.0}
    cancelled = threading.Event()

    def progress(fraction):
        state["done"] = fraction
        if cancelled.is_set():
            raise InterruptedError

    def target():
        try:
            state["result"] = work(progress)
        except BaseException as error:
            state["error"] = error

    thread = threading.Thread(target=target, name="FAST-GS bake", daemon=True)
    thread.start()
    try:
        while thread.is_alive():
            thread.join(BUDGET)
            yield begin + (end - begin) * state["done"]
    finally:
        cancelled.set()
        thread.join()
    if "error" in state:
        raise state["error"]
    return state["result"]


class FASTGS_OT_bake(Stepwise, bpy.types.Operator, ExportHelper):
    """Turn the selected animated objects into a model of 4D Gaussians, without training, and import it"""

    bl_idname = "fastgs.bake"
    bl_label = "Bake to 4D Gaussians"
    bl_options = {'UNDO', 'PRESET'}
    doing, interrupted = "Baking to 4D Gaussians", "The bake was cancelled; nothing was written"

    filename_ext = ".safetensors"
    filter_glob: StringProperty(default="*.safetensors", options={'HIDDEN'})
    frame_start: IntProperty(name="Start", description="First frame; the scene's unless given")
    frame_end: IntProperty(name="End", description="Last frame; the scene's unless given")
    count: IntProperty(
        name="Gaussians", description="How many Gaussians to spread over the surface", default=100_000, min=1, max=50_000_000,
        soft_max=2_000_000)
    tolerance: FloatProperty(
        name="Tolerance", description="Mean distance from the true motion that is allowed, in percent of the object's size",
        subtype='PERCENTAGE', default=0.5, min=0.001, max=100.0, soft_max=5.0, precision=3)
    max_order: IntProperty(
        name="Highest Order", description="Most terms of motion to use; 0 allows what the number of frames safely carries",
        default=0, min=0, soft_max=100)
    basis: EnumProperty(
        name="Basis",
        description="In which functions of time motion is written",
        items=(
            ('AUTO', "Automatic", "Whichever needs the fewest numbers", 0),
            ('COSINE', "Cosine", "Half-period cosines: any motion within a clip", 1),
            ('FOURIER', "Fourier", "Sines and cosines with a linear term: turns, cycles and steady travel", 2),
            ('PAPER', "Fourier, Periodic", "As published: the motion returns to where it began", 3),
            ('KEYFRAMES', "Keyframes", "A smooth curve through evenly spaced keys: impacts and jerks", 4),
        ),
        default='AUTO')
    samples_per_frame: IntProperty(
        name="Samples per Frame",
        description="Times per frame at which the objects are looked at; simulations are looked at on whole frames only",
        default=2, min=1, max=16)
    lighting: EnumProperty(
        name="Lighting",
        description="Light to paint onto the Gaussians",
        items=(
            ('NONE', "None", "The plain colours of the materials", 0),
            ('CYCLES', "Cycles", "The scene's diffuse light and shadows, the mean over the clip, computed by Cycles", 1),
        ),
        default='NONE')
    light_samples: IntProperty(
        name="Light Samples", description="Cycles samples per Gaussian for baked lighting", default=64, min=1, soft_max=4096)
    light_frames: IntProperty(
        name="Light Frames", description="On how many frames of the clip the light is looked at; they share the samples",
        default=8, min=1, soft_max=64)
    import_result: BoolProperty(
        name="Import", description="Add the baked model to the scene", default=True)
    overwrite: BoolProperty(
        name="Overwrite", description="Replace the file if it is there already", default=False, options={'HIDDEN', 'SKIP_SAVE'})

    @classmethod
    def poll(cls, context):
        if context.mode != 'OBJECT':
            cls.poll_message_set("Go to Object Mode first")
            return False
        if not any(bakeable(obj) for obj in context.selected_objects):
            cls.poll_message_set("Select objects that have a surface")
            return False
        return True

    def invoke(self, context, event):
        self._fill_range(context.scene)
        self.overwrite = True  # the file dialog asks
        self._interactive = True
        if not self.filepath:
            name = bpy.path.clean_name(context.object.name if context.object else "baked")
            self.filepath = str(Path(bpy.data.filepath).parent / f"{name}.safetensors") if bpy.data.filepath else f"{name}.safetensors"
        return super().invoke(context, event)

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        col = layout.column(align=True)
        col.prop(self, "frame_start")
        col.prop(self, "frame_end")
        col.prop(self, "samples_per_frame", text="Per Frame")
        layout.prop(self, "count")
        col = layout.column()
        col.prop(self, "tolerance")
        col.prop(self, "basis")
        col.prop(self, "max_order")
        layout.prop(self, "lighting")
        if self.lighting == 'CYCLES':
            col = layout.column(align=True)
            col.prop(self, "light_samples")
            col.prop(self, "light_frames")
        layout.prop(self, "import_result")

    def execute(self, context):
        self._began = time.monotonic()
        return self.begin(context, self._bake(context))

    def _bake(self, context):
        """Yields the share that is done; returns what bake_steps does."""
        self._fill_range(context.scene)
        self._path = self._check()
        objects = [obj for obj in context.selected_objects if bakeable(obj)]
        settings = Settings(self.frame_start, self.frame_end, self.count, self.tolerance / 100, self.max_order, self.basis.lower(),
                            self.samples_per_frame, self.lighting, self.light_samples, self.light_frames)
        with closing(bake_steps(context, objects, settings, self.in_window)) as steps:
            while True:
                try:
                    yield next(steps), 1
                except StopIteration as end:
                    return end.value
                except MemoryError:
                    raise fg.FastGSError(
                        "there is too little memory for this bake; bake fewer Gaussians, frames or objects at once.") from None

    def finish(self, context, result):
        model, report, notes = result
        fg.save(model, self._path)
        if self.import_result:
            obj = splat_object.create(context, self._path, relative=True)
            obj.fastgs.start_frame = self.frame_start
        for note in notes:
            self.report({'WARNING'}, note)
        if report.warning:
            self.report({'WARNING'}, report.warning[0].upper() + report.warning[1:])
        self.report({'INFO'}, f"{report}; {time.monotonic() - self._began:.1f} s, {self._path}")
        return {'FINISHED'}

    def _fill_range(self, scene):
        for name in ("frame_start", "frame_end"):
            if not self.properties.is_property_set(name):
                setattr(self, name, getattr(scene, name))

    def _check(self) -> str:
        """The absolute path to write to; FastGSError where it cannot be, before any work is done."""
        if not self.filepath:
            raise fg.FastGSError("no file was chosen to write the baked model to; give a filepath that ends in .safetensors.")
        path = Path(bpy.path.abspath(bpy.path.ensure_ext(self.filepath, self.filename_ext)))
        if not path.parent.is_dir():
            raise fg.FastGSError(f"{path}: the folder does not exist; choose another or make it first.")
        if path.exists() and not self.overwrite:
            raise fg.FastGSError(f"{path} exists already; choose another name, or set overwrite.")
        if self.frame_end < self.frame_start:
            raise fg.FastGSError(f"the last frame, {self.frame_end}, comes before the first, {self.frame_start}; choose a range of frames.")
        return str(path)

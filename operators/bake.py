# SPDX-License-Identifier: GPL-3.0-or-later
"""Object > Bake to 4D Gaussians: turns animated objects into a model, without training."""
from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from .. import fastgs_blender as fg
from ..fastgs_blender.util.errors import printable
from ..scene.meshes.baking import Settings, bake_steps
from ..scene.meshes.surface import bakeable
from ..scene.splats import splat_object
from .stepwise import Stepwise


class FASTGS_OT_bake(Stepwise, bpy.types.Operator, ExportHelper):
    """Turn the selected animated objects into a model of 4D Gaussians, without training, and import it"""

    bl_idname = "fastgs.bake"
    bl_label = "Bake to 4D Gaussians"
    bl_options = {'UNDO', 'PRESET'}
    doing, interrupted = "Baking to 4D Gaussians", "The bake was cancelled; nothing was written"

    filename_ext = ".safetensors"
    filter_glob: StringProperty(default="*.safetensors", options={'HIDDEN'})
    frame_start: IntProperty(name="Start", description="First frame; by default the scene's")
    frame_end: IntProperty(name="End", description="Last frame; by default the scene's")
    count: IntProperty(
        name="Gaussians", description="How many Gaussians to spread over the surface", default=100_000, min=1, max=50_000_000,
        soft_max=2_000_000)
    tolerance: FloatProperty(
        name="Tolerance", description="Mean distance from the true motion that is allowed, in percent of the object's size",
        subtype='PERCENTAGE', default=0.5, min=0.001, max=100.0, soft_max=5.0, precision=3)
    tail_tolerance: FloatProperty(
        name="99 % Within",
        description="Distance from the true motion that 99 % of the Gaussians keep to, in percent of the object's size: "
        "it holds hands and feet, which the mean hides",
        subtype='PERCENTAGE', default=1.0, min=0.001, max=100.0, soft_max=10.0, precision=3)
    max_order: IntProperty(
        name="Most Motion Terms", description="Largest number of terms that describe a path; 0: as many as the frames safely support",
        default=0, min=0, soft_max=100)
    basis: EnumProperty(
        name="Basis",
        description="Functions of time that describe the motion",
        items=(
            ('AUTO', "Automatic", "The basis that needs the fewest coefficients", 0),
            ('COSINE', "Cosine", "Half-period cosines: any motion within a clip", 1),
            ('FOURIER', "Fourier", "Sines and cosines with a linear term: turns, cycles and steady travel", 2),
            ('PAPER', "Fourier, Periodic", "As published: the motion returns to where it began", 3),
            ('KEYFRAMES', "Keyframes", "A smooth curve through evenly spaced keys: impacts and jerks", 4),
        ),
        default='AUTO')
    samples_per_frame: IntProperty(
        name="Samples per Frame",
        description="Number of times per frame at which the objects are sampled. 0: two, or four or eight where motion is too fast to be "
        "followed with fewer. Simulations are sampled on whole frames only",
        default=0, min=0, max=16)
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
        name="Light Frames", description="Number of frames of the clip on which the light is sampled; they share the samples",
        default=8, min=1, soft_max=64)
    import_result: BoolProperty(
        name="Import", description="Add the baked model to the scene", default=True)
    hide_source: BoolProperty(
        name="Hide Source", description="Hide the baked objects, in viewports and in renders, so that the Gaussians take their place; "
        "the scene remembers the choice", default=False)
    overwrite: BoolProperty(
        name="Overwrite", description="Replace the file if it exists already", default=False, options={'HIDDEN', 'SKIP_SAVE'})

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
        self._fill(context.scene)
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
        col.prop(self, "tail_tolerance")
        col.prop(self, "basis")
        col.prop(self, "max_order")
        layout.prop(self, "lighting")
        if self.lighting == 'CYCLES':
            col = layout.column(align=True)
            col.prop(self, "light_samples")
            col.prop(self, "light_frames")
        layout.prop(self, "import_result")
        layout.prop(self, "hide_source")

    def execute(self, context):
        self._began = time.monotonic()
        return self.begin(context, self._bake(context))

    def _bake(self, context):
        """Yields the share that is done and the stage; returns what bake_steps does."""
        self._fill(context.scene)
        self._path = self._check()
        objects = [obj for obj in context.selected_objects if bakeable(obj)]
        self._sources = [obj.name for obj in objects]
        settings = Settings(self.frame_start, self.frame_end, self.count, self.tolerance / 100, self.tail_tolerance / 100, self.max_order,
                            self.basis.lower(), self.samples_per_frame, self.lighting, self.light_samples, self.light_frames)
        with closing(bake_steps(context, objects, settings, self.in_window)) as steps:
            while True:
                try:
                    done, stage = next(steps)
                    yield done, 1, stage
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
        context.scene.fastgs.hide_baked = self.hide_source
        if self.hide_source:
            for name in self._sources:
                source = context.scene.objects.get(name)  # the user may have deleted it meanwhile
                if source:
                    source.hide_set(True)
                    source.hide_render = True
        for note in notes:
            self.report({'WARNING'}, note)
        if report.warning:
            self.report({'WARNING'}, report.warning[0].upper() + report.warning[1:])
        self.report({'INFO'}, printable(f"{report}; {time.monotonic() - self._began:.1f} s, {self._path}"))
        return {'FINISHED'}

    def _fill(self, scene):
        """Set the options that were not given to the values of the scene."""
        for name, value in (("frame_start", scene.frame_start), ("frame_end", scene.frame_end), ("hide_source", scene.fastgs.hide_baked)):
            if not self.properties.is_property_set(name):
                setattr(self, name, value)

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

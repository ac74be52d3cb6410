# SPDX-License-Identifier: GPL-3.0-or-later
"""Object > Bake to 4D Gaussians: turns animated objects into a model, without training."""
import time
from pathlib import Path

import bpy
from bpy.props import BoolProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from .. import fastgs_blender as fg
from ..scene.background import relayed
from ..scene.meshes.baking import bake_steps
from ..scene.meshes.options import BakeOptions, bake_options
from ..scene.meshes.surface import bakeable
from ..scene.splats import splat_object
from .action import OBJECT_MODE, Need, check_frames, draw_column, draw_options
from .stepwise import Stepwise


class FASTGS_OT_bake(Stepwise, BakeOptions, bpy.types.Operator, ExportHelper):
    """Turn the selected animated objects into a model of 4D Gaussians, without training, and import it"""

    bl_idname = "fastgs.bake"
    bl_label = "Bake to 4D Gaussians"
    bl_options = {'UNDO', 'PRESET'}
    needs = (OBJECT_MODE,
             Need(lambda context: any(bakeable(obj) for obj in context.selected_objects), "Select objects that have a surface"))
    doing, interrupted = "Baking to 4D Gaussians", "The bake was cancelled; nothing was written"

    filename_ext = ".safetensors"
    filter_glob: StringProperty(default="*.safetensors", options={'HIDDEN'})
    import_result: BoolProperty(
        name="Import", description="Add the baked model to the scene", default=True)
    hide_source: BoolProperty(
        name="Hide Source", description="Hide the baked objects, in viewports and in renders, so that the Gaussians take their place; "
        "the scene remembers the choice", default=False)
    overwrite: BoolProperty(
        name="Overwrite", description="Replace the file if it exists already", default=False, options={'HIDDEN', 'SKIP_SAVE'})

    def invoke(self, context, event):
        self._fill(context.scene)
        self.overwrite = True  # the file dialog asks
        self._interactive = True
        if not self.filepath:
            name = bpy.path.clean_name(context.object.name if context.object else "baked")
            self.filepath = str(Path(bpy.data.filepath).parent / f"{name}.safetensors") if bpy.data.filepath else f"{name}.safetensors"
        return ExportHelper.invoke(self, context, event)

    def draw(self, context):
        layout = draw_options(self)
        draw_column(layout, self, "frame_start", "frame_end", align=True).prop(self, "samples_per_frame", text="Per Frame")
        layout.prop(self, "count")
        draw_column(layout, self, "tolerance", "tail_tolerance", "basis", "max_order")
        layout.prop(self, "lighting")
        if self.lighting == 'CYCLES':
            draw_column(layout, self, "light_samples", "light_frames", align=True)
        layout.prop(self, "import_result")
        layout.prop(self, "hide_source")

    def steps(self, context):
        """Yields the share that is done and the stage; returns what bake_steps does."""
        self._began = time.monotonic()
        self._fill(context.scene)
        self._path = self._check()
        objects = [obj for obj in context.selected_objects if bakeable(obj)]
        self._sources = [obj.name for obj in objects]
        settings = bake_options(**{name: getattr(self, name) for name in BakeOptions.__annotations__})
        try:
            return (yield from relayed(bake_steps(context, objects, settings, self.in_window), lambda step: (step[0], 1, step[1])))
        except MemoryError:
            raise fg.FastGSError("there is too little memory for this bake; bake fewer Gaussians, frames or objects at once.") from None

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
            self.warn(note)
        if report.warning:
            self.warn(report.warning)
        return f"{report}; {time.monotonic() - self._began:.1f} s, {self._path}"

    def _fill(self, scene):
        self.fill(frame_start=scene.frame_start, frame_end=scene.frame_end, hide_source=scene.fastgs.hide_baked)

    def _check(self) -> str:
        """The absolute path to write to; FastGSError where it cannot be, before any work is done."""
        if not self.filepath:
            raise fg.FastGSError("no file was chosen to write the baked model to; give a filepath that ends in .safetensors.")
        path = Path(bpy.path.abspath(bpy.path.ensure_ext(self.filepath, self.filename_ext)))
        if not path.parent.is_dir():
            raise fg.FastGSError(f"{path}: the folder does not exist; choose another or make it first.")
        if path.exists() and not self.overwrite:
            raise fg.FastGSError(f"{path} exists already; choose another name, or set overwrite.")
        check_frames(self)
        return str(path)

# SPDX-License-Identifier: GPL-3.0-or-later
"""File > Import > 4D Gaussians, and the same by dropping files into the 3D view."""
from __future__ import annotations

import warnings
from pathlib import Path

import bpy
from bpy.props import BoolProperty, CollectionProperty, EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ..engine import compiling
from ..fastgs_blender.util.errors import FastGSError
from ..scene.splats import splat_object
from ..scene.splats.proxy import LIMIT
from .fit_scene import fit_scene

EXTENSIONS = (".safetensors", ".ply", ".splatv")


class FASTGS_OT_import(bpy.types.Operator, ImportHelper):
    """Import models of 4D Gaussians; the files are referred to, not copied"""

    bl_idname = "import_scene.fastgs"
    bl_label = "Import 4D Gaussians"
    bl_options = {'REGISTER', 'UNDO', 'PRESET'}

    filter_glob: StringProperty(default=";".join(f"*{x}" for x in EXTENSIONS), options={'HIDDEN'})
    directory: StringProperty(subtype='DIR_PATH', options={'HIDDEN', 'SKIP_SAVE', 'SKIP_PRESET'})
    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options={'HIDDEN', 'SKIP_SAVE', 'SKIP_PRESET'})

    relative_path: BoolProperty(
        name="Relative Path", description="Find the file by its place relative to the .blend, once that is saved", default=True)
    orientation: EnumProperty(
        name="Orientation",
        items=(
            ('AUTO', "Upright", "Turn the object from the axes that the file records to Blender's", 0),
            ('KEEP', "As in the File", "Leave the object unrotated", 1),
        ),
        default='AUTO')
    proxy_points: IntProperty(
        name="Proxy Points", description="The most points that stand for the model in Solid view and in other engines",
        default=LIMIT, min=0, max=LIMIT)
    set_scene_range: BoolProperty(
        name="Set Scene Range", description="Set the scene's first and last frame and its frame rate from the capture", default=False)
    use_engine: BoolProperty(
        name="Render with FAST-GS", description="Make FAST-GS the scene's render engine", default=False)

    def invoke(self, context, event):
        return self.invoke_popup(context)

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(self, "relative_path")
        layout.prop(self, "orientation")
        layout.prop(self, "proxy_points")
        col = layout.column(heading="Scene")
        col.prop(self, "set_scene_range", text="Frame Range")
        col.prop(self, "use_engine", text="Render Engine")

    def paths(self) -> list[str]:
        """The chosen files."""
        if any(file.name for file in self.files):
            return [str(Path(bpy.path.abspath(self.directory or str(Path(self.filepath).parent)), file.name)) for file in self.files]
        return [self.filepath] if self.filepath else []

    def create(self, context, path: str) -> bpy.types.Object:
        """Import one file; what cannot be taken over from it is reported."""
        with warnings.catch_warnings(record=True) as remarks:
            warnings.simplefilter("always")
            obj = splat_object.create(
                context, path, limit=self.proxy_points, orient=self.orientation == 'AUTO', relative=self.relative_path)
        for remark in remarks:
            self.report({'WARNING'}, str(remark.message))
        return obj

    def execute(self, context):
        paths = self.paths()
        if not paths:
            self.report({'ERROR'}, "No file was chosen; choose a .safetensors, .ply or .splatv file.")
            return {'CANCELLED'}
        if context.mode != 'OBJECT':
            bpy.ops.object.mode_set(mode='OBJECT')
        made = []
        for path in paths:
            try:
                made.append(self.create(context, path))
            except FastGSError as error:
                self.report({'ERROR'}, splat_object.sentence(error))
        if not made:
            return {'CANCELLED'}
        for obj in made:
            obj.select_set(True)
        if self.set_scene_range:
            fit_scene(context.scene, made[0])
        if self.use_engine:
            context.scene.render.engine = 'FASTGS'
        compiling.start_on_first_use()
        total = sum(obj.fastgs.gaussian_count for obj in made)
        self.report({'INFO'}, f"Imported {total:,} Gaussians from {len(made)} file{'s' if len(made) > 1 else ''}")
        return {'FINISHED'}


class FASTGS_FH_import(bpy.types.FileHandler):
    """Files of 4D Gaussians dropped into Blender's window."""

    bl_idname = "FASTGS_FH_import"
    bl_label = "4D Gaussians"
    bl_import_operator = "import_scene.fastgs"
    bl_file_extensions = ";".join(EXTENSIONS)

    @classmethod
    def poll_drop(cls, context):
        return context.area is not None and context.area.type in {'VIEW_3D', 'OUTLINER'}

# SPDX-License-Identifier: GPL-3.0-or-later
"""File > Import > 4D Gaussians, and the same by dropping files into the 3D view."""
from __future__ import annotations

from pathlib import Path

import bpy
from bpy.props import BoolProperty, CollectionProperty, EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ..engine import compiling
from ..fastgs_blender.formats import FORMATS, readable
from ..fastgs_blender.formats.sequences import grouped
from ..fastgs_blender.formats.streamed_sog import with_level
from ..scene import upright
from ..scene.splats.importing import Options, decided, import_files
from ..scene.splats.proxy import LIMIT
from .action import Action, draw_options
from .fit_scene import offer_set_up
from .upright import AXES

PATTERNS = tuple(f"*{name}" if name.startswith(".") else name for name in readable())
"""What the file dialog shows."""
SCENE = {"set_scene_range": "fit_range", "use_engine": "use_engine", "camera": "camera"}
"""Properties that set up the scene, and the options that they are."""


class FASTGS_OT_import(Action, bpy.types.Operator, ImportHelper):
    """Import models of 4D Gaussians; the .blend stores the files' paths, not their content"""

    bl_idname = "import_scene.fastgs"
    bl_label = "Import 4D Gaussians"
    bl_options = {'REGISTER', 'UNDO', 'PRESET'}

    filter_glob: StringProperty(default=";".join(PATTERNS), options={'HIDDEN'})
    directory: StringProperty(subtype='DIR_PATH', options={'HIDDEN', 'SKIP_SAVE', 'SKIP_PRESET'})
    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options={'HIDDEN', 'SKIP_SAVE', 'SKIP_PRESET'})

    relative_path: BoolProperty(name="Relative Path", description="Store the path relative to the .blend, once that is saved", default=True)
    as_sequence: BoolProperty(
        name="Numbered Files as Sequences", description="Make one object, an animation, of chosen files whose names differ in one number; "
        "else each file becomes an object", default=True)
    level: IntProperty(
        name="Level of Detail", description="Of streamed SOG (lod-meta.json): 0 is the finest level; higher ones have fewer Gaussians",
        default=0, min=0, max=99, options={'SKIP_SAVE'})
    orientation: EnumProperty(
        name="Up Axis", description="Which axis of the file points up. After the import, another choice shows at once in the view",
        items=(
            ('AUTO', "As the File Says", "The axis that the file names, or that is usual in its format", 0),
            ('KEEP', "Unturned", "The file's own axes are Blender's", 1),
            *((axis, f"{name} Up", f"{what}; a file that says another one itself is believed", number + 1)
              for axis, name, what, number in AXES),
        ),
        default='AUTO')
    proxy_points: IntProperty(
        name="Proxy Points", description="Most points that stand for the model where Gaussians are not drawn, as in other engines",
        default=LIMIT, min=0, max=LIMIT)
    set_scene_range: BoolProperty(
        name="Set Scene Range", description="Set the scene's first and last frame and its frame rate from the capture; a new scene gets "
        "them unasked", default=False, options={'SKIP_SAVE'})
    view: EnumProperty(
        name="View", description="What the window's 3D views show afterwards",
        items=(
            ('SUBJECT', "Subject", "The capture, from where it was filmed if the file says so; views through a camera stay", 0),
            ('CAMERA', "Look through a Capture Camera", "Make a camera where one stood that filmed the capture, and look through it", 1),
            ('KEEP', "As It Is", "What they show now", 2),
        ),
        default='SUBJECT')
    use_engine: BoolProperty(
        name="Render with FAST-GS", description="Make FAST-GS the scene's render engine; a new scene gets it unasked", default=False,
        options={'SKIP_SAVE'})
    camera: BoolProperty(
        name="Camera", description="Let a new camera see what the 3D view shows, so that F12 does; new scenes, and empty ones, get it "
        "unasked", default=False, options={'SKIP_SAVE'})

    def invoke(self, context, event):
        self.choose(context)
        return self.invoke_popup(context)

    def choose(self, context) -> None:
        """What nobody has chosen is as the scene has it: new scenes are set up."""
        chosen = decided(context.scene, Options())
        self.fill(**{name: getattr(chosen, option) for name, option in SCENE.items()})

    def draw(self, context):
        layout = draw_options(self, "relative_path", "as_sequence", "level", "orientation", "proxy_points", "view")
        col = layout.column(heading="Scene")
        col.prop(self, "set_scene_range", text="Frame Range")
        col.prop(self, "use_engine", text="Render Engine")
        col.prop(self, "camera")
        header, body = layout.panel("FASTGS_import_formats", default_closed=True)
        header.label(text="Formats")
        if body is not None:
            col = body.column(align=True)
            for known in FORMATS:
                col.label(text=f"{known.name} ({', '.join(known.reads)})", translate=False)

    def paths(self) -> list[str]:
        """The chosen files, and patterns of the names of those that are sequences."""
        if any(file.name for file in self.files):
            folder = bpy.path.abspath(self.directory or str(Path(self.filepath).parent))
            chosen = [Path(folder, file.name) for file in self.files]
            return [str(path) for path in (grouped(chosen) if self.as_sequence else chosen)]
        return [self.filepath] if self.filepath else []

    def execute(self, context):
        paths = [str(with_level(Path(path), self.level)) for path in self.paths()]
        if not paths:
            return self.fail(f"no file was chosen; choose one of {', '.join(readable())}.")
        self.choose(context)
        done = import_files(context, paths, Options(
            self.proxy_points, self.orientation != 'KEEP', self.relative_path, self.set_scene_range, self.use_engine, self.camera,
            self.view, self.orientation if self.orientation in upright.TURNS else None))
        if done.objects:
            compiling.start_on_first_use()
            offer_set_up(context, self)
        return done.report(self)


class FASTGS_FH_import(bpy.types.FileHandler):
    """Files of 4D Gaussians dropped into Blender's window."""

    bl_idname = "FASTGS_FH_import"
    bl_label = "4D Gaussians"
    bl_import_operator = "import_scene.fastgs"
    bl_file_extensions = ";".join(name for name in readable() if name.startswith("."))

    @classmethod
    def poll_drop(cls, context):
        return context.area is not None and context.area.type in {'VIEW_3D', 'OUTLINER'}

# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's preferences."""
from __future__ import annotations

import bpy

from ..engine import compiling, settings
from ..fastgs_blender.kernels import cache
from .object_panels import draw_rows


def _apply(self, context):
    settings.apply(self)


class FASTGS_AP_preferences(bpy.types.AddonPreferences):
    """Threads, compiled kernels, log."""

    bl_idname = settings.EXTENSION

    threads: bpy.props.IntProperty(
        name="Threads", description="Threads for rendering where the scene does not fix their number; 0 takes all processors",
        default=0, min=0, max=1024, update=_apply)
    cache_folder: bpy.props.StringProperty(
        name="Kernel Folder", description="Where the compiled renderer is kept; empty for the extension's own folder",
        subtype='DIR_PATH', update=_apply)
    log_level: bpy.props.EnumProperty(
        name="Log", description="What is written to the console",
        items=(('ERROR', "Errors", "Only what went wrong", 0), ('WARNING', "Warnings", "Also what may surprise", 1),
               ('INFO', "Information", "Also what is being done", 2), ('DEBUG', "Everything", "For finding mistakes", 3)),
        default='WARNING', update=_apply)

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(self, "threads")
        layout.prop(self, "log_level")

        col = layout.column(heading="Renderer")
        draw_rows(col, [("Compiled", kernel_state())])
        col.prop(self, "cache_folder")
        row = col.row()
        row.operator("fastgs.compile_kernels", icon='PLAY')
        row.operator("fastgs.clear_kernels", icon='TRASH')

        layout.separator()
        layout.operator("fastgs.copy_diagnostics", icon='COPYDOWN')


def kernel_state() -> str:
    """One line about the compiled renderer."""
    if not compiling.has_numba():
        return "numba is missing: rendering is done by NumPy, slowly"
    if compiling.is_running():
        return "being compiled now"
    return f"yes, {cache.size() / 1e6:.1f} MB" if cache.is_filled() else "not yet; the first use does it"


CLASSES = (FASTGS_AP_preferences,)

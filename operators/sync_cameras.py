# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds how far the clocks of a capture's cameras are from each other, in a process that Blender watches."""
from pathlib import Path

import bpy
from bpy.props import StringProperty

from ..fastgs_blender.jobs import sync
from ..scene.settings import BLEND_RELATIVE
from ..scene.training import installation, watch
from .action import keep_text
from .stepwise import Stepwise, watched


class FASTGS_OT_sync_cameras(Stepwise, bpy.types.Operator):
    """Find how far the clocks of the capture's cameras are apart, from sound, a flash or motion, for training to use. Esc ends it"""

    bl_idname = "fastgs.sync_cameras"
    bl_label = "Sync Cameras"

    capture: StringProperty(name="Capture", description="The capture's folder; by default the panel's", subtype='DIR_PATH',
                            options={'SKIP_SAVE'} | BLEND_RELATIVE)

    doing = "Comparing the cameras' clocks"
    free = True
    interrupted = "{} was interrupted; nothing was written"

    def steps(self, context):
        self._path = installation.capture_path(self.capture or context.scene.fastgs.training.capture)
        running = sync.Sync(installation.python(), self._path)
        return watched(running, lambda: running.progress)

    def finish(self, context, values):
        name = keep_text(context, f"Clocks of {Path(self._path).name}", sync.text_of(self._path, values))
        watch.redraw()
        if values["lost"]:
            self.warn(f"The clocks of {', '.join(values['lost'])} could not be found and are taken as right")
        return f'{sync.summary_of(values)}. The text "{name}" tells more'

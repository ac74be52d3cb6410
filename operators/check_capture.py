# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks a capture before training: what is wrong with it, as a page in the browser and a text in Blender."""
import os
from pathlib import Path

import bpy
from bpy.props import BoolProperty, StringProperty

from ..fastgs_blender.jobs import capture_check
from ..scene.settings import BLEND_RELATIVE
from ..scene.training import installation, watch
from ..scene.training.options import capture_arguments
from .action import keep_text
from .stepwise import Stepwise, watched

TEXT = "FAST-GS Check"
MOST = 3
"""Findings that are reported by themselves."""


class FASTGS_OT_check_capture(Stepwise, bpy.types.Operator):
    """Look at a capture's pictures for a minute, and say what will make its model poor: calibration, clocks, light, focus, coverage"""

    bl_idname = "fastgs.check_capture"
    bl_label = "Check Capture"

    capture: StringProperty(name="Capture", description="The capture's folder, or a file that describes it; by default the panel's",
                            subtype='DIR_PATH', options={'SKIP_SAVE'} | BLEND_RELATIVE)
    out: StringProperty(name="Page", description="Folder for the page; empty: a folder beside the capture", subtype='DIR_PATH',
                        options={'SKIP_SAVE'} | BLEND_RELATIVE)
    open_page: BoolProperty(name="Open Page", description="Show the page with pictures in the web browser", default=True,
                            options={'SKIP_SAVE'})

    doing = "Checking the capture"
    free = True
    interrupted = "{} was interrupted; no page was written"

    def steps(self, context):
        settings = context.scene.fastgs.training
        path = installation.capture_path(self.capture or settings.capture)
        running = capture_check.CaptureCheck(installation.python(), path, self._folder(path), capture_arguments(settings))
        return watched(running, lambda: running.progress)

    def _folder(self, path: str) -> str:
        """Where the page goes: as asked, beside the capture (""), or into the extension's folder where nothing can be written there."""
        if self.out:
            return bpy.path.abspath(self.out)
        parent = Path(path).resolve().parent
        return "" if os.access(parent, os.W_OK) else str(installation.folder("checks") / Path(path).name)

    def finish(self, context, values):
        keep_text(context, TEXT, capture_check.text_of(values))
        watch.redraw()
        for finding in values["findings"][:MOST]:
            if finding["severity"] != "note":
                self.warn(finding["sentence"])
        if self.open_page and not bpy.app.background:
            bpy.ops.wm.url_open(url=Path(values["page"]).resolve().as_uri())
        return f"{values['verdict']} The text {TEXT} and the page {values['page']} tell more"

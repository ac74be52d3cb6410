# SPDX-License-Identifier: GPL-3.0-or-later
"""What the exports of splats share: they say what is not kept before they write, work in steps, and report at the end."""
import warnings
from contextlib import contextmanager
from pathlib import Path

import bpy
from bpy_extras.io_utils import ExportHelper

from .. import fastgs_blender as fg
from ..fastgs_blender.util.errors import printable
from ..scene import objects
from ..scene.notices import draw_trouble
from ..scene.splats.splat_object import sentence
from .action import Need
from .stepwise import Stepwise


class Exporting(Stepwise):
    """Base class of operators that export splats, beside bpy.types.Operator and ExportHelper."""

    bl_options = {'PRESET'}
    needs = (Need(lambda context: any(objects.is_splat(obj) for obj in context.view_layer.objects), "The scene has no splat objects"),)
    interrupted = "The export was cancelled; nothing was written"

    def invoke(self, context, event):
        self._interactive = True
        return ExportHelper.invoke(self, context, event)

    def losses(self, context) -> list[str]:
        """Clauses on what the file would not hold; raises FastGSError where nothing could be written."""
        raise NotImplementedError

    def write(self, context, target: Path):
        """Yields the progress, as steps for begin(); returns what was written, in words."""
        raise NotImplementedError

    def draw_losses(self, context):
        """A list of what is not kept, or why nothing can be written."""
        try:
            lost = self.losses(context)
        except fg.FastGSError as error:
            draw_trouble(self.layout, context, sentence(error))
            return
        header, body = self.layout.panel("FASTGS_export_losses")
        header.label(text="Not Kept" if lost else "Everything Is Kept")
        if body is not None:
            for clause in lost:
                draw_trouble(body, context, clause, 'NONE')

    def steps(self, context):
        self._remarks = []
        return self.write(context, Path(bpy.path.abspath(self.filepath)))

    def finish(self, context, written):
        self.report({'INFO'}, printable(f"Exported {written}"))
        for text in dict.fromkeys(self._remarks):  # last, because the status bar shows the last report
            self.warn(text)

    @contextmanager
    def listening(self):
        """Keeps what the block warns of for the report at the end."""
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            yield
        self._remarks += [printable(remark.message) for remark in heard if issubclass(remark.category, fg.LossWarning)]

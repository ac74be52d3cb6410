# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that hide Gaussians for what they are, and make an object of them."""
from __future__ import annotations

import bpy
import numpy as np
from bpy.props import EnumProperty, IntProperty

from .. import fastgs_blender as fg
from ..fastgs_blender.rendering.filters import parting, values
from ..scene import objects
from .action import EDITABLE_SPLATS, Action, Need, item_of

PRESETS = (
    ('FLOATERS', "Floaters", "Hide Gaussians that have hardly any others around them", 0),
    ('LARGE', "Large", "Hide the hundredth of the Gaussians that is largest", 1),
    ('FAINT', "Faint", "Hide Gaussians of an opacity of less than a tenth", 2),
    ('MOVING', "Moving Part", "Show only what moves", 3),
    ('STATIC', "Static Part", "Show only what does not move", 4),
    ('SHORT', "Short-Lived", "Hide what is seen for less than a tenth of the clip", 5),
    ('COLOUR', "Colour", "Hide what has nearly a colour, such as that of a screen", 6),
    ('CAMERAS', "Hardly Filmed", "Hide what fewer than three cameras of the capture have in their pictures", 7),
)


class FASTGS_OT_add_filter(Action, bpy.types.Operator):
    """Hide or show Gaussians of the active object by size, opacity, speed, lifetime, colour or neighbours"""

    bl_idname = "fastgs.add_filter"
    bl_label = "Add Filter"
    needs = (EDITABLE_SPLATS,)

    preset: EnumProperty(name="Filter", description="What the filter begins with; every value can be changed", items=PRESETS)

    def act(self, context):
        kind, low, high, mode = _start(self.preset, objects.load_model(objects.abspath(context.object)))
        item = context.object.fastgs.filters.add()
        item.kind, item.low, item.high, item.mode = kind, low, high, mode


def _start(preset: str, model) -> tuple[str, float, float, str]:
    """(kind, low, high, mode) of a new filter for a model."""
    most = 1e6
    if preset == 'FLOATERS':
        return 'NEIGHBOURS', 0.0, 2.0, 'HIDE'
    if preset == 'FAINT':
        return 'OPACITY', 0.0, 0.1, 'HIDE'
    if preset == 'COLOUR':
        return 'COLOUR', 0.0, 0.2, 'HIDE'
    if preset == 'CAMERAS':
        if not model.surroundings.cameras:
            raise fg.FastGSError("the file knows no cameras of its capture; store them with fastgs annotate.")
        return 'CAMERAS', 0.0, 2.0, 'HIDE'
    if not isinstance(model, fg.GaussianModel):
        raise fg.FastGSError("of a sequence this filter knows no values to begin with; add another one and choose its kind and range.")
    if preset == 'LARGE':
        return 'SIZE', float(np.percentile(values(model, "SIZE"), 99)) if len(model) else 1.0, most, 'HIDE'
    if preset == 'SHORT':
        return 'LIFETIME', 0.0, 0.1 * model.clip.duration, 'HIDE'
    speed = parting(values(model, "SPEED"))
    return ('SPEED', speed, most, 'KEEP') if preset == 'MOVING' else ('SPEED', 0.0, speed, 'KEEP')


class _OnFilter(Action):
    needs = (EDITABLE_SPLATS, Need(lambda context: len(context.object.fastgs.filters) > 0, "The object has no filters"))

    index: IntProperty(name="Index", description="Which of the object's filters", min=0)


class FASTGS_OT_remove_filter(_OnFilter, bpy.types.Operator):
    """Remove this filter: what it hides is shown again"""

    bl_idname = "fastgs.remove_filter"
    bl_label = "Remove Filter"

    def act(self, context):
        item_of(context.object.fastgs.filters, self.index)
        context.object.fastgs.filters.remove(self.index)
        context.object.update_tag()


class FASTGS_OT_separate(_OnFilter, bpy.types.Operator):
    """Make a new object that shows what this filter hides"""

    bl_idname = "fastgs.separate"
    bl_label = "Separate by Filter"

    def act(self, context):
        item_of(context.object.fastgs.filters, self.index)
        item = objects.duplicate(context, context.object).fastgs.filters[self.index]
        item.mode = 'KEEP' if item.mode == 'HIDE' else 'HIDE'

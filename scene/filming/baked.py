# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes the filmed objects into a model beside the pictures; training starts from it, because the shape and motion of a scene are known."""
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import bpy

from ... import fastgs_blender as fg
from ...fastgs_blender.captures.layouts.fastgs import BAKE
from ...fastgs_blender.util.errors import FastGSError
from ..background import relayed
from ..meshes.baking import bake_steps
from ..meshes.options import bake_options

COUNT = 150_000
"""Gaussians on all surfaces; training takes those that the pictures show."""


def bake_filmed_steps(studio, plan, names: set[str], fps: float, out: Path):
    """A generator that bakes the filmed objects of these names: it yields shares 0..1, and returns a note for the user, or None.

    Where a surface cannot be followed there is no bake, and training begins with what the pictures tell.
    """
    path, count = out / BAKE, len(plan.frames)
    if path.exists():
        return None
    last = plan.frame_start + plan.frame_step * count - 1
    context = SimpleNamespace(scene=studio.scene, evaluated_depsgraph_get=lambda: studio.depsgraph)
    objects = [obj for obj in studio.scene.objects if obj.name in names]
    options = bake_options(frame_start=plan.frame_start, frame_end=last, count=COUNT)
    steps = bake_steps(context, objects, options, apart=not bpy.app.background)
    try:
        model, *_ = yield from relayed(steps, lambda step: step[0])
    except FastGSError as error:
        return f"training cannot begin with the shape of the objects: {error}"
    fg.save(replace(model, clip=fg.Clip(count, fps, 1)), path)
    return None

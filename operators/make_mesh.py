# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator that makes a mesh of a splat object's surface."""
import time
from functools import partial

import bpy
from bpy.props import EnumProperty, IntProperty

from ..fastgs_blender.surfaces.making import make_mesh
from ..fastgs_blender.util.errors import FastGSError
from ..scene.background import in_steps
from ..scene.meshes import moving_mesh
from .action import EDITABLE_SPLATS, OBJECT_MODE
from .stepwise import Stepwise


class FASTGS_OT_make_mesh(Stepwise, bpy.types.Operator):
    """Make a mesh of this object's surface on this frame, which moves as the splats do, for light, shadows and simulations in any engine"""

    bl_idname = "fastgs.make_mesh"
    bl_label = "Make Mesh"
    bl_options = {'REGISTER', 'UNDO'}
    needs = (OBJECT_MODE, EDITABLE_SPLATS)
    doing, interrupted = "Making a mesh", "Making a mesh was cancelled; nothing was made"

    detail: IntProperty(
        name="Detail", description="Faces along the longest side. Twice as many show finer parts and take four times the memory",
        default=160, min=16, soft_max=320, max=1024)
    shape: EnumProperty(
        name="Shape", description="Which parts of the surface are made",
        items=(('AUTO', "By Cameras", "Open if the file knows its cameras and they stood on one side; else closed", 2),
               ('CLOSED', "Closed", "A surface without holes, which has an inside", 0),
               ('OPEN', "Open", "Only what the cameras of the capture saw, as far as the file knows them", 1)),
        default='AUTO')
    smoothing: IntProperty(
        name="Smoothing", description="How often the surface is averaged with its neighbourhood; more for noisy captures", default=2, min=0,
        soft_max=20, max=1000)

    def steps(self, context):
        """Yields the share that is done; returns the object, its model and the meshes."""
        self._began = time.monotonic()
        obj = context.object
        model, t = moving_mesh.shown(obj, context.evaluated_depsgraph_get())
        closed = None if self.shape == 'AUTO' else self.shape == 'CLOSED'
        work = partial(make_mesh, model, t, detail=self.detail, closed=closed, smoothing=self.smoothing)
        return obj, model, (yield from in_steps(lambda progress: work(progress=progress), self.in_window))

    def finish(self, context, result):
        obj, model, meshes = result
        try:
            made = moving_mesh.build(context, obj, meshes, model)
        except ReferenceError:
            raise FastGSError("the splat object was deleted meanwhile; make its mesh again.") from None
        faces, taken = sum(len(mesh.quads) for mesh in meshes), time.monotonic() - self._began
        text = f'"{made[0].name}" has {faces:,} faces and moves with "{obj.name}"; {taken:.1f} s'
        if self.shape == 'AUTO' and not meshes[0].closed:
            text += "; it is open, because the cameras of the capture stood on one side: nobody saw the back"
        if len(meshes) > 1:
            frames = ", ".join(f"{mesh.times[0] * model.clip.frame_count:.4g}" for mesh in meshes[1:])
            text += f"; where it tears it is made anew: {len(meshes)} meshes, the next from frame {frames} of the capture on"
        return text

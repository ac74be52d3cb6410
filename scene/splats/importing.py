# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports model files: makes a splat object for each, and sets up the scene where that is wanted."""
from __future__ import annotations

import warnings
from dataclasses import dataclass, field

import bpy

from ...fastgs_blender.util.errors import FastGSError, printable
from .. import startup, upright
from ..cameras import framing
from ..frame_range import fit_scene
from . import splat_object
from .proxy import LIMIT


@dataclass(frozen=True)
class Options:
    """How files are imported.

    limit       the most points of an object's proxy
    orient      turn models from their files' axes to Blender's
    up          the axis that points up in files that do not say it, a key of upright.TURNS; None: as is usual
    relative    keep paths relative to the .blend, where that is possible
    fit_range   set the scene's range and frame rate from the first file
    use_engine  make FAST-GS the scene's render engine
    view        'SUBJECT': show the first object in the window's 3D views; 'CAMERA': look through a camera of its capture; 'KEEP'
    """

    limit: int = LIMIT
    orient: bool = True
    relative: bool = False
    fit_range: bool = False
    use_engine: bool = False
    view: str = 'KEEP'
    up: str | None = None


@dataclass
class Imported:
    """The objects that an import made, and what there is to say about it."""

    objects: list[bpy.types.Object] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)

    def report(self, operator) -> set[str]:
        """Report it as an operator does; returns what its execute() is to return."""
        for kind, texts in (('WARNING', self.warnings), ('ERROR', self.errors)):
            for text in texts:
                operator.report({kind}, text)
        if not self.objects:
            return {'CANCELLED'}
        total, files = sum(obj.fastgs.gaussian_count for obj in self.objects), len(self.objects)
        operator.report({'INFO'}, f"Imported {total:,} Gaussians from {files} file{'s' if files > 1 else ''}")
        for text in self.remarks:
            operator.report({'INFO'}, text)
        return {'FINISHED'}


def import_files(context, paths: list[str], options: Options) -> Imported:
    """Import files: the new objects are selected, the last one is active.  A file that cannot be read is left out."""
    if context.mode != 'OBJECT':
        bpy.ops.object.mode_set(mode='OBJECT')
    done = Imported()
    for path in paths:
        with warnings.catch_warnings(record=True) as remarks:
            warnings.simplefilter("always")
            try:
                obj = splat_object.create(context, path, options.limit, options.orient, options.relative, options.up)
            except FastGSError as error:
                done.errors.append(splat_object.sentence(error))
            else:
                done.objects.append(obj)
                if options.up is not None and upright.axis_of(obj) != options.up:
                    done.remarks.append(f'The file of "{obj.name}" says which axis points up, and it does; Up Axis lets another one')
        done.warnings += [printable(remark.message) for remark in remarks]
    if done.objects:
        _set_up(context, done, options)
    return done


def _set_up(context, done: Imported, options: Options) -> None:
    """Select the new objects, set up the scene as the options say, and let what was imported be seen."""
    scene, first = context.scene, done.objects[0]
    for obj in done.objects:
        obj.select_set(True)
    if options.fit_range:
        fit_scene(scene, next((obj for obj in done.objects if obj.fastgs.frame_count > 1), first))
    if options.use_engine:
        scene.render.engine = 'FASTGS'
    if options.view != 'KEEP':
        _show(context, done, options.view == 'CAMERA')
        cube = startup.hide_cube(context, done.objects, framing.eyes(context))
        if cube is not None:
            done.remarks.append(f'"{cube.name}" of the startup file stood in the capture, or before it, and is hidden')
    if startup.dulls_colours(scene):
        done.remarks.append(startup.REMARK)


def _show(context, done: Imported, through_camera: bool) -> None:
    """Let the window's 3D views show the new objects."""
    context.view_layer.update()
    if through_camera:
        try:
            framing.look_through(context, done.objects[0])
        except FastGSError as error:
            done.warnings.append(splat_object.sentence(error))
        else:
            return
    framing.show(context, done.objects)

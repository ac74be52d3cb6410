# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports model files: makes a splat object for each, and sets up the scene where that is wanted."""
from __future__ import annotations

import warnings
from dataclasses import dataclass, field

import bpy

from ...fastgs_blender.util.errors import FastGSError, printable
from ..frame_range import fit_scene
from . import splat_object
from .proxy import LIMIT


@dataclass(frozen=True)
class Options:
    """How files are imported.

    limit       the most points of an object's proxy
    orient      turn objects from their files' axes to Blender's
    relative    keep paths relative to the .blend, where that is possible
    fit_range   set the scene's range and frame rate from the first file
    use_engine  make FAST-GS the scene's render engine
    """

    limit: int = LIMIT
    orient: bool = True
    relative: bool = False
    fit_range: bool = False
    use_engine: bool = False


@dataclass
class Imported:
    """The objects that an import made, and what there is to say about it."""

    objects: list[bpy.types.Object] = field(default_factory=list)
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
                done.objects.append(splat_object.create(context, path, options.limit, options.orient, options.relative))
            except FastGSError as error:
                done.errors.append(splat_object.sentence(error))
        done.warnings += [printable(remark.message) for remark in remarks]
    for obj in done.objects:
        obj.select_set(True)
    if done.objects and options.fit_range:
        fit_scene(context.scene, done.objects[0])
    if done.objects and options.use_engine:
        context.scene.render.engine = 'FASTGS'
    return done

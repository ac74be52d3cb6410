# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports model files: makes a splat object for each, and sets up the scene where that is wanted."""
import warnings
from dataclasses import dataclass, field, replace

import bpy

from ...fastgs_blender.util.errors import FastGSError, printable
from .. import objects, startup, upright
from ..cameras import framing, from_view
from ..frame_range import fit_scene
from . import parting, splat_object
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
    camera      let a camera see what the 3D view shows: the startup file's, as long as nobody has placed it, or a new one
                Of these three None means: in an untouched scene (startup.py); a camera, where the scene holds nothing at all, too
    view        'SUBJECT': show the first object in the window's 3D views; 'CAMERA': look through a camera of its capture; 'KEEP'
    """

    limit: int = LIMIT
    orient: bool = True
    relative: bool = False
    fit_range: bool | None = None
    use_engine: bool | None = None
    camera: bool | None = None
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
        total, files = sum(len(objects.load_model(objects.abspath(obj))) for obj in self.objects), len(self.objects)
        operator.report({'INFO'}, f"Imported {total:,} Gaussians from {files} file{'s' if files > 1 else ''}")
        for text in self.remarks:
            operator.report({'INFO'}, text)
        return {'FINISHED'}


def import_files(context, paths: list[str], options: Options) -> Imported:
    """Import files: the new objects are selected, the last one is active.  A file that cannot be read is left out."""
    if context.mode != 'OBJECT':
        bpy.ops.object.mode_set(mode='OBJECT')
    done, options, new = Imported(), decided(context.scene, options), startup.is_untouched(context.scene)
    for path in paths:
        with warnings.catch_warnings(record=True) as remarks:
            warnings.simplefilter("always")
            try:
                obj = splat_object.create(context, path, options.limit, options.orient, options.relative, options.up)
            except FastGSError as error:
                done.errors.append(splat_object.sentence(error))
            else:
                done.objects.append(obj)
                parting.from_file(context, obj)
                if options.up is not None and upright.axis_of(obj) != options.up:
                    done.remarks.append(f'The file of "{obj.name}" says which axis points up, and it does; Up Axis lets another one')
        done.warnings += [printable(remark.message) for remark in remarks]
    if done.objects:
        _set_up(context, done, options, context.scene.camera if new else None)
    return done


def decided(scene: bpy.types.Scene, options: Options) -> Options:
    """The options with what a scene as it is before an import makes of those that nobody has chosen."""
    new, bare = startup.is_untouched(scene), not scene.objects
    usual = {"fit_range": new, "use_engine": new, "camera": new or bare}
    return replace(options, **{name: value for name, value in usual.items() if getattr(options, name) is None})


def _set_up(context, done: Imported, options: Options, camera: bpy.types.Object | None) -> None:
    """Select the new objects, set up the scene as the options say, and let what was imported be seen.

    camera  the startup file's, which nobody has placed yet
    """
    scene, first, through = context.scene, done.objects[0], False
    for obj in done.objects:
        obj.select_set(True)
    if options.fit_range:
        fit_scene(scene, next((obj for obj in done.objects if obj.fastgs.frame_count > 1), first))
    if options.use_engine:
        scene.render.engine = 'FASTGS'
    if options.view != 'KEEP':
        through = _show(context, done, options.view == 'CAMERA')
        cube = startup.hide_cube(context, done.objects, framing.eyes(context))
        if cube is not None:
            done.remarks.append(f'"{cube.name}" of the startup file stood in the capture, or before it, and is hidden')
    if options.camera and not through:
        context.view_layer.update()
        camera = from_view.stand_in_view(context, done.objects, camera)
        done.remarks.append(f'F12 shows what the 3D view shows, through "{camera.name}"')
    if startup.dulls_colours(scene):
        done.remarks.append(startup.REMARK)


def _show(context, done: Imported, through_camera: bool) -> bool:
    """Let the window's 3D views show the new objects; whether through a camera of their capture."""
    context.view_layer.update()
    if through_camera:
        try:
            framing.look_through(context, done.objects[0])
        except FastGSError as error:
            done.warnings.append(splat_object.sentence(error))
        else:
            return True
    framing.show(context, done.objects)
    return False

# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's handlers for the beginning of a render job and for opening, saving and appending files."""
import bpy
from bpy.app.handlers import persistent

from ..scene import composite, mesh_scene, notices, objects, point_edits, proxies, selection, updates
from ..scene.meshes import moving_mesh
from ..scene.splats import bodies, feeding, guard, native, proxy_motion
from . import compiling, light_probe


@persistent
def _begin_job(scene, *_):
    notices.begin_job()
    composite.follow(scene)


@persistent
def _begin_frame(scene, *_):
    mesh_scene.follow_sub_frame(scene)
    light_probe.begin_frame()


@persistent
def _forget_models(*_):
    objects.clear()
    selection.Sight.forget()


@persistent
def _forget_objects(*_):
    guard.forget()
    point_edits.forget()


@persistent
def _compile_for_splats(*_):
    if any(objects.is_splat(obj) for obj in bpy.data.objects):
        compiling.start_on_first_use()


HANDLERS = (
    (bpy.app.handlers.render_init, _begin_job),
    (bpy.app.handlers.render_pre, _begin_frame),
    (bpy.app.handlers.load_pre, _forget_models),
    (bpy.app.handlers.load_pre, _forget_objects),
    (bpy.app.handlers.load_post, _compile_for_splats),
    (bpy.app.handlers.load_post, proxies.update),
    (bpy.app.handlers.frame_change_pre, bodies.rest),
    (bpy.app.handlers.frame_change_pre, feeding.before),
    (bpy.app.handlers.frame_change_pre, moving_mesh.before),
    (bpy.app.handlers.frame_change_post, feeding.after),
    (bpy.app.handlers.frame_change_post, moving_mesh.after),
    (bpy.app.handlers.frame_change_post, light_probe.follow),  # before the splats are hidden from it
    (bpy.app.handlers.frame_change_post, proxy_motion.follow),
    (bpy.app.handlers.depsgraph_update_post, bodies.rest),
    (bpy.app.handlers.depsgraph_update_post, feeding.after),
    (bpy.app.handlers.depsgraph_update_post, moving_mesh.after),
    (bpy.app.handlers.depsgraph_update_post, proxy_motion.follow),
    (bpy.app.handlers.depsgraph_update_post, guard.watch),
    (bpy.app.handlers.depsgraph_update_post, composite.changed),
    (bpy.app.handlers.frame_change_post, native.follow),
    (bpy.app.handlers.depsgraph_update_post, native.follow),
    (bpy.app.handlers.depsgraph_update_post, native.tidy),
    (bpy.app.handlers.undo_post, native.forget),
    (bpy.app.handlers.redo_post, native.forget),
    (bpy.app.handlers.save_pre, native.empty),
    (bpy.app.handlers.save_post, native.fill),
    (bpy.app.handlers.load_post, native.fill),
)
if hasattr(bpy.app.handlers, "blend_import_post"):  # Blender 4.3 and later
    HANDLERS += ((bpy.app.handlers.blend_import_post, proxies.update),)


def register():
    for handlers, function in HANDLERS:
        handlers.append(function)
    updates.mesh_listeners.append(composite.chosen)


def unregister():
    for handlers, function in HANDLERS:
        handlers.remove(function)
    updates.mesh_listeners.remove(composite.chosen)
    _forget_models()

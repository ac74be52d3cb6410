# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders a scene's meshes and splats as one picture: *Render With Meshes*.

Another engine renders the meshes in a scene of their own (mesh_scene.py).  In the compositor, behind each Render Layers node of the
scene, one node joins both pictures (joins.py, composite_nodes.py).  No setting of the scene is changed for it: while it is on, the engine
adds the passes that the join needs and leaves the world to it.  Nothing has to be pressed again: everything is brought into step after
each change, and at the beginning of each render.
"""
import bpy
from bpy.app.handlers import persistent

from ..fastgs_blender.rendering.passes import SHADOWS
from . import joins, mesh_scene, passes_file, shadows
from .holdout import with_meshes

PATIENCE = 0.5
"""Seconds until a change is tried again that a render would not survive."""
NEEDED = ("depth", "holdout")
"""Passes, by their names in the library's table, that the join reads; those of the lamps' shadows too."""


def needs(scene, entry) -> bool:
    """Whether the join needs a pass of the library's table."""
    return with_meshes(scene) and (entry.name in NEEDED or entry in SHADOWS[:len(shadows.lamps(scene))])


@persistent
def changed(scene, depsgraph) -> None:
    """Handler, after each evaluation: bring into step what has changed, once Blender is idle.

    Not at once: Blender 5.2 crashes if objects are linked here while the compositor shows another scene.  A render does not wait for it.
    """
    if depsgraph.mode == 'VIEWPORT' and any(each.fastgs.render_meshes != 'OFF' or mesh_scene.MADE in each for each in bpy.data.scenes):
        _sync_later()


def chosen(scene) -> None:
    """Set up what *Render With Meshes* asks for, or take away all of it; a render that is under way keeps its scenes."""
    if _rendering():
        _sync_later()
    else:
        _sync_all()


def _sync_later():
    if not bpy.app.background and not bpy.app.timers.is_registered(_sync_all):
        bpy.app.timers.register(_sync_all, first_interval=0.0)


def _sync_all():
    if _rendering():
        return PATIENCE
    for other in mesh_scene.left_over():
        mesh_scene.remove(other)
    for scene in [scene for scene in bpy.data.scenes if not mesh_scene.is_one(scene)]:
        _sync(scene)
    return None


def _sync(scene):
    other = mesh_scene.of(scene)
    if scene.fastgs.render_meshes == 'OFF' and other is not None:
        passes_file.follow(scene)
        joins.part(scene)
        mesh_scene.remove(other)
        _renew_passes(scene)
    follow(scene)


def _rendering() -> bool:
    return bpy.app.is_job_running('RENDER')


def _renew_passes(scene):
    for layer in scene.view_layers:
        layer.update_render_passes()


def follow(scene) -> None:
    """Bring the scenes of meshes of all that a scene's compositor shows, and the compositor, into step with *Render With Meshes*."""
    if not scene.is_editable or mesh_scene.is_one(scene):
        return
    if scene.fastgs.render_meshes != 'OFF':
        joins.own_tree(scene)
    for shown in dict.fromkeys(shown for _, shown in joins.layers(scene)):
        if shown.fastgs.render_meshes != 'OFF' and shown.is_editable:
            new = mesh_scene.of(shown) is None
            mesh_scene.follow(shown, _engine(shown.fastgs.render_meshes))
            if new:
                _renew_passes(shown)
    joins.feed_relights(scene)
    joins.join_all(scene)
    passes_file.follow(scene)


def _engine(chosen: str) -> str:
    if chosen == 'CYCLES':
        return 'CYCLES'
    return 'BLENDER_EEVEE_NEXT' if bpy.app.version < (5, 0, 0) else 'BLENDER_EEVEE'

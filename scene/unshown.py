# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds what a scene holds that FAST-GS does not render, so that it is told instead of missed."""
from ..fastgs_blender.rendering.passes import LAMPS
from . import holdout, lamps, light_probe, objects, shadows, world

NAMED = 3
"""Objects that a sentence names; of further ones it gives the number."""


def objects_left_out(scene, view_layer) -> list:
    """The objects with a surface that a final render would show and FAST-GS does not: neither splats, nor boxes that crop them."""
    shown = [obj for obj in view_layer.objects if not obj.hide_render]
    helpers = holdout.helpers(scene)
    return [obj for obj in shown if obj.type in objects.SURFACES and obj.display_type in ('SOLID', 'TEXTURED') and obj.visible_camera
            and not objects.is_splat(obj) and obj.name not in helpers and not holdout.is_held_out(obj, view_layer)]


def meshes(scene, view_layer) -> str | None:
    """A sentence that names the meshes which are not rendered; None where there are none, or another scene renders them."""
    if holdout.with_meshes(scene):
        return None
    left = [obj.name for obj in objects_left_out(scene, view_layer)]
    if not left:
        return None
    more = len(left) - NAMED
    names = ", ".join(left[:NAMED]) + (f" and {more} more" if more > 0 else "")
    return f"FAST-GS does not render meshes: {names}. Render With Meshes lets another engine render them."


def settings(scene, view_layer) -> list[str]:
    """Sentences about settings that are switched on and do nothing here."""
    holdouts = [obj.name for obj in view_layer.objects if objects.is_splat(obj) and holdout.is_held_out(obj, view_layer)]
    probes = [probe for probe in light_probe.all_of(scene) if not probe.hide_render]
    lit = any(objects.is_splat(obj) and lamps.takes_light(obj) for obj in view_layer.objects)
    lamps_here = [obj for obj in view_layer.objects if lit and obj.type == 'LIGHT' and not obj.hide_render]
    uneven = [obj.name for obj in lamps_here if not world.is_plain(obj.data)]
    surplus = [obj.name for obj in shadows.chosen(scene)[LAMPS:]]
    return ([f"Holdout of splats is not rendered yet: {', '.join(holdouts[:NAMED])} is shown as usual."] if holdouts else []) + (
        [f"At most {LAMPS} lamps have a splat shadow; {', '.join(surplus[:NAMED])} has none."] if surplus else []) + (
        [f"One light probe counts, {probes[0].name}; {', '.join(probe.name for probe in probes[1:NAMED + 1])} does nothing."]
        if len(probes) > 1 else []) + (
        [f"Textures in the nodes of lamps do not light splats: {', '.join(uneven[:NAMED])} has its plain colour."] if uneven else [])


def in_viewports(scene) -> str | None:
    """A sentence about what final renders show and viewports do not; None where nothing of it is switched on."""
    camera = scene.camera.data if scene.camera is not None and scene.camera.type == 'CAMERA' else None
    names = ["Depth of Field"] * bool(camera and camera.dof.use_dof) + ["Motion Blur"] * scene.render.use_motion_blur
    return f"{' and '.join(names)} can be seen in final renders only, not in viewports." if names else None


def all_of(scene, view_layer) -> list[str]:
    """Everything that is told: meshes, then settings."""
    text = meshes(scene, view_layer)
    return ([text] if text else []) + settings(scene, view_layer)

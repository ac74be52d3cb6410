# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders the panorama of a light probe, for each frame and view layer of the meshes that another engine is about to render."""
from dataclasses import replace

import numpy as np
from bpy.app.handlers import persistent

from .. import fastgs_blender as fg
from ..fastgs_blender.cameras.panorama import Panorama
from ..fastgs_blender.rendering.colour import lifted, straight
from ..fastgs_blender.rendering.crops import Crop
from ..fastgs_blender.rendering.instances import Moment
from ..scene import colour, devices, exposure, lamps, light_probe, mesh_scene, notices, sky, snapshot
from . import passes, scene_linear

CYCLES = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
"""From the world to the axes of the library's panorama, so that its middle is where Cycles and EEVEE have theirs: towards +X."""
STEPS = 8
"""Of motion blur in a panorama, at the most."""

_seen: set[tuple[str, str]] = set()
"""Scene and view layer of the panoramas of this frame."""


def begin_frame() -> None:
    """Before each frame of a render: its panoramas are not made yet."""
    _seen.clear()


@persistent
def follow(scene, depsgraph=None) -> None:
    """Handler, after each evaluation: give the evaluated world of a scene of meshes the panorama of its frame.

    An engine looks at sub-frames, too, for its motion blur, before and after it has read the world: only the first look counts.
    """
    if depsgraph is None or depsgraph.mode != 'RENDER' or not mesh_scene.is_one(depsgraph.scene):
        return
    layer = depsgraph.view_layer
    world = getattr(layer, "world_override", None) or depsgraph.scene.world
    key = depsgraph.scene.name, layer.name
    if key in _seen or not light_probe.has_panorama(world):
        return
    _seen.add(key)
    panorama = np.zeros((1, 2, 4), np.float32)
    try:
        probe = light_probe.shown(depsgraph.scene, depsgraph)
        if probe is not None:
            panorama = panorama_of(probe, depsgraph)
        light_probe.show(world, panorama)
    except fg.FastGSError as error:
        light_probe.show(world, panorama)
        notices.tell(f"The light probe shows nothing: {error}")
    except OSError as error:
        notices.tell(f"The light probe shows nothing, because its panorama could not be written: {error}.")


def panorama_of(probe, depsgraph) -> np.ndarray:
    """What an evaluated probe sees of the splats of a scene of meshes: [h, 2 h, 4] float32, premultiplied and scene-linear, top row first.

    In motion blur the splats move as their clips do, while their objects stand still.
    """
    scene = depsgraph.scene.fastgs.splats_scene
    centre, size = np.array(probe.matrix_world, np.float64)[:3, 3], light_probe.radius(probe)
    if not (np.isfinite(centre).all() and np.isfinite(size)):
        raise fg.FastGSError(f'the transform of "{probe.name}" holds no finite numbers; clear it, or that of its parents.')
    settings, pose = probe.fastgs.probe, np.eye(4)
    pose[:3, :3], pose[:3, 3] = CYCLES, -CYCLES @ centre
    camera = Panorama(2 * (settings.width // 2), settings.width // 2, pose)
    taken = snapshot.take(depsgraph)
    instances = _around(taken, centre, size)
    stretch = scene.render.frame_map_old / scene.render.frame_map_new
    moments = [Moment({each.place: each for each in _around(replace(taken, frame=taken.frame + stretch * later), centre, size)}, camera)
               for later in exposure.times(scene)]
    blur = exposure.exposure(scene, moments, None)
    device, lit_by, around = devices.wanted(scene), lamps.world_of(depsgraph), None
    if lit_by is not None:
        around = sky.sky.made(sky.WorldRequest(lit_by, (depsgraph.scene.frame_current, depsgraph.scene.frame_subframe), True))
    light = lamps.scene_light(depsgraph, around=around)
    found = scene_linear.render(
        instances, camera, colour.rec709_to_working(), settings=replace(passes.settings(scene), light=light),
        exposure=blur and replace(blur, steps=min(blur.steps, STEPS)), backend="auto" if device == "cpu" else devices.backend(device)[0])
    shining = settings.strength * lifted(straight(found["rgb"], found["alpha"]), settings.highlights) * found["alpha"][..., None]
    return np.concatenate([shining, found["alpha"][..., None]], -1).astype(np.float32)


def _around(taken: snapshot.Snapshot, centre: np.ndarray, size: float) -> list:
    """The instances of a snapshot without what lies in a sphere in the world.  What cannot be shown is left out; the engine tells it."""
    to_sphere = np.diag([1 / max(size, 1e-9)] * 3 + [1.0])
    to_sphere[:3, 3] = -to_sphere[:3, :3] @ centre
    return [replace(each, settings=replace(each.settings, crops=(
        *each.settings.crops, Crop(to_sphere @ each.placement, remove=True, shape="SPHERE")))) for each in taken.load()[0]]

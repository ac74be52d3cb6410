# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads the lamps, the world and the meshes that light splats and throw shadows on them, as the library's SceneLight."""
import numpy as np

from ..fastgs_blender.rendering.lamps import Lamp, cone, dome, flat, panorama
from ..fastgs_blender.rendering.passes import LAMPS
from ..fastgs_blender.rendering.relight import SceneLight
from ..fastgs_blender.util.rotations import transformed
from . import colour, holdout, objects, shadows, sky, world
from .light_linking import Links

AROUND = 512
"""Pixels around of the panorama from which a world's light is taken."""


def names_of(scene) -> list[str]:
    """The names of the lamps of a scene, evaluated or not, in the order of their passes; the world comes after them."""
    return sorted(obj.name_full for obj in scene.objects if obj.type == 'LIGHT')


def count(scene) -> int:
    """How many passes there are of each kind that every lamp has; the last one holds all that are left."""
    return min(len(names_of(scene)) + (scene.world is not None), LAMPS)


def surfaces(depsgraph) -> dict[str, np.ndarray]:
    """The triangles [F, 3, 3] in the world of the meshes that were made of splat objects and are shown, by the names of these."""
    found = {}
    for obj in depsgraph.scene.objects:
        if obj.fastgs.surface_of is not None:
            evaluated = obj.evaluated_get(depsgraph)
            if evaluated.is_evaluated and not evaluated.hide_render:
                matrix = np.array(evaluated.matrix_world, np.float64)
                triangles = transformed(holdout.own_triangles(evaluated), matrix)
                if len(triangles) and np.isfinite(triangles).all():
                    found.setdefault(obj.fastgs.surface_of.name, []).append(triangles)
    return {name: np.concatenate(parts) for name, parts in found.items()}


def world_of(depsgraph, passes: bool = False):
    """The world that lights splats and is more than one colour, so that scene_light() wants its panorama; None where there is none."""
    return _world(depsgraph)[1] if passes or any(takes_light(obj) for obj in _splats(depsgraph)) else None


def _world(depsgraph):
    """As world.surface(), the world that lights; none where diffuse surfaces do not see it (its Ray Visibility)."""
    scene, layer = depsgraph.scene.fastgs.splats_scene or depsgraph.scene, depsgraph.view_layer
    shown = world.shown_in(scene, layer)
    seen = getattr(getattr(shown, "cycles_visibility", None), "diffuse", True)
    return world.surface(scene, layer) if seen else (world.BLACK, None)


def scene_light(depsgraph, size: int = 1024, passes: bool = False, around: sky.Panorama | None = None) -> SceneLight | None:
    """What lights the splats of a scene as the depsgraph has evaluated it; None where no object takes light.

    size    pixels of the longer side of the shadows' pictures
    passes  whether passes want to know it, whatever the objects take
    around  the panorama of world_of(); without it such a world has its plain colour
    """
    if not passes and not any(takes_light(obj) for obj in _splats(depsgraph)):
        return None
    scene = depsgraph.scene.fastgs.splats_scene or depsgraph.scene
    from_working = np.linalg.inv(colour.rec709_to_working())
    found, levels, numbers = [], [], names_of(scene)
    for instance in depsgraph.object_instances:
        obj = instance.object
        if obj.type == 'LIGHT' and instance.show_self and not obj.hide_render:
            lamp = lamp_of(obj, np.array(instance.matrix_world, np.float64), scene.fastgs.shadow_samples, from_working)
            if lamp is not None:
                found.append(lamp)
                levels.append(numbers.index(obj.name_full) if obj.name_full in numbers else LAMPS)
    directions = max(scene.fastgs.shadow_samples, 16)
    radiance, _ = _world(depsgraph)
    shining = dome(from_working @ radiance, directions) if any(radiance) else None
    if around is not None:
        shining = panorama(around.reduced(AROUND) @ from_working.T, directions)
    if shining is not None:
        found.append(shining)
        levels.append(len(numbers))
    settings, (meshes, clear) = scene.fastgs, _meshes(depsgraph)
    return SceneLight(tuple(found), meshes, settings.shadow_bias, size, tuple(min(level, LAMPS - 1) for level in levels),
                      settings.contact_distance, clear)


def _splats(depsgraph) -> list:
    return [obj for obj in depsgraph.objects if objects.is_splat(obj)]


def _meshes(depsgraph) -> tuple[np.ndarray | None, dict[str, np.ndarray]]:
    """(the triangles [F, 3, 3] that throw shadows on splats, or None; by the names of lamps, which of them let their light through)."""
    found = list(holdout.surfaces(depsgraph, _casts_shadows, "visible_shadow"))
    links = Links(depsgraph.scene)
    passed = [(len(triangles), links.clear_to(obj, maker)) for obj, maker, triangles in found]
    clear = {lamp: np.repeat([lamp in lamps for _, lamps in passed], [count for count, _ in passed])
             for lamp in frozenset().union(*(lamps for _, lamps in passed))}
    return (np.concatenate([triangles for _, _, triangles in found]) if found else None), clear


def _casts_shadows(obj, maker) -> bool:
    """Whether an object's surface throws shadows on splats: what catches them, or lets light through, does not."""
    return not (obj.is_shadow_catcher or maker.is_shadow_catcher or holdout.lets_light_through(obj.original))


def takes_light(obj) -> bool:
    """Whether the scene's lamps change how an object shows its splats."""
    settings = obj.fastgs
    return (settings.captured_light, settings.lamp_light, settings.shadows) != (1, 0, 0)


def lamp_of(obj, matrix: np.ndarray, samples: int, from_working: np.ndarray) -> Lamp | None:
    """The library's lamp for an evaluated light object at a place [4, 4], None where it sends nothing to diffuse surfaces.

    from_working  [3, 3] from the scene's primaries to Rec.709
    """
    data = obj.data
    power = data.energy * 2.0 ** getattr(data, "exposure", 0.0) * (from_working @ (_tint(data) * world.emission(data)))
    portal = data.type == 'AREA' and getattr(getattr(data, "cycles", None), "is_portal", False)
    if portal or not obj.visible_diffuse or not (np.isfinite(matrix).all() and np.isfinite(power).all() and power.any()):
        return None
    axes = matrix[:3, :3] / np.maximum(np.linalg.norm(matrix[:3, :3], axis=0), 1e-30)
    light, name = shadows.light_of(data, matrix, samples), obj.name_full
    if not getattr(data, "normalize", True):  # Blender 5: watts of each square metre, or radiance of the sun's disc
        power *= shadows.area_of(data, matrix)
    if data.type == 'SUN':
        return Lamp(light, power / max((light.points @ axes[:, 2]).mean(), 1e-6), name=name)
    if data.type == 'AREA':
        return Lamp(light, power / np.pi, -axes[:, 2], flat(data.spread), name=name)
    soft = data.shadow_soft_size if data.use_soft_falloff else 0.0
    beam = cone(data.spot_size, data.spot_blend) if data.type == 'SPOT' else None
    shape = axes @ np.linalg.pinv(matrix[:3, :3])  # a scaled spot's cone is scaled with it
    return Lamp(light, power / (4 * np.pi), -axes[:, 2], beam, soft, name, None if np.allclose(shape, shape[0, 0] * np.eye(3)) else shape)


def _tint(data) -> np.ndarray:
    """The colour [3] of a light, its temperature included."""
    tint = np.array(data.color[:3], np.float64)
    return tint * np.array(data.temperature_color[:3]) if getattr(data, "use_temperature", False) else tint

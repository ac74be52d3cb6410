# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps the library's table of passes (rendering/passes.py) to Blender: registers them, adds them to a result and fills them.

Nothing here names a pass but where Blender wants something of its own, so that a pass that is added to the table is there.
"""
from operator import attrgetter

import bpy
import numpy as np

from .. import fastgs_blender as fg
from ..fastgs_blender.rendering import cryptomatte
from ..fastgs_blender.rendering.exposure import Exposure
from ..fastgs_blender.rendering.passes import DEFAULTS, PASSES, Pass, PassSettings
from ..fastgs_blender.rendering.quantities import Mist
from ..scene import colour, composite, lamps, shadows
from . import scene_linear

COMBINED = "Combined"
"""Blender's pass that rgb and alpha fill together, over the world.  Every result has it."""

CHOICES = {"Depth": lambda scene: {'MEDIAN': "median_depth", 'FIRST': "first_depth"}.get(scene.fastgs.depth, "depth")}
"""(scene) -> name of the pass in the table, for Blender's passes that several of the table could fill."""

EARLIER = {"Object Index": "IndexOB"} if bpy.app.version < (5, 0, 0) else {}
"""What earlier Blenders call their passes."""


def switched_on(scene, layer) -> list[Pass]:
    """The passes that a view layer wants, one for each of Blender's, in the table's order."""
    names = {p.blender: p.name for p in reversed(PASSES.values()) if p.blender}
    names |= {blender: choose(scene) for blender, choose in CHOICES.items()}
    levels = {"use_pass_cryptomatte_object": -(-layer.pass_cryptomatte_depth // cryptomatte.PAIRS),
              "fastgs.use_pass_shadow": len(shadows.lamps(scene))}
    levels |= {p.switch: lamps.count(scene) for p in PASSES.values() if p.light and p.level}
    return [p for p in PASSES.values() if names.get(p.blender) == p.name and p.level < max(levels.get(p.switch, 1), 1) and (
        attrgetter(p.switch)(layer) or composite.needs(scene, p))]


def in_viewport(shading, scene) -> str | None:
    """The name in the table of the pass that a View3DShading shows; None for the picture itself."""
    found = PASSES.get(shading.fastgs.render_pass.lower())
    if found is None:
        return None
    return CHOICES[found.blender](scene) if found.blender in CHOICES else found.name


def register(engine, scene, layer):
    """Tell the compositor which sockets a view layer has."""
    for p in switched_on(scene, layer):
        engine.register_pass(scene, layer, _name(p), len(p.letters), p.letters, p.kind)


def add(engine, layer, wanted: list[Pass]):
    """Announce a layer's passes that Blender does not add by itself; to be called before begin_result."""
    for p in wanted:
        if not p.standard or not attrgetter(p.switch)(layer):
            engine.add_pass(p.blender, len(p.letters), p.letters, layer=layer.name)


def _name(p: Pass) -> str:
    return EARLIER.get(p.blender, p.blender)


def settings(scene) -> PassSettings:
    """The PassSettings of an evaluated scene, without its frames before and after."""
    sorting = scene.fastgs.sorting.lower()
    if scene.world is None:
        return PassSettings(sorting=sorting)
    mist = scene.world.mist_settings
    return PassSettings(Mist(mist.start, mist.depth, mist.falloff), sorting=sorting)


def images(instances, camera: fg.Camera, wanted: list[Pass], background=None, progress=lambda fraction: None,
           settings: PassSettings = DEFAULTS, exposure: Exposure | None = None, holdout: np.ndarray | None = None,
           backend: str = "auto") -> dict[str, np.ndarray]:
    """All pictures of one view by the names of Blender's passes, [h, w] or [h, w, channels], the top row first.

    instances   list of rendering.instances.Instance
    background  scene-linear colour [3] under the splats, or None for transparent film
    progress    called with 0..1; what it raises cancels the render
    settings    PassSettings
    exposure    Exposure, or None for a sharp picture
    holdout     triangles [F, 3, 3] float32 that hide splats, or None
    backend     the name of the library's backend
    """
    found = scene_linear.render(instances, camera, colour.rec709_to_working(), [p.name for p in wanted], progress, settings, exposure,
                                holdout, backend)
    named = {_name(p): p.shown(found[p.name]) for p in wanted}
    return named | {COMBINED: colour.film(found["rgb"], found["alpha"], background, found.get("holdout"))}


def describe(engine, layer, wanted: list[Pass], names: list[str]):
    """Tell Blender's compositor and files what the numbers of Cryptomatte's passes mean; names: of the objects."""
    if any(p.blender.startswith(cryptomatte.LAYER) for p in wanted):
        result = engine.get_result()
        for field, value in cryptomatte.metadata(sorted(set(names)), f"{layer.name}.{cryptomatte.LAYER}").items():
            result.stamp_data_add_field(field, value)


def fill(result_layer, pictures: dict[str, np.ndarray]):
    """Write the pictures, by their passes' names, into a RenderLayer; Blender's first row is the lowest."""
    for target in result_layer.passes:
        if target.name in pictures:
            target.rect.foreach_set(np.ascontiguousarray(pictures[target.name][::-1], np.float32).ravel())

# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps the library's table of passes (rendering/passes.py) to Blender: registers them, adds them to a result and fills them.

Nothing here names a pass but where Blender wants something of its own, so that a pass that is added to the table is there.
"""
from __future__ import annotations

from operator import attrgetter

import numpy as np

from .. import fastgs_blender as fg
from ..fastgs_blender.rendering.passes import PASSES, Pass
from ..scene import colour
from . import scene_linear

COMBINED = "Combined"
"""Blender's pass that rgb and alpha fill together, over the world.  Every result has it."""

CHOICES = {"Depth": lambda scene: "median_depth" if scene.fastgs.depth == 'MEDIAN' else "depth"}
"""(scene) -> name of the pass in the table, for Blender's passes that several of the table could fill."""


def switched_on(scene, layer) -> list[Pass]:
    """The passes that a view layer wants, one for each of Blender's, in the table's order."""
    names = {p.blender: p.name for p in reversed(PASSES.values()) if p.blender}
    names |= {blender: choose(scene) for blender, choose in CHOICES.items()}
    return [p for p in PASSES.values() if names.get(p.blender) == p.name and attrgetter(p.switch)(layer)]


def register(engine, scene, layer):
    """Tell the compositor which sockets a view layer has."""
    for p in switched_on(scene, layer):
        engine.register_pass(scene, layer, p.blender, len(p.letters), p.letters, p.kind)


def add(engine, layer, wanted: list[Pass]):
    """Announce a layer's passes that Blender does not add by itself; to be called before begin_result."""
    for p in wanted:
        if not p.builtin:
            engine.add_pass(p.blender, len(p.letters), p.letters, layer=layer.name)


def images(instances, camera: fg.Camera, wanted: list[Pass], background=None,
           progress=lambda fraction: None) -> dict[str, np.ndarray]:
    """All pictures of one view by the names of Blender's passes, [h, w] or [h, w, channels], the top row first.

    instances   list of rendering.instances.Instance
    background  scene-linear colour [3] under the splats, or None for transparent film
    progress    called with 0..1; what it raises cancels the render
    """
    found = scene_linear.render(instances, camera, colour.rec709_to_working(), [p.name for p in wanted], progress)
    named = {p.blender: p.shown(found[p.name]) for p in wanted}
    return named | {COMBINED: colour.film(found["rgb"], found["alpha"], background)}


def fill(result_layer, pictures: dict[str, np.ndarray]):
    """Write the pictures, by their passes' names, into a RenderLayer; Blender's first row is the lowest."""
    for target in result_layer.passes:
        if target.name in pictures:
            target.rect.foreach_set(np.ascontiguousarray(pictures[target.name][::-1], np.float32).ravel())

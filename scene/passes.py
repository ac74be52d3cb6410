# SPDX-License-Identifier: GPL-3.0-or-later
"""The render passes: one list that registers them, adds them to a result and fills them."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

FAR = 1e10
"""Depth where there is nothing, as Cycles and EEVEE write it."""

ALPHA = "Splat Alpha"
"""Not "Alpha": that is what the compositor calls Combined's fourth channel, and a pass of this name takes its socket away."""


@dataclass(frozen=True, eq=False)
class Pictures:
    """A rendered view, the top row first: combined [h, w, 4] scene-linear premultiplied; alpha, depth [h, w]."""

    combined: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray | None = None


@dataclass(frozen=True)
class Pass:
    """name, channels' letters and type as Blender wants them

    wanted   (view layer) -> whether it is switched on
    builtin  whether Blender itself adds it to a result when it is
    image    (Pictures) -> [h, w] or [h, w, channels]
    """

    name: str
    letters: str
    kind: str
    wanted: Callable
    builtin: bool
    image: Callable


PASSES = (
    Pass("Combined", "RGBA", 'COLOR', lambda layer: layer.use_pass_combined, True, lambda p: p.combined),
    Pass("Depth", "Z", 'VALUE', lambda layer: layer.use_pass_z, True, lambda p: np.where(np.isfinite(p.depth), p.depth, FAR)),
    Pass(ALPHA, "A", 'VALUE', lambda layer: layer.fastgs.use_pass_alpha, False, lambda p: p.alpha),
)


def register(engine, scene, layer):
    """Tell the compositor which sockets a view layer has."""
    for p in PASSES:
        if p.wanted(layer):
            engine.register_pass(scene, layer, p.name, len(p.letters), p.letters, p.kind)


def add(engine, layer):
    """Announce a layer's passes; to be called before begin_result."""
    for p in PASSES:
        if p.wanted(layer) and not p.builtin:
            engine.add_pass(p.name, len(p.letters), p.letters, layer=layer.name)


def switched(group, context):
    """Update of a property on ViewLayer.fastgs: the compositor's sockets follow.

    It stands here because Blender 4.2 never lets go of such a function: one whose module holds bpy keeps the bpy wheel from
    closing down, which then crashes at exit.
    """
    # the group cannot tell which of its scene's layers it belongs to, and context.view_layer may be another one
    for layer in group.id_data.view_layers:
        layer.update_render_passes()


def wants_depth(layer) -> bool:
    """Whether the depth has to be computed."""
    return layer.use_pass_z


def fill(result_layer, pictures: Pictures):
    """Write the pictures into the passes of a RenderLayer; Blender's first row is the lowest."""
    by_name = {p.name: p for p in PASSES}
    for target in result_layer.passes:
        if target.name in by_name:
            image = by_name[target.name].image(pictures)
            target.rect.foreach_set(np.ascontiguousarray(image[::-1], np.float32).ravel())

# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the splats that are seen at a place of a 3D view: the library renders this one pixel, of each object alone."""
from dataclasses import replace

import numpy as np

from ... import fastgs_blender as fg
from ...scene.snapshot import Snapshot
from . import spaces
from .eye import eye

SEEN = 0.25
"""Opacity from which on a pixel shows the splats rather than what is behind them."""


def seen_at(context, x: int, y: int) -> tuple[str, float, fg.Camera] | None:
    """(name of the object, depth along the view axis, the region's camera) at a place of a region, from its lower left corner.

    None where no splats are seen, or this view does not draw any.
    """
    space, region, view = context.space_data, context.region, context.region_data
    ours = space.shading.type == 'RENDERED' and context.scene.render.engine == 'FASTGS'
    if not (ours or spaces.shows_over(space, context.scene)):
        return None
    camera, _ = eye(region.width, region.height, view.view_matrix, view.window_matrix)
    found = splats_at(spaces.viewports.snapshot_of(space, context.evaluated_depsgraph_get(), ours), camera, x, y)
    return None if found is None else (*found, camera)


def splats_at(shown: Snapshot, camera: fg.Camera, x: int, y: int) -> tuple[str, float] | None:
    """(name, depth) of the nearest object whose splats cover a pixel, counted from the lower left corner; None where none do.

    A backdrop is not clicked: it is everywhere behind all else.
    """
    if not (0 <= x < camera.width and 0 <= y < camera.height):
        return None
    pixel, found = replace(camera, window=(x, camera.height - 1 - y, 1, 1)), []
    for item, instance in shown.pairs(read=False)[0]:
        instance = replace(instance, settings=replace(instance.settings, backdrop="HIDDEN"))
        image = fg.render([instance], pixel, passes=["alpha", "median_depth"])
        if image["alpha"][0, 0] >= SEEN and np.isfinite(image["median_depth"][0, 0]):
            found.append((float(image["median_depth"][0, 0]), item.place[1] if len(item.place) > 1 else item.name))
    return min(found)[::-1] if found else None

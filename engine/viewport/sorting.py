# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds which Gaussians a view shows and sorts them by depth; the viewport's thread does it."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ... import fastgs_blender as fg
from ...fastgs_blender.model.sequence import Source
from ...fastgs_blender.rendering import visibility
from ...fastgs_blender.rendering.importance import kept_rank
from ...fastgs_blender.rendering.instances import Instance, ViewedInstance
from ...scene import objects
from ...scene.snapshot import Snapshot
from .. import compiling
from .atlas import Atlas

MOST = 1 << 24
"""Gaussians that a float can count."""


@dataclass(frozen=True, eq=False)
class Sorted:
    """A sorted snapshot.

    instances  that were sorted
    shown      [the name and the file of each one's object]
    models     models and sequences of their files, by path
    left_out   (object's name, why it is not shown), see Snapshot.load
    order      [V] float32: which Gaussians to draw, the nearest first, counted through all instances; or [V, 2], with the share of
               its opacity that crops take from each
    share      of the Gaussians that was to be drawn
    """

    instances: list[Instance]
    shown: list[tuple[str, str]]
    models: dict[str, Source]
    left_out: list[tuple[str, str]]
    order: np.ndarray
    share: float = 1.0


def sort(snapshot: Snapshot, camera: fg.Camera, share: float, atlas: Atlas) -> Sorted:
    """Sort the splats of a snapshot for a camera; reads files that are not in memory yet, and packs their models for the atlas.

    share  of the Gaussians to draw, the most important ones
    """
    models = {}

    def load(path):
        models[path] = objects.load_model(path)
        return models[path]

    pairs, left_out = snapshot.pairs(load)
    instances = [instance for _, instance in pairs]
    atlas.pack({id(instance.model): instance.model for instance in instances}.values())
    total = sum(len(instance.model) for instance in instances)
    viewed = [instance.viewed(camera) for instance in instances]
    order = visibility.order(viewed, camera, min(share, MOST / max(total, 1)), kept_rank,
                             "reference" if compiling.is_first_due() else "auto")
    if total >= MOST:  # several instances of few Gaussians each; ranks alone cannot tell how many are left
        order = order[order < MOST]
    return Sorted(instances, [item.key for item, _ in pairs], models, left_out, listed(viewed, order), share)


def listed(instances: list[ViewedInstance], order: np.ndarray) -> np.ndarray:
    """The order as `Sorted.order` holds it: float32 [V], or [V, 2] with the share that soft crops remove."""
    share, order = visibility.crop_shares(instances, order), order.astype(np.float32)
    return order if share is None else np.stack([order, 1 - share], 1)

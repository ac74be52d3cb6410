# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds which Gaussians a view shows and sorts them by depth; the viewport's thread does it."""
from dataclasses import dataclass

import numpy as np

from ... import fastgs_blender as fg
from ...fastgs_blender.kernels.gl.frame_table import ORDER_WIDTH
from ...fastgs_blender.model.sequence import Source
from ...fastgs_blender.rendering import visibility
from ...fastgs_blender.rendering.instances import Instance, ViewedInstance
from ...scene import objects
from ...scene.snapshot import Snapshot
from .. import compiling
from .atlas import Atlas

MOST = 1 << 24
"""Gaussians that a float can count; of larger scenes the rest is not drawn."""


@dataclass(frozen=True, eq=False)
class Sorted:
    """A sorted snapshot.

    instances  that were sorted
    shown      [the name and the file of each one's object]
    models     models and sequences of their files, by path
    left_out   (object's name, why it is not shown), see Snapshot.load
    order      whole rows of a texture [R, ORDER_WIDTH, 1] float32: which Gaussians to draw, the nearest first, counted through all
               instances; or [R, ORDER_WIDTH, 2], with the share of its opacity that crops take from each
    count      how many these are
    share      of the Gaussians that was to be drawn
    """

    instances: list[Instance]
    shown: list[tuple[str, str]]
    models: dict[str, Source]
    left_out: list[tuple[str, str]]
    order: np.ndarray
    count: int
    share: float = 1.0


def sort(snapshot: Snapshot, camera: fg.Camera, share: float, atlas: Atlas, standing: dict | None = None) -> Sorted:
    """Sort the splats of a snapshot for a camera; reads files that are not in memory yet, and packs their models for the atlas.

    share, standing  of the Gaussians that it shows, how many to draw, and what is kept between such orders; see visibility.order()
    """
    models = {}

    def load(path):
        models[path] = objects.load_model(path)
        return models[path]

    pairs, left_out = snapshot.pairs(load)
    instances = [instance for _, instance in pairs]
    atlas.pack({id(instance.model): instance.model for instance in instances}.values())
    viewed = [instance.viewed(camera) for instance in instances]
    order = visibility.order(viewed, camera, share, "reference" if compiling.is_first_due() else "auto", standing)
    if sum(len(instance.model) for instance in instances) > MOST:
        order = order[order < MOST]
        left_out = [*left_out, (instances[-1].name, f"viewports draw {MOST:,} Gaussians at most; hide other objects to see all of it.")]
    return Sorted(instances, [item.key for item, _ in pairs], models, left_out, listed(viewed, order), len(order), share)


def listed(instances: list[ViewedInstance], order: np.ndarray) -> np.ndarray:
    """The order as `Sorted.order` holds it, so that nothing but the upload is left for the main thread."""
    share = visibility.crop_shares(instances, order)
    rows = np.zeros((max(-(-len(order) // ORDER_WIDTH), 1), ORDER_WIDTH, 1 if share is None else 2), np.float32)
    entries = rows.reshape(-1, rows.shape[2])
    entries[:len(order), 0] = order
    if share is not None:
        entries[:len(order), 1] = 1 - share
    return rows

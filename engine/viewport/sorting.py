# SPDX-License-Identifier: GPL-3.0-or-later
"""What the viewport's thread computes: which splats a view shows, and in which order."""
from __future__ import annotations

import threading
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from ... import fastgs_blender as fg
from ...fastgs_blender.rendering import visibility
from ...fastgs_blender.rendering.instances import Instance
from ...scene import objects
from ...scene.snapshot import Contents
from .. import compiling
from .atlas import Atlas

MOST = 1 << 24
"""Gaussians that a float can count."""

_ranks: WeakKeyDictionary = WeakKeyDictionary()
_lock = threading.Lock()


@dataclass(frozen=True, eq=False)
class Sorted:
    """An answer: the parts as they were, their files' models, and the order [V] float32 in which to draw them."""

    parts: list[Instance]
    models: dict[str, fg.GaussianModel]
    failed: dict[str, str]
    order: np.ndarray


def sort(contents: Contents, camera: fg.Camera, limit: float, atlas: Atlas) -> Sorted:
    """The order of a scene's splats for a camera; reads files that are not in memory yet, and packs them for the atlas."""
    models = {}

    def load(path):
        models[path] = objects.load_model(path)
        return models[path]

    parts, failed = contents.parts(load)
    atlas.pack({id(part.model): part.model for part in parts}.values())
    clouds = [part.viewed(camera) for part in parts]
    total = sum(len(part.model) for part in parts)
    order = visibility.order(clouds, camera, min(limit, MOST / max(total, 1)), rank,
                             numba=not compiling.is_running())
    if total >= MOST:  # several instances of few Gaussians each; ranks alone cannot tell how many are left
        order = order[order < MOST]
    return Sorted(parts, models, failed, order.astype(np.float32))


def rank(model: fg.GaussianModel) -> np.ndarray:
    """visibility.importance_rank, kept while the model lives."""
    with _lock:
        found = _ranks.get(model)
    if found is None:
        found = visibility.importance_rank(model)
        with _lock:
            _ranks[model] = found
    return found

# SPDX-License-Identifier: GPL-3.0-or-later
"""What a backend is given and what it gives back: parts of a cloud, channels, buffers."""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..cameras.camera import Camera
from ..model.appearance import Features
from ..model.gaussians import GaussianModel
from .crops import Crop


class Placed(NamedTuple):
    """A model to render: its placement [4, 4] in the world, the time t to show, and the boxes that crop it."""

    model: GaussianModel
    placement: np.ndarray
    t: float
    crops: tuple[Crop, ...] = ()


@dataclass(frozen=True, eq=False)
class Part:
    """One model in the picture: where it stands and the time it shows.

    Everything that depends on where one looks from (spherical harmonics, the decoder's rays) happens in the model's own
    space, so that appearance turns with the object.
    """

    model: GaussianModel
    placement: np.ndarray
    t: float
    world_to_camera: np.ndarray
    crops: tuple[Crop, ...] = ()

    @cached_property
    def model_to_camera(self) -> np.ndarray:
        """[4, 4] float64."""
        return self.world_to_camera @ self.placement

    @cached_property
    def camera_to_model(self) -> np.ndarray:
        """[4, 4] float64; the pseudo-inverse where an object is scaled flat."""
        return np.linalg.pinv(self.model_to_camera)

    def near(self, camera: Camera) -> float:
        """The nearer of two limits loses: the camera's, and the model's own, which grows with the object."""
        scale = np.cbrt(abs(np.linalg.det(self.placement[:3, :3])))
        return max(camera.near, self.model.raster.near * scale)


@dataclass(frozen=True)
class Group:
    """A run of blended channels with one meaning: the rgb of all plain parts, or the features of one part's decoder.

    offset  first channel
    weight  channel that holds this group's own share of alpha; None: alpha itself
    part    the part whose decoder turns the features into colour; None: the channels are rgb
    """

    offset: int
    weight: int | None = None
    part: Part | None = None


class Layout:
    """Which channel holds what when all parts are blended as one cloud.

    Three channels for all parts with plain colour, nine for each part with a decoder (its rays differ from part to part),
    plus its share of alpha where it is not alone; the depth, if wanted, comes last.
    """

    def __init__(self, parts: list[Part], depth: bool):
        decoded = [p for p in parts if isinstance(p.model.appearance, Features)]
        plain = len(decoded) < len(parts) or not parts
        alone = len(decoded) == 1 and not plain
        self.groups = [Group(0)] if plain else []
        offset = 3 * plain
        for part in decoded:
            self.groups.append(Group(offset, None if alone else offset + 9, part))
            offset += 9 if alone else 10
        self.depth = offset if depth else None
        self.channels = offset + int(depth)

    def group_of(self, part: Part) -> Group:
        """The group that a part's Gaussians write to."""
        return next((g for g in self.groups if g.part is part), self.groups[0])


@dataclass(frozen=True, eq=False)
class Buffers:
    """What a backend blends: channels [h, w, C] (premultiplied), alpha [h, w], median depth [h, w] or None."""

    channels: np.ndarray
    alpha: np.ndarray
    median: np.ndarray | None

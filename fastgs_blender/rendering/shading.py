# SPDX-License-Identifier: GPL-3.0-or-later
"""What the scene's light does to each Gaussian, for passes: from it a compositor can light splats as the renderer does."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .colour import linear_to_srgb, srgb_to_linear
from .instances import ViewedInstance
from .looks import graded
from .normals import smooth_normals
from .painting import seen_colours, shares_of
from .quantities import Quantity, Shown
from .unlit import captured_light


@dataclass(frozen=True, eq=False)
class Shading:
    """Of the N Gaussians of an instance.

    lights   [L, N, 3]  the light of each lamp on white paint, scene linear, with nothing in its way
    meshes   [L, N]     the share of it that meshes let through
    both     [L, N]     the share that meshes and splats let through
    contact  [N]        the share of light from all around that meshes nearby leave (contact.py)
    """

    lights: np.ndarray
    meshes: np.ndarray
    both: np.ndarray
    contact: np.ndarray


def shading_of(arriving: np.ndarray, contact: np.ndarray) -> Shading:
    """The Shading of an instance.

    arriving  [L, 4, 3, N] the irradiance of each lamp, by channel: with nothing in the way, with meshes, with both, with splats
    """
    lights = (arriving[:, 0] / np.pi).transpose(0, 2, 1)
    return Shading(lights, shares_of(arriving[:, 0], arriving[:, 1]), shares_of(arriving[:, 0], arriving[:, 2]), contact)


def shaded(width: int, of: Callable[[Shading], np.ndarray], without: float) -> Quantity:
    """A quantity [N, width] of the Shading that instances have; of those without any it is the same everywhere."""
    def values(shown: Shown) -> np.ndarray:
        shading = shown.instance.shading
        return np.full((len(shown.index), width), without) if shading is None else of(shading)[shown.index].reshape(-1, width)

    return Quantity(width, values)


def lamp_light(level: int) -> Quantity:
    """The light of a lamp."""
    return shaded(3, lambda shading: shading.lights[level] if level < len(shading.lights) else np.zeros((len(shading.contact), 3)), 0.0)


def lamp_share(level: int, of: str) -> Quantity:
    """The share of a lamp's light that meshes let through (of: "meshes"), or meshes and splats ("both")."""
    def values(shading: Shading) -> np.ndarray:
        return getattr(shading, of)[level] if level < len(shading.lights) else np.ones(len(shading.contact))

    return shaded(1, values, 1.0)


def contact_occlusion() -> Quantity:
    """The share of light from all around that meshes nearby leave."""
    return shaded(1, lambda shading: shading.contact, 1.0)


def unlit(instances: list[ViewedInstance], backend: Any) -> Quantity:
    """The estimated unlit colours, in the models' own colour spaces, with the looks of their objects."""
    factors = {}
    for instance in instances:
        seen = Shown.all_of(instance, backend)
        normal = smooth_normals(seen, backend) @ instance.placement[:3, :3]
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        factors[instance] = np.ones((len(instance.model), 3))
        factors[instance][seen.index] = captured_light(instance.source, backend).unlit(normal)

    def values(shown: Shown) -> np.ndarray:
        instance, factor = shown.instance, factors[shown.instance][shown.index]
        colour = graded(np.maximum(seen_colours(instance, shown.index)[1], 0), instance.look)
        return colour * factor if instance.model.colour_space == "linear" else linear_to_srgb(srgb_to_linear(colour) * factor)

    return Quantity(3, values)

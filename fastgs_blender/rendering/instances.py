# SPDX-License-Identifier: GPL-3.0-or-later
"""The instance of a model in a picture: which model, where it stands, which time it shows, and how its object shows it."""
from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from ..cameras.camera import Camera
from ..model.gaussians import GaussianModel
from ..model.surroundings import WITHIN
from ..util.arguments import numbers, real
from ..util.errors import FastGSError
from .crops import Crop
from .distance import MARGIN, camera_ball
from .filters import Filter, hidden
from .looks import look_numbers

LIMIT = 1e30
"""Largest coordinate, depth or colour that is drawn: float32 sums of such numbers stay finite.  What lies beyond is left out."""

RANGES = {
    "exposure": (-32, 32), "gamma": (0.01, 100), "contrast": (0, 100), "saturation": (0, 100), "hue": (-1e3, 1e3), "tint": (0, 1e4),
    "opacity": (0, 100), "opacity_cut": (0, 1), "splat_scale": (0, 1e4), "min_size": (0, 1e9), "max_size": (0, 1e9),
}
"""What numbers the looks of ObjectSettings take; the properties in Blender have the same limits."""
BACKDROPS = ("INSIDE", "SHOWN", "HIDDEN")
One = TypeVar("One", bound="Instance")


@dataclass(frozen=True)
class ObjectSettings:
    """How an object shows its model.  It goes whole from the object to the kernels and to the viewport; equal settings look equal.

    crops     shapes that cut the model, see crops.py
    filters   which Gaussians are hidden for what they are, see filters.py
    mask      which Gaussians are hidden by hand, as masks.pack_mask() writes it; "": none
    exposure, gamma, contrast, saturation, hue, tint
              of the colours, scene linear: stops; powers; a factor on what is not grey; radians; factors on red, green and blue
    opacity, opacity_cut
              a factor on the opacity; Gaussians of less opacity than the cut, before that factor, are left out
    splat_scale, min_size, max_size
              a factor on each Gaussian's size, and limits of its largest standard deviation, in the model's units; max_size 0: none
    density   share of the Gaussians that are shown, the most important ones
    backdrop  whether the model's backdrop is drawn: 'INSIDE' (only by cameras that stand inside it), 'SHOWN' (always), 'HIDDEN'
    antialias whether splats become fainter where they are seen from farther than the capture's cameras saw them (distance.py)
    bends     whether what reaches the camera's plane beside the picture is projected so that it does not explode (oracle.nearness)
    """

    crops: tuple[Crop, ...] = ()
    backdrop: str = "INSIDE"
    exposure: float = 0.0
    gamma: float = 1.0
    contrast: float = 1.0
    saturation: float = 1.0
    hue: float = 0.0
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    opacity: float = 1.0
    opacity_cut: float = 0.0
    splat_scale: float = 1.0
    min_size: float = 0.0
    max_size: float = 0.0
    filters: tuple[Filter, ...] = ()
    mask: str = ""
    density: float = 1.0
    antialias: bool = True
    bends: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "crops", tuple(self.crops))
        object.__setattr__(self, "filters", tuple(self.filters))
        object.__setattr__(self, "tint", tuple(float(value) for value in self.tint))
        for name, (low, high) in RANGES.items():
            for value in self.tint if name == "tint" else (getattr(self, name),):
                if not low <= value <= high:
                    raise FastGSError(f"the setting {name} of an object must lie between {low:g} and {high:g}, not {value!r}.")
        if len(self.tint) != 3:
            raise FastGSError("the setting tint of an object must be three numbers, of red, green and blue.")
        if not 0 <= self.density <= 1:
            raise FastGSError(f"the density of an object must lie between 0 and 1, not {self.density!r}.")
        if self.backdrop not in BACKDROPS:
            raise FastGSError(f"how a backdrop is shown must be one of {', '.join(BACKDROPS)}, not {self.backdrop!r}.")

    def under(self, above: ObjectSettings) -> ObjectSettings:
        """These settings with the looks of an object that instances this one on top; what is no look stays."""
        looks = {name: getattr(self, name) * getattr(above, name) for name in ("gamma", "contrast", "saturation", "opacity", "splat_scale")}
        looks |= {name: getattr(self, name) + getattr(above, name) for name in ("exposure", "hue")}
        looks |= {name: max(getattr(self, name), getattr(above, name)) for name in ("opacity_cut", "min_size")}
        looks["max_size"] = min((size for size in (self.max_size, above.max_size) if size), default=0.0)
        looks = {name: min(max(value, RANGES[name][0]), RANGES[name][1]) for name, value in looks.items()}
        r, g, b = (min(a * b, RANGES["tint"][1]) for a, b in zip(self.tint, above.tint, strict=True))
        return replace(self, **looks, tint=(r, g, b), density=self.density * above.density,
                       antialias=self.antialias and above.antialias)


AS_TRAINED = ObjectSettings(antialias=False, bends=False)
"""The settings with which a model is trained: the same picture from any distance."""


@dataclass(frozen=True, eq=False)
class Instance:
    """A model in a picture.

    model      GaussianModel
    placement  [4, 4] from the model's space to the world; kept as float64
    t          the time to show, any real number
    settings   ObjectSettings
    name       of the object that shows the model, and
    index      its number: what Cryptomatte and the Object Index pass tell objects apart by
    place      what finds the instance again at another moment (Moment)
    origin     the model whose Gaussians `model` holds, edited, painted or in part; None: `model` itself.  Filters and masks are its
    rows       which of the origin's Gaussians, [len(model)]; None: all, in their order

    Raises FastGSError where the placement or the time is not finite.
    """

    model: GaussianModel
    placement: np.ndarray
    t: float
    settings: ObjectSettings = ObjectSettings()
    name: str = ""
    index: int = 0
    place: Hashable = None
    origin: GaussianModel | None = None
    rows: np.ndarray | None = None

    def __post_init__(self) -> None:
        placement = numbers(self.placement, "a model's placement", "(4, 4)").copy()
        if placement.shape != (4, 4) or not np.isfinite(placement).all():
            raise FastGSError("a model's placement must be a 4 x 4 matrix of finite numbers.")
        object.__setattr__(self, "placement", placement)
        object.__setattr__(self, "t", real(self.t, "the time of a model"))

    def viewed(self, camera: Camera) -> ViewedInstance:
        """The instance before a camera."""
        return ViewedInstance(**{f.name: getattr(self, f.name) for f in fields(Instance)}, camera=camera)

    @property
    def source(self) -> GaussianModel:
        """The model that its Gaussians come from: two instances with one source have the same Gaussians in the same rows."""
        return self.origin or self.model

    def part(self: One, index: np.ndarray, model: GaussianModel | None = None) -> One:
        """The instance with some of its Gaussians [M] alone; model: of these, where there is one already."""
        return replace(self, model=model or self.model.take(index), origin=self.source,
                       rows=index if self.rows is None else self.rows[index])

    @cached_property
    def hidden(self) -> np.ndarray:
        """Which Gaussians its filters, its mask and its density hide: [N] bool, or [0] where there are none."""
        found = hidden(self.source, self.settings.filters, self.settings.mask, self.settings.density)
        return found[self.rows] if len(found) and self.rows is not None else found

    @property
    def identity(self) -> tuple[str, int]:
        """(name, index) of its object."""
        return self.name, self.index


@dataclass(frozen=True, eq=False)
class ViewedInstance(Instance):
    """An instance before a camera.

    Everything that depends on where one looks from (spherical harmonics, the decoder's rays) is computed in the model's own
    space, so that appearance turns with the object.
    """

    camera: Camera = field(kw_only=True)

    @cached_property
    def model_to_camera(self) -> np.ndarray:
        """[4, 4] float64."""
        with np.errstate(over="ignore", invalid="ignore"):
            return self.camera.world_to_camera @ self.placement

    @cached_property
    def camera_to_model(self) -> np.ndarray:
        """[4, 4] float64; the pseudo-inverse where an object is scaled flat."""
        return np.linalg.pinv(self.model_to_camera)

    @cached_property
    def near(self) -> float:
        """Depth from which on Gaussians are drawn: the larger of the camera's limit and the model's own, which grows with the object."""
        return max(self.camera.near, self.model.raster.near * self.scale)

    @property
    def scale(self) -> float:
        """Factor by which the placement makes the model larger."""
        return float(np.cbrt(abs(np.linalg.det(self.placement[:3, :3]))))

    @cached_property
    def beyond(self) -> tuple[float, float, float, float, float]:
        """The ball that holds the capture's cameras (centre, radius) in the model's space, and the growth of pixels: at a position p and a
        depth z a pixel is growth z / (|p - centre| + radius) times as large as any of the capture's was; orthographic: without z.

        A growth of 0: nothing changes with the distance.
        """
        cameras, size = self.model.surroundings.cameras, self.scale
        if not self.settings.antialias or self.model.raster.antialiased or not cameras or not size > 0:
            return 0.0, 0.0, 0.0, 0.0, 0.0
        x, y, z, radius, focal = camera_ball(cameras)
        return x, y, z, radius, focal / (float(np.sqrt(self.camera.fx * self.camera.fy)) * size * MARGIN)

    @cached_property
    def ball(self) -> tuple[float, float, float, float]:
        """The ball (centre, squared radius) in the model's space in which a Gaussian must rest to be drawn: all but the backdrop, where
        the settings leave it out, else infinite.
        """
        backdrop, shown = self.model.surroundings.backdrop, self.settings.backdrop
        if backdrop is None or shown == "SHOWN" or (shown == "INSIDE" and backdrop.distance(self.camera_to_model[:3, 3]) < WITHIN):
            return 0.0, 0.0, 0.0, np.inf
        return *backdrop.centre, backdrop.radius**2

    def in_ball(self, position: np.ndarray) -> np.ndarray:
        """Which constant positions [N, 3] lie in the ball: [N] bool."""
        if np.isinf(self.ball[3]):
            return np.ones(len(position), bool)
        return ~(((position.astype(np.float64) - self.ball[:3]) ** 2).sum(1) > self.ball[3])

    @property
    def far(self) -> float:
        """Depth up to which Gaussians are drawn."""
        return min(self.camera.far, LIMIT)

    @cached_property
    def look(self) -> np.ndarray:
        """The looks of its settings as the numbers that renderers take, see looks.look_numbers()."""
        return look_numbers(self.settings, self.model.colour_space)

    @property
    def in_range(self) -> bool:
        """Whether its matrix is small enough to compute with (LIMIT); instances that are not in range are left out."""
        return bool((np.abs(self.model_to_camera) <= LIMIT).all())


@dataclass(frozen=True, eq=False)
class Moment:
    """A scene at another moment than a picture's: where its instances, by their places, and its camera are then.

    An instance that is not there then is taken to stand still.  holdout: the triangles that hide splats then (holdout.py), or None.
    """

    instances: dict[Hashable, Instance]
    camera: Camera
    holdout: np.ndarray | None = None

# SPDX-License-Identifier: GPL-3.0-or-later
"""The instance of a model in a picture: which model, where it stands, which time it shows, and how its object shows it."""
from __future__ import annotations

import math
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from operator import add, mul
from typing import Any, NamedTuple, TypeVar

import numpy as np

from ..cameras.camera import Camera
from ..model.gaussians import GaussianModel
from ..model.slicing import slice_model, still
from ..model.surroundings import WITHIN
from ..util.arguments import numbers, real
from ..util.errors import FastGSError
from .crops import Crop
from .distance import OFF, Sampling, camera_ball, camera_rows
from .filters import Filter, hidden
from .looks import look_numbers

LIMIT = 1e30
"""Largest coordinate, depth or colour that is drawn: float32 sums of such numbers stay finite.  What lies beyond is left out."""

BACKDROPS = ("INSIDE", "SHOWN", "HIDDEN")
One = TypeVar("One", bound="Instance")


class Control(NamedTuple):
    """How a look is set: options of the property in Blender (soft limits, subtype, unit), its name and meaning for an artist, the limits of
    its numbers, the group in which panels draw it, and what a look of an object and that of one that instances it make together.
    """

    options: dict[str, Any]
    label: str
    tooltip: str
    low: float
    high: float
    group: str
    joined: Callable[[Any, Any], Any]


def _look(default: Any, *control: Any, **options: Any) -> Any:
    """A member of ObjectSettings that is a look, by its default and its Control."""
    return field(default=default, metadata={"look": Control(options, *control)})


@dataclass(frozen=True)
class ObjectSettings:
    """How an object shows its model.  It goes whole from the object to the kernels and to the viewport; equal settings look equal.

    crops     shapes that cut the model, see crops.py
    filters   which Gaussians are hidden for what they are, see filters.py
    mask      which Gaussians are hidden by hand, as masks.pack_mask() writes it; "": none
    exposure to max_size  the looks (LOOKS), in the units of looks.py
    density   share of the Gaussians that are shown, the most important ones
    backdrop  whether the model's backdrop is drawn: 'INSIDE' (only by cameras that stand inside it), 'SHOWN' (always), 'HIDDEN'
    antialias whether splats are drawn as the capture's cameras sampled them: finer from afar, softer from nearby (distance.py)
    bends     whether what reaches the camera's plane beside the picture is projected so that it does not explode (oracle.nearness)
    casts     whether its splats throw shadows
    unlit_by, clear_to  the names of lamps that do not light it, and of those whose light it lets through (Lamp.name)
    mark      1 or -1: viewports show the instance as a mark on those Gaussians of its object, blended together with it; else 0

    Example:
        look = fg.ObjectSettings(exposure=0.5, saturation=0.8, opacity=0.6)
        picture = fg.render([fg.Instance(model, np.eye(4), 0.2, look)], camera)
    """

    crops: tuple[Crop, ...] = ()
    backdrop: str = "INSIDE"
    exposure: float = _look(0.0, "Exposure", "Brightness, in stops", -32, 32, "TONE", add, soft_min=-10.0, soft_max=10.0)
    gamma: float = _look(1.0, "Gamma", "Brightness of the middle tones; black and white stay", 0.01, 100, "TONE", mul, soft_min=0.2,
                         soft_max=5.0)
    contrast: float = _look(1.0, "Contrast", "Spread of the tones around middle grey", 0, 100, "TONE", mul, soft_max=3.0)
    saturation: float = _look(1.0, "Saturation", "Strength of the colours; 0 is black and white", 0, 100, "COLOUR", mul, soft_max=3.0)
    hue: float = _look(0.0, "Hue", "Turns the colours around the wheel", -1e3, 1e3, "COLOUR", add, soft_min=-math.pi, soft_max=math.pi,
                       subtype="ANGLE")
    tint: tuple[float, float, float] = _look((1.0, 1.0, 1.0), "Tint", "Colour by which those of the Gaussians are multiplied", 0, 1e4,
                                             "COLOUR", mul, soft_max=1.0, subtype="COLOR")
    opacity: float = _look(1.0, "Opacity", "Factor on the opacity of every Gaussian", 0, 100, "OPACITY", mul, soft_max=1.0)
    opacity_cut: float = _look(0.0, "Opacity Cut", "Gaussians of less opacity are not shown, by what the file says without fading in and "
                               "out", 0, 1, "OPACITY", np.maximum)
    splat_scale: float = _look(1.0, "Splat Scale", "Factor on the size of every Gaussian", 0, 1e4, "SIZE", mul, soft_max=3.0)
    min_size: float = _look(0.0, "Minimum Size", "Gaussians are made at least this large, by their longest axis; their shape stays", 0,
                            1e9, "SIZE", np.maximum, soft_max=1.0, unit="LENGTH", precision=4)
    max_size: float = _look(0.0, "Maximum Size", "Gaussians are made at most this large, by their longest axis; 0 is no limit", 0, 1e9,
                            "SIZE", lambda a, b: min(a or b, b or a), soft_max=1.0, unit="LENGTH", precision=4)
    captured_light: float = _look(1.0, "Captured Light", "How much of the light that the capture was filmed in stays", 0, 1e4, "LIGHT", mul,
                                  soft_max=1.0)
    lamp_light: float = _look(0.0, "Lamps", "How much the scene's lamps and world light the splats", 0, 1e4, "LIGHT", np.maximum,
                              soft_max=1.0)
    shadows: float = _look(0.0, "Shadows", "How dark the lamps' shadows are on the splats: those of meshes, and of splats in the light of "
                           "lamps", 0, 1, "LIGHT", np.maximum, subtype="FACTOR")
    unlit: float = _look(0.0, "Unlit Colour", "How much lamps light an estimate of the unlit colour in place of the captured colour, which "
                         "has the light of the capture in it", 0, 1, "LIGHT", np.maximum, subtype="FACTOR")
    pixel_size: float = _look(0.0, "Trained Pixel Size", "Size of a pixel of the training pictures on the surface. Views with finer pixels "
                              "are smoothed to it. For files that do not know their cameras; 0 turns it off", 0, 1e9, "SAMPLING",
                              np.maximum, soft_max=0.1, unit="LENGTH", precision=5)
    filters: tuple[Filter, ...] = ()
    mask: str = ""
    density: float = 1.0
    antialias: bool = True
    bends: bool = True
    casts: bool = True
    unlit_by: frozenset[str] = frozenset()
    clear_to: frozenset[str] = frozenset()
    mark: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "crops", tuple(self.crops))
        object.__setattr__(self, "filters", tuple(self.filters))
        object.__setattr__(self, "tint", tuple(float(value) for value in self.tint))
        for name, look in LOOKS.items():
            value = getattr(self, name)
            with np.errstate(over="ignore"):  # in single precision, in which Blender and kernels hold them
                values, low, high = (np.asarray(x, np.float32) for x in (value, look.low, look.high))
            if not ((values >= low) & (values <= high)).all():
                raise FastGSError(f"the setting {name} of an object must lie between {look.low:g} and {look.high:g}, not {value!r}.")
        if len(self.tint) != 3:
            raise FastGSError("the setting tint of an object must be three numbers, of red, green and blue.")
        if not 0 <= self.density <= 1:
            raise FastGSError(f"the density of an object must lie between 0 and 1, not {self.density!r}.")
        if self.backdrop not in BACKDROPS:
            raise FastGSError(f"how a backdrop is shown must be one of {', '.join(BACKDROPS)}, not {self.backdrop!r}.")

    @property
    def takes_light(self) -> bool:
        """Whether the scene's lamps change how the object looks (relight.py)."""
        return (self.captured_light, self.lamp_light, self.shadows) != (1, 0, 0)

    def under(self, above: ObjectSettings) -> ObjectSettings:
        """These settings with the looks of an object that instances this one on top; what is no look stays."""
        looks = {name: np.clip(look.joined(np.array(getattr(self, name)), getattr(above, name)), look.low, look.high).tolist()
                 for name, look in LOOKS.items()}
        return replace(self, **looks, density=self.density * above.density, antialias=self.antialias and above.antialias,
                       casts=self.casts and above.casts, mark=self.mark or above.mark)


LOOKS: dict[str, Control] = {f.name: f.metadata["look"] for f in fields(ObjectSettings) if f.metadata}
"""By name, in the order of panels.  Properties and panels in Blender are made from it."""
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
    surface    triangles [F, 3, 3] of the object's surface in the world, whose normals its Gaussians take; None: they have their own
    shading    what the scene's light does to its Gaussians, for passes (shading.Shading), or None
    taken      what meshes take from the light of its Gaussians (shadow_edges.Taken), or None
    painted    whether the model's colours are not its origin's: they hold on all of an exposure

    Raises FastGSError where the placement or the time is not finite.

    Example:
        picture = fg.render([fg.Instance(model, np.eye(4), 0.2), fg.Instance(model, np.diag([2, 2, 2, 1]), 0.8)], camera)
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
    surface: np.ndarray | None = None
    shading: Any = None
    taken: Any = None
    painted: bool = False

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

    def frozen(self: One) -> One:
        """The instance with a model that holds its Gaussians as they are at its time, without those that have faded away."""
        now = slice_model(self.model, self.t)
        return replace(self.part(now.index, still(self.model, now)), t=0.0)

    @cached_property
    def hidden(self) -> np.ndarray:
        """Which Gaussians its filters, its mask and its density hide: [N] bool, or [0] where there are none."""
        found = hidden(self.source, self.settings.filters, self.settings.mask, self.settings.density)
        return found[self.rows] if len(found) and self.rows is not None else found

    @property
    def captured(self) -> Sampling:
        """How the capture's cameras sampled the model, before any view.  Models that were trained antialiased need no help from afar."""
        cameras, raster, least = self.model.surroundings.cameras, self.model.raster, self.settings.pixel_size
        if not self.settings.antialias:
            return OFF
        if not cameras:
            return OFF._replace(least=least)
        x, y, z, radius, focal = camera_ball(cameras)
        rows, reach = camera_rows(cameras, raster.blur, raster.alpha_cut)
        return Sampling((x, y, z, radius), 0.0, 1 / focal, least, reach, not raster.antialiased, 1.0, rows)

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

    @cached_property
    def scale(self) -> float:
        """Factor by which the placement makes the model larger."""
        return float(np.cbrt(abs(np.linalg.det(self.placement[:3, :3]))))

    @cached_property
    def sampling(self) -> Sampling:
        """How the capture's cameras and this one sample the model."""
        captured, size = self.captured, self.scale
        if not captured.known or not size > 0:
            return OFF
        focal = float(np.sqrt(abs(self.camera.fx * self.camera.fy)))
        zoom = 1.0 if self.camera.orthographic else captured.zoom_at(self.camera_to_model[:3, 3], focal)
        return captured._replace(pixel=1 / (focal * size), zoom=zoom)

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

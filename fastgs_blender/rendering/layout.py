# SPDX-License-Identifier: GPL-3.0-or-later
"""The layout of the blended channels where several instances are drawn as one list of splats, and the buffers that are made from them.

A picture holds two kinds of numbers for each pixel: sums over the splats of a value times the splat's weight (colour, and the
quantities of quantities.py), and probes, which look at the splats one by one while they are blended.

Some quantities are summed over a pixel's core: the splats that block the middle half of its light.  At the outline of something, and at a
sharp edge, a few splats of one surface stick out before another one.  A mean of all would mix the two; the core is of one of them nearly
everywhere, and still of many splats where there is one surface.
"""
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..model.appearance import Features
from .instances import ViewedInstance
from .looks import Look
from .quantities import Quantity

DEPTH_FROM = {"median": 0.5, "first": float(np.nextafter(np.float32(1), np.float32(0)))}
"""Probes that are a depth: that of the last splat before which the transmittance is above this; infinite where nothing is."""
PROBES = (*DEPTH_FROM, "count")
"""All probes; count: how many splats were blended into the pixel."""
CORE = (0.25, 0.75)
"""A splat's weight in the core is what it takes of the transmittance between these two,"""
REST = 2.0**-10
"""and this share of its usual weight: faint pixels have no core."""


def decoding(instance: ViewedInstance) -> Hashable:
    """How an instance's blended features become colour: by its decoder, its place (the rays) and its look of colour; None: they are colour.

    Instances with the same decoding are decoded together, as one model is: its separated parts, echoes, both ends of a fading loop.
    """
    appearance = instance.model.appearance
    if not isinstance(appearance, Features):
        return None
    return (appearance.activation, appearance.decode, appearance.w1.tobytes(), appearance.w2.tobytes(), instance.camera_to_model.tobytes(),
            instance.look[Look.GRADED:].tobytes())


@dataclass(frozen=True)
class ChannelGroup:
    """A run of blended channels with one meaning: the rgb of all instances without a decoder, or the features of those with one
    decoding.

    offset    first channel
    weight    channel that holds this group's own share of alpha; None: alpha itself
    instance  one of those, whose decoder turns the features into colour; None: the channels are rgb
    opaque    whether nothing is to lie behind the group or beside it
    """

    offset: int
    weight: int | None = None
    instance: ViewedInstance | None = None
    opaque: bool = False

    @property
    def decode(self) -> str:
        """How the decoder's colour is made: one of Features' ways, or "lifted" where premultiplied sums go over something else."""
        appearance = self.instance and self.instance.model.appearance
        assert isinstance(appearance, Features)
        way = appearance.decode
        return way if way == "normalised" or self.opaque else "lifted"


class Layout:
    """Which channel holds what when all instances are blended together.

    Three channels for all instances with plain colour, nine for those with one decoding, plus its share of alpha where
    it is not alone; then the depth, if wanted, and further quantities.

    opaque      whether nothing is put behind the picture (Features says what that changes); only a group that is alone can be

    groups      list of ChannelGroup
    core        from which channel to which they are summed over the core of each pixel; (0, 0): there are none.  These come right after
                the groups, so that few kernels are compiled
    depth       channel of the depth of the splats' centres, or None
    plane       the first of three channels a, b, c with which a splat's depth at a pixel is a + b x + c y, x and y counted from the
                middle of the image; or None
    by_pixel    whether the splats of a pixel are sorted by that depth, and not all by that of their centres; planes are
                blurred then, see oracle.plane()
    quantities  by name, what else is summed (quantities.py)
    places      by name, which channels hold the sum of a quantity: slices
    channels    number of channels
    """

    def __init__(self, instances: list[ViewedInstance], depth: bool, quantities: dict[str, Quantity] | None = None, plane: bool = False,
                 by_pixel: bool = False, opaque: bool = False) -> None:
        kinds: dict[Hashable, list[ViewedInstance]] = {}
        for instance in instances:
            kinds.setdefault(decoding(instance), []).append(instance)
        plain = kinds.pop(None, None) is not None or not instances
        alone = len(kinds) == 1 and not plain
        self.groups = [ChannelGroup(0)] if plain else []
        self._of: dict[int, ChannelGroup] = {}
        offset = 3 * plain
        for alike in kinds.values():
            self.groups.append(ChannelGroup(offset, None if alone else offset + 9, alike[0], opaque and alone))
            self._of |= dict.fromkeys(map(id, alike), self.groups[-1])
            offset += 9 if alone else 10
        self.by_pixel, self.quantities = by_pixel, quantities or {}
        cores, others = ({name: q.width for name, q in self.quantities.items() if q.core is core} for core in (True, False))
        self.core = (offset, offset + sum(cores.values())) if cores else (0, 0)
        planes = ({"depth": 1} if depth else {}) | ({"plane": 3} if plane or by_pixel else {})
        self.places = {}
        for name, width in (cores | planes | others).items():
            self.places[name] = slice(offset, offset + width)
            offset += width
        self.depth, self.plane = (self.places[name].start if name in self.places else None for name in ("depth", "plane"))
        self.channels = offset

    def group_of(self, instance: ViewedInstance) -> ChannelGroup:
        """The group that an instance's Gaussians write to."""
        return self._of.get(id(instance), self.groups[0])


@dataclass(frozen=True, eq=False)
class Buffers:
    """The blended buffers of a picture, in the backend's own arrays.

    channels  [h, w, C]  premultiplied, as the layout says
    alpha     [h, w]
    sums      [h, w, K]  by name: the channels of the depth, the plane and the quantities
    probes    [h, w]     by name: those that were asked for
    held, covered  [h, w]  the light that a holdout stops, and which share of each pixel it covers; None without one
    """

    channels: Any
    alpha: Any
    sums: dict[str, Any]
    probes: dict[str, Any]
    held: Any = None
    covered: Any = None


class Exposed(NamedTuple):
    """The average picture of an exposure, in the backend's own arrays.

    rgb      [h, w, 3]  premultiplied; None where no colours were asked for
    alpha    [h, w]
    held     [h, w]     the light that a holdout stops; None without one
    objects  [h, w, K]  what part of each pixel each of the objects covers; None without any
    """

    rgb: Any
    alpha: Any
    held: Any
    objects: Any

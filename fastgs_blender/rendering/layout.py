# SPDX-License-Identifier: GPL-3.0-or-later
"""The channels that are blended when several instances are drawn as one list of splats, and the buffers that come of it."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..model.appearance import Features
from .instances import ViewedInstance


@dataclass(frozen=True)
class ChannelGroup:
    """A run of blended channels with one meaning: the rgb of all instances without a decoder, or the features of one with a decoder.

    offset    first channel
    weight    channel that holds this group's own share of alpha; None: alpha itself
    instance  the instance whose decoder turns the features into colour; None: the channels are rgb
    """

    offset: int
    weight: int | None = None
    instance: ViewedInstance | None = None


class Layout:
    """Which channel holds what when all instances are blended together.

    Three channels for all instances with plain colour, nine for each instance with a decoder (its rays differ from instance to
    instance), plus its share of alpha where it is not alone; the depth, if wanted, comes last.

    groups    list of ChannelGroup
    depth     channel of the depth, or None
    channels  number of channels
    """

    def __init__(self, instances: list[ViewedInstance], depth: bool):
        decoded = [i for i in instances if isinstance(i.model.appearance, Features)]
        plain = len(decoded) < len(instances) or not instances
        alone = len(decoded) == 1 and not plain
        self.groups = [ChannelGroup(0)] if plain else []
        offset = 3 * plain
        for instance in decoded:
            self.groups.append(ChannelGroup(offset, None if alone else offset + 9, instance))
            offset += 9 if alone else 10
        self.depth = offset if depth else None
        self.channels = offset + int(depth)

    def group_of(self, instance: ViewedInstance) -> ChannelGroup:
        """The group that an instance's Gaussians write to."""
        return next((g for g in self.groups if g.instance is instance), self.groups[0])


@dataclass(frozen=True, eq=False)
class Buffers:
    """What a backend blends, in arrays of its own.

    channels  [h, w, C]  premultiplied, as the layout says
    alpha     [h, w]
    depth     [h, w]     sum of the splats' depths times their weights, or None
    median    [h, w]     median depth, or None
    """

    channels: Any
    alpha: Any
    depth: Any
    median: Any

# SPDX-License-Identifier: GPL-3.0-or-later
"""A camera of a rig, as a layout finds it."""
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .sources import Source


@dataclass(frozen=True, eq=False)
class RigCamera:
    """A camera that a layout found.

    pictures  one Source per frame, None where it is missing; a rig whose cameras have different numbers of them is unsynchronised
    pose      world-to-camera [4, 4], or one per frame [F, 4, 4], or None
    masks     as pictures, or empty
    late      how much later than its frame each picture was taken, in frames; empty: not at all
    """

    name: str
    pictures: Sequence[Source | None]
    pose: np.ndarray | None
    masks: Sequence[Source | None] = ()
    late: Sequence[float] = ()

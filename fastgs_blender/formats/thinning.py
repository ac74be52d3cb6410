# SPDX-License-Identifier: GPL-3.0-or-later
"""Leaves Gaussians out of a model that is being compressed, in rounds, and refits the others in each round.

The harm that leaving out one Gaussian does (sensitivity.removal) does not tell what leaving out many does: a surface of several layers
stays closed without any one Gaussian, and has holes without all of them.  So each round but the last leaves out only every second of the
Gaussians that are not worth their bits, counted along the curve through space, on which neighbours often stand in for each other.  The
sensitivities of the others are measured again, because what lay hidden may show now, and they are refitted.
"""
from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..model.gaussians import GaussianModel
from .quantising import Prepared, canonical, prepared
from .refit import refitted
from .sensitivity import Sensitivity, removal, sensitivity, shots

COST = 60.0
"""Bits that leaving a Gaussian out is assumed to save.  The true number is higher, but errors of left-out neighbours add up."""
HARM = COST * 2 * np.log(2) / 12
"""A parameter has a rounding error that is uniform over a step of 2^level / sqrt(sensitivity).  One more bit for it lowers the pictures'
squared error by 4^level 2 ln 2 / 12.  A Gaussian is left out where this adds less error than its bits would remove elsewhere."""
SPARED = 2.5
"""With refitting, Gaussians are left out up to this many times that harm: the others make up for most of it."""
ROUNDS = 3
SENSED = 24
"""Pictures that sensitivities are measured on again in a round."""
REFITS, FINAL = 50, 110
"""Pictures that a model is refitted to in each round, and in the last one."""
LARGEST = 0.4
"""After a round the level changes so that the error comes to the allowed one, but by no more than this."""


def worthy(model: GaussianModel, found: Sensitivity, level: float) -> Prepared:
    """The Gaussians that are worth their bits at a level, when nothing is refitted."""
    keep = removal(model, found) > HARM * 4.0**level
    return prepared(model.take(keep), found.take(keep))


def thinned(model: GaussianModel, found: Sensitivity, level: float, segment: int, original: GaussianModel, first: int, width: int,
            judged: Callable[[Prepared, float], float], progress: Callable[[float], None]) -> tuple[Prepared, float]:
    """The Gaussians that are worth their bits at a level where they are refitted, and the level that they were last refitted at.

    model     in its canonical form, with its sensitivities
    first     number of the first shot of the original that may be used; width: pixels of the pictures that are fitted
    judged    gives the error of a prepared model that is quantised at a level, divided by the allowed one
    progress  called with 0..1; exceptions that it raises pass through
    """
    work, done = (ROUNDS - 1) * REFITS + FINAL + ROUNDS * SENSED, 0

    def part_of(begin: int, count: int) -> Callable[[float], None]:
        return lambda share: progress((begin + share * count) / work)

    for k in range(ROUNDS):
        last = k == ROUNDS - 1
        count = FINAL if last else REFITS
        harm = removal(model, found)
        keep = harm > SPARED * HARM * 4.0**level
        keep[harm.argmax()] = True
        if not last:
            keep[np.flatnonzero(~keep)[k % 2::2]] = True
        model = model.take(keep)
        found = sensitivity(model, shots(original, SENSED, first), part_of(done, SENSED))
        ready = refitted(prepared(model, found), level, segment, original, shots(original, count, first, width),
                         part_of(done + SENSED, count))
        first, done = first + count, done + SENSED + count
        if not last:
            level += float(np.clip(-0.5 * np.log2(max(judged(ready, level), 1e-6)), -LARGEST, LARGEST))
            model = canonical(ready.model)
    return ready, level

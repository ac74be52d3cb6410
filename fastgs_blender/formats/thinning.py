# SPDX-License-Identifier: GPL-3.0-or-later
"""Leaves Gaussians out of a model that is being compressed, in rounds, and refits the others in each round.

The harm that leaving out one Gaussian does (sensitivity.removal) does not tell what leaving out many does: a surface of several layers
stays closed without any one Gaussian, and has holes without all of them.  And how much of it the others can make up for differs from model
to model.  So a round leaves out a small share only, every second of those whose harm is least, counted along the curve through space, on
which neighbours often stand in for each other.  The others are refitted, and it is measured how finely they must be kept then.  Rounds go
on as long as they save bits.  Before the next one the sensitivities are measured again, because what lay hidden may show now.
"""
from collections.abc import Callable

import numpy as np

from ..model.gaussians import GaussianModel
from . import columns
from .quantising import Prepared, Steps, canonical, prepared
from .refit import in_parts, refitted
from .sensitivity import Sensitivity, removal, sensitivity, shots

COST = 60.0
"""Bits that leaving a Gaussian out is assumed to save.  The true number is higher, but errors of left-out neighbours add up."""
HARM = COST * 2 * np.log(2) / 12
"""A parameter has a rounding error that is uniform over a step of 2^level / sqrt(sensitivity).  One more bit for it lowers the pictures'
squared error by 4^level 2 ln 2 / 12.  A Gaussian is left out where this adds less error than its bits would remove elsewhere."""
SHARE = 0.12
"""Of the Gaussians that a round leaves out."""
ROUNDS = 6
"""At most."""
SENSED = 24
"""Pictures that sensitivities are measured on again in a round."""
REFITS, FINAL = 50, 90
"""Pictures that a model is refitted to in each round, and at the end.  Refitting suits the rounding at its level alone, so that it is
repeated at the level that it has led to."""
FINALS, NEAR = 3, 0.93
"""Times at most; the last is the one whose error is at least this share of the allowed error, and no more than it."""
MOST_TRIMMED, TRIALS = 0.1, 5
"""Share of the Gaussians that may be left out after the last refit, where the error is below the allowed one, and number of trials."""
COARSER = 0.2
"""The level of the first round is this much higher than without refitting: what is left is refitted to coarser steps."""


def worthy(model: GaussianModel, found: Sensitivity, level: float) -> np.ndarray:
    """Which Gaussians, bool [N], are worth their bits at a level, when nothing is refitted; at least one of them."""
    harm = removal(model, found)
    return (harm > HARM * 4.0**level) | (harm == harm.max(initial=0))


def thinned(model: GaussianModel, found: Sensitivity, level: float, segment: int, original: GaussianModel, first: int, width: int,
            error: Callable[[Prepared, float], float], progress: Callable[[float], None],
            span: tuple[float, float] = (0.0, 1.0)) -> tuple[Prepared, float]:
    """The Gaussians that together need the fewest bits where they are refitted, and about the level at which they lose what is allowed.

    model     in its canonical form, with its sensitivities
    level     at which it loses what is allowed without refitting
    first     number of the first shot of the original that may be used; width: pixels of the pictures that are fitted
    span      the times that are looked at
    error     gives the error of a prepared model that is quantised at a level, divided by the allowed one
    progress  called with 0..1; exceptions that it raises pass through
    """
    work, done, bits = ROUNDS * (SENSED + REFITS) + FINALS * FINAL, 0, np.inf

    def part_of(count: int) -> Callable[[float], None]:
        return lambda share: progress((done + share * count) / work)

    def refit(ready: Prepared, level: float, count: int) -> Prepared:
        nonlocal first, done
        ready = refitted(ready, level, segment, original, shots(original, count, first, width, span), part_of(count))
        first, done = first + count, done + count
        return ready

    keep, at = worthy(model, found, level), level + COARSER
    model, found = model.take(keep), found.take(keep)
    ready, harm = prepared(model, found), removal(model, found)
    for k in range(ROUNDS):
        new = refit(prepared(model, found), at, REFITS)
        at += allowed_change(error(new, at), error(new, at - 1))
        needed = cost(in_parts(new, at, segment)) if np.isfinite(at) else np.inf
        if needed >= bits:
            break
        ready, level, bits = new, at, needed
        model = canonical(new.model)
        found = sensitivity(model, shots(original, SENSED, first, span=span), part_of(SENSED))
        first, done = first + SENSED, done + SENSED
        harm = removal(model, found)
        keep = ~superfluous(harm, k)
        model, found = model.take(keep), found.take(keep)
    for k in range(FINALS):
        done = work - (FINALS - k) * FINAL
        ready = refit(ready, level, FINAL)
        here = error(ready, level)
        if NEAR <= here <= 1:
            break
        if here > 1 or k < FINALS - 1:
            level += max(allowed_change(here, error(ready, level - 1)), -1.0)
    return trimmed(ready, harm, lambda ready: error(ready, level) <= 1), level


def trimmed(ready: Prepared, harm: np.ndarray, allowed: Callable[[Prepared], bool]) -> Prepared:
    """As many Gaussians left out, of those whose harm [N] is least, as is allowed without another refit: up to MOST_TRIMMED of all."""
    order = np.argsort(-harm, kind="stable")
    low, high = 0, int(MOST_TRIMMED * len(harm)) + 1
    part = ready
    for _ in range(TRIALS):
        count = (low + high) // 2
        if count == low:
            break
        fewer = ready.part(np.sort(order[:len(order) - count]))
        if allowed(fewer):
            low, part = count, fewer
        else:
            high = count
    return part


def allowed_change(here: float, finer: float) -> float:
    """By how much a level may rise so that the error becomes 1, where it is `here` at the level and `finer` one level below.

    What quantisation adds is in proportion to 4^level, and what else is lost stays: `finer` tells how much that is, or somewhat too much
    where numbers were refitted to their rounding at the level.  -inf where it is more than 1.
    """
    added = max(here - finer, 1e-6) / (1 - 0.25)
    return 0.5 * float(np.log2(min(max(1 - (here - added), 0) / added, 1 / max(here, 1e-6)))) if here - added < 1 else -np.inf


def superfluous(harm: np.ndarray, k: int) -> np.ndarray:
    """Which Gaussians, bool [N], a round leaves out: every second of twice SHARE of them, those whose harm [N] is least."""
    least = np.zeros(len(harm), bool)
    least[np.argsort(harm, kind="stable")[:2 * int(SHARE * len(harm))]] = True
    out = np.zeros(len(harm), bool)
    out[np.flatnonzero(least)[k % 2::2]] = True
    return out


def cost(parts: list[tuple[dict[str, np.ndarray], Steps]]) -> float:
    """Bits that these parts need, about: the entropies of their columns."""
    return sum(columns.promised(column) for codes, _ in parts for array in codes.values() for column in array.reshape(len(array), -1).T)

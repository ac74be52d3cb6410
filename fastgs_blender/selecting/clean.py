# SPDX-License-Identifier: GPL-3.0-or-later
"""clean(): proposes which Gaussians of a model had better be hidden, why, and what the pictures of its cameras would miss."""
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..model.gaussians import GaussianModel
from ..util.arguments import one_of, real, shown
from ..util.errors import FastGSError
from .sightings import Sightings, change, sightings
from .strays import Strays, strays

STRENGTH = 0.5
"""Where nothing else is said."""
LOSS = 1e-8, 1e-5
"""Mean squared change of the cameras' pictures (colours 0..1) that is allowed at the strengths 0 and 1: 80 and 50 dB."""
TRIES, SPARE = 12, 0.7
"""Times that it is looked how much less can be hidden, and the share of the allowed change that is then aimed at."""
DARK = 0.1
"""Pixels of light (of pictures 200 pixels large) below which a Gaussian was never filmed, at the strength 1."""
NEAR = 0.4
"""Haze hangs nearer to the cameras than this share of the way to what they see behind it, at the strength 0; at 1, than 0.5 more."""
ALONE = 12.0
"""Times of the usual distance of neighbours from which on a Gaussian is alone, at the strength 0; at 1, 8 less."""
FEW, HARDLY = 0.25, 0.2
"""Share of the cameras up to which few saw a Gaussian, or one; and share of its area up to which it was hardly seen, at the strength 1."""
TINT, HALF = 0.6, 0.5
"""Difference of colours (largest channel, 0..1) that is stray at the strength 0; at 1, 0.4 less.  Share of the cameras up to which it is no
detail of what was filmed."""


class Evidence(NamedTuple):
    """What is known of N Gaussians: what the cameras saw, how they lie among the others, and whether the file knows cameras."""

    sight: Sightings
    stray: Strays
    filmed: bool


class Kind(NamedTuple):
    """Why Gaussians had better be hidden: its name and its meaning in menus, whether cameras are needed to judge it, and which Gaussians
    [N] bool are meant at a strength 0..1."""

    label: str
    meaning: str
    cameras: bool
    find: Callable[[Evidence, float], np.ndarray]


def _unseen(evidence: Evidence, strength: float) -> np.ndarray:
    sight = evidence.sight
    return (sight.chances > 0) & (sight.best < DARK * strength)


def _haze(evidence: Evidence, strength: float) -> np.ndarray:
    return evidence.sight.before < NEAR + 0.5 * strength


def _floaters(evidence: Evidence, strength: float) -> np.ndarray:
    sight, stray, filmed = evidence
    alone = stray.alone > ALONE - 8 * strength
    if not filmed:
        return alone
    few = sight.seen <= np.maximum(1, FEW * strength * sight.chances)
    return (sight.chances > 2) & few & (alone | (sight.best < HARDLY * strength * sight.area))


def _colours(evidence: Evidence, strength: float) -> np.ndarray:
    sight, stray, _ = evidence
    return (stray.tint > TINT - 0.4 * strength) & (sight.seen <= HALF * sight.chances)


KINDS: dict[str, Kind] = {
    "unseen": Kind("Never Filmed", "what no camera of the capture saw", True, _unseen),
    "haze": Kind("Haze before Cameras", "what hangs between the cameras and what they see behind it", True, _haze),
    "floaters": Kind("Floaters", "what few cameras saw and lies alone, or is large or thin and was hardly seen", False, _floaters),
    "colours": Kind("Stray Colours", "what has another colour than all that lies around it", False, _colours),
}
"""In the order in which a Gaussian is counted, once."""


@dataclass(frozen=True, eq=False)
class Cleaning:
    """What clean() proposes to hide of N Gaussians.

    taken     all that had better be hidden, [N] bool
    found     the same by the kind, each Gaussian under one of them
    loss      mean squared change of the cameras' pictures (colours 0..1) without all of it; None where the file knows no cameras
    unjudged  kinds that were asked for and cannot be judged, because the file knows no cameras

    Example:
        proposed = fg.clean(model, strength=0.7)
        fg.save(model.take(~proposed.taken), "clean.safetensors")
    """

    taken: np.ndarray
    found: dict[str, np.ndarray]
    loss: float | None
    unjudged: tuple[str, ...]


def clean(model: GaussianModel, strength: float = STRENGTH, *, kinds: Collection[str] | None = None,
          progress: Callable[[float], None] | None = None) -> Cleaning:
    """Propose what of a model to hide: floaters, haze before the cameras, what no camera saw, stray colours.

    strength  0 (nothing) to 1 (much)
    kinds     some of "unseen", "haze", "floaters" and "colours"; None: all of them
    progress  called with 0..1 while the cameras' pictures are looked at; what it raises ends the work and passes through

    Of all that is found, those Gaussians are proposed without which the pictures of the capture's cameras change least, up to 60 dB (PSNR
    between before and after) at the strength 0.5 and 50 dB at 1.  A file that knows no cameras (Surroundings.cameras; `fastgs annotate`
    stores them) has no such bound, and only floaters and stray colours can be judged.  The backdrop is left alone.  What was found out
    about a model is kept while it lives, so that another strength takes no time.

    Returns a Cleaning; the model stays as it is.  Raises FastGSError for a sequence.

    Example:
        proposed = fg.clean(model, strength=0.7)
        print({kind: int(found.sum()) for kind, found in proposed.found.items()})
    """
    if not isinstance(model, GaussianModel):
        raise FastGSError(f"clean() needs one model, as fg.load(path) reads it, not {shown(model)}; fastgs convert makes one.")
    strength = real(strength, "the strength of clean()", 0, 1)
    chosen = [one_of(kind, "a kind of clean()", KINDS) for kind in (KINDS if kinds is None else kinds)]
    cameras = bool(model.surroundings.cameras)
    evidence = Evidence(sightings(model, progress or (lambda share: None)), strays(model), cameras)
    backdrop = model.surroundings.backdrop
    left = np.ones(len(model), bool) if backdrop is None else backdrop.distance(model.position) <= 1
    found = {}
    for name, kind in KINDS.items():
        if name in chosen and (cameras or not kind.cameras):
            found[name] = left & kind.find(evidence, strength) if strength else np.zeros(len(model), bool)
            left = left & ~found[name]
    taken, loss = np.any([*found.values(), np.zeros(len(model), bool)], 0), None
    if cameras:
        taken, loss = _allowed(model, np.flatnonzero(taken), evidence.sight.cost, strength)
        found = {name: bits & taken for name, bits in found.items()}
    return Cleaning(taken, found, loss, tuple(name for name in chosen if KINDS[name].cameras and not cameras))


def _allowed(model: GaussianModel, taken: np.ndarray, cost: np.ndarray, strength: float) -> tuple[np.ndarray, float]:
    """Which Gaussians [N] may be hidden of those taken [M], the cheapest first, until the pictures would change too much; and that change.

    What they change together is seen in pictures without them.  It may be more than the sum of what each changes.
    """
    order = taken[np.argsort(cost[taken], kind="stable")]
    total = np.cumsum(cost[order], dtype=np.float64)
    low, high = LOSS
    most = low ** (1 - strength) * high**strength
    count, loss = int(np.searchsorted(total, most, side="right")), 0.0
    for k in range(TRIES):
        allowed = np.zeros(len(cost), bool)
        allowed[order[:count]] = True
        loss = change(model, allowed)
        if loss <= most:
            return allowed, loss
        less = int(np.searchsorted(total, SPARE * total[count - 1] * most / loss)) if k < 2 else count
        count = less if 0 < less < count else int(count * np.sqrt(SPARE * most / loss))  # layers add up as squares
    return np.zeros(len(cost), bool), 0.0

# SPDX-License-Identifier: GPL-3.0-or-later
"""Grow to the Thing: from a few Gaussians of a thing to all of it, by what lies together, moves together and looks alike.

It is a cut through the joins of neighbours (joins.py), each with a weight that is small where its two Gaussians drift apart or differ in
colour.  A minimal cut (Boykov and Jolly 2001) obeys every Gaussian of a stroke, those of the floor beside a foot too, and cuts off what
is long and thin.  So the squares of the differences are made least instead of their sizes: the random walker (Grady 2006), a potential
that strokes pull to 1 and -1 and everything else weakly to 0, what has other colours less weakly.  It is then found twice again.

* Gaussians of a stroke whose neighbours say otherwise are pulled less: in a trained model a stroke always touches some of the haze and of
  what lies behind.
* Joins across which it differs much hold less, so that it falls where the thing ends, not all the way there: half the way to a minimal cut.

With a stroke over what does not belong to it, the border is the potential at which the joins that it cuts are weakest, by those
within it: a sweep cut (Andersen, Chung and Lang 2006), which prefers high borders.  Pieces of other colours are added (spans.py).
"""
from dataclasses import dataclass

import numpy as np

from ..model.gaussians import GaussianModel
from ..model.slicing import positions_at
from ..rendering.filters import base_colours
from ..util.curve import hilbert_order
from ..util.errors import FastGSError
from ..util.kept import kept
from .joins import LOOSE, Joins, joins
from .spans import continued, spanned, untold

PULL, MOST_PULL = 0.3, 0.03
"""How strongly a Gaussian of a stroke is pulled, by the sum of the weights that meet in it, with MANY Gaussians; and at most.  By more, a
thing of which a stroke touched two Gaussians would be pulled as far as one that it went along."""
REST, REST_ALONE = 2.5e-4, 1e-3
"""How strongly each Gaussian is pulled to 0, by the same sum; and where no stroke says what does not belong to the thing."""
OTHER, TINT = 5.0, 0.15
"""How much more that is for a Gaussian of another colour than the stroke's, where a stroke says what does not belong to the thing; and the
difference of colours (0..1) from which on."""
SEEN = 128
"""The most Gaussians of a stroke that colours are compared with; a colour is the stroke's if three of them have it."""
BORDERS, TRIED = (0.003, 0.7), 161
"""Shares of the strokes' mean potential between which the border is looked for, and how many are tried."""
HELD = 0.7
"""The share of a stroke's Gaussians that the border must leave in the thing, where there is such a border: a few that hardly hang on the
rest make the weakest cut of all."""
FREE = 3e-5
"""The share of joins within a border below which a weaker cut is no better.  A border of half the height has to cut half as much: of
equally weak joins, the first ones end the thing."""
BORDER_ALONE, TORN, CLEAN, LARGEST = 0.5, 4e-3, 1e-4, 0.8
"""The border where no stroke says what does not belong to the thing.  Where it cuts such a share of the joins within it, and the weakest
cut a ten-thousandth of that, the weakest cut counts: a click on a ball means the ball.  Always taken, it would lose parts and take
neighbours; and where it leaves next to nothing out, it means the room that a capture is joined to.  If there is nothing else, it is all."""
FALL = 0.1
"""Difference of the potential across a join that halves its weight."""
MANY = 20_000
"""With more Gaussians joins are shorter. To reach as far, pulls are weaker there, by the power 1.5 of their number (measured)."""
FEW = 40
"""A stroke over fewer Gaussians, as a click, has less to hold up: each Gaussian is pulled to 0 by so much less."""
LEAST = 0.02
"""What is left at least of the pull of a stroke's Gaussian whose neighbours say otherwise."""


@dataclass(frozen=True)
class Fields:
    """What strokes say of every Gaussian, whatever the reach.

    other      [N] bool, of another colour than the stroke's
    weight     [E], degree [N] as of Joins.held()
    alone, y   [N] the potentials, the first without joins that hold less
    borders    that may end the thing, and for each the `ratio` of the joins that it cuts
    """

    found: Joins
    other: np.ndarray
    weight: np.ndarray
    degree: np.ndarray
    alone: np.ndarray
    y: np.ndarray
    borders: np.ndarray
    ratio: np.ndarray


def grow(model: GaussianModel, yes: np.ndarray, no: np.ndarray | None = None, reach: float = 0.0) -> np.ndarray:
    """Which Gaussians [N] bool belong to the thing that strokes went over, on all frames.

    yes  [N] bool, Gaussians of strokes over the thing, at any times and from any views (shapes.touched())
    no   [N] bool, of strokes over what does not belong to it; None: whatever is hardly joined to it does not
    reach  how much farther than the border that is found, or less far: 1 to -1, the lowest and the highest border; below 0 without
           pieces of other colours

    Joins are kept while the model lives, so that further strokes take less time, and so are the potentials of the latest strokes, for
    another reach.  Raises FastGSError where `yes` is empty.
    """
    if not yes.any():
        raise FastGSError("nothing of the thing is marked yet; draw a stroke over it first.")
    no = np.zeros_like(yes) if no is None else no
    strokes, latest = np.packbits([yes, no]).tobytes(), _latest(model)
    if (fields := latest.get(strokes)) is None:
        fields = _fields(model, yes, no)
        latest.clear()
        latest[strokes] = fields
    y, ratio, best = fields.y, fields.ratio, np.argmin((fields.ratio + FREE) / np.geomspace(*BORDERS, TRIED))
    thing, may = y > _reached(fields.borders[best], reach, float(y[yes].mean())), y > fields.borders[0]
    if not no.any():
        mean = float(fields.alone[yes].mean())
        alone, (i, j) = fields.alone > _reached(BORDER_ALONE * mean, reach, mean), fields.found.ends.T
        torn = fields.weight[alone[i] != alone[j]].sum() / fields.degree[alone].sum()
        whole = thing.all() or thing.mean() < LARGEST
        return thing if whole and torn > TORN and ratio[best] < CLEAN * torn else alone
    if reach < 0:
        return thing
    thing = spanned(fields.found, yes, no, thing, may, ~fields.other)
    return continued(fields.found, positions_at(model, 0.5), thing, may)


@kept
def _latest(model: GaussianModel) -> dict[bytes, Fields]:
    """The fields of a model's latest strokes."""
    return {}


def _fields(model: GaussianModel, yes: np.ndarray, no: np.ndarray) -> Fields:
    """Fields of strokes, given as for grow()."""
    from ..kernels.cpu.walk import potential  # it brings numba, which enabling the add-on must not

    against = bool(no.any())
    other = _other(model, yes) if against else np.zeros(len(model))
    rest = REST * (1 + OTHER * other)
    side = yes.astype(np.float32) - no
    found = joins(model).of(yes)
    order, (i, j) = hilbert_order(model.position), found.ends.T
    weight, degree = found.held(len(model))
    many = min(MANY / len(model), 1) ** 1.5
    pull = min(PULL * many, MOST_PULL) * degree * np.abs(side)
    rest = rest * many * degree * min(int(yes.sum()) / FEW, 1)
    nearly = rest if against else rest * (REST_ALONE / REST)
    y = potential(found.ends, weight, pull + nearly, pull * side, order)
    around = (np.bincount(i, weight * y[j], len(model)) + np.bincount(j, weight * y[i], len(model))) / degree
    pull *= np.maximum(np.clip(0.5 + 0.5 * side * around, 0, 1) ** 2, LEAST)
    alone = potential(found.ends, weight, pull + nearly, pull * side, order)
    y = potential(found.ends, weight * FALL / (FALL + np.abs(alone[i] - alone[j])), pull + rest, pull * side, order)
    borders, ratio = _cuts(y, float(y[yes].mean()), found.ends, weight, degree)
    if held := np.searchsorted(borders, np.quantile(y[yes], 1 - HELD)):  # higher ones leave out too much of the stroke
        ratio[held:] = np.inf
    return Fields(found, other >= 0.5, weight, degree, alone, y, borders, ratio)


def unsure(model: GaussianModel, yes: np.ndarray, no: np.ndarray, thing: np.ndarray) -> np.ndarray:
    """The parts that strokes, given as for grow(), leave open of the thing [N] bool that was found: [N] their numbers, 1 the largest; 0 is
    sure.  One more stroke over a part, of either kind, as a rule decides it for the next grow()."""
    return untold(joins(model).of(yes), positions_at(model, 0.5), yes, no, thing, _other(model, yes) < 0.5)


def _reached(border: float, reach: float, mean: float) -> float:
    """A border moved by a reach."""
    end = BORDERS[0 if reach > 0 else 1] * mean
    return border * (end / border) ** abs(reach) if border > 0 else border


def _cuts(y: np.ndarray, mean: float, ends: np.ndarray, weight: np.ndarray, degree: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Borders of a potential y [N], and for each the weight of the joins that it cuts by that of those within it."""
    borders, far = np.geomspace(*BORDERS, TRIED) * max(mean, 0.0), TRIED + 1
    above = np.searchsorted(borders, y)  # of how many borders a Gaussian is within
    low, high = np.sort(above[ends].T, axis=0)
    cut = (np.bincount(low, weight, far) - np.bincount(high, weight, far)).cumsum()[:-1]
    inside = degree.sum() - np.bincount(above, degree, far).cumsum()[:-1]
    return borders, cut / np.maximum(inside, LOOSE)


def _other(model: GaussianModel, yes: np.ndarray) -> np.ndarray:
    """How far the colour of each Gaussian [N] is none of the stroke's: 0 to 1."""
    colour = base_colours(model).astype(np.float32)
    stroke = colour[np.flatnonzero(yes)[:: -(-int(yes.sum()) // SEEN)]]
    squared = (colour**2).sum(1)[:, None] + (stroke**2).sum(1) - 2 * colour @ stroke.T
    third = min(3, len(stroke)) - 1
    return 1 - np.exp(-np.maximum(np.partition(squared, third, axis=1)[:, third], 0) / (2 * TINT**2))


def connected(model: GaussianModel, some: np.ndarray, reach: float = 3.0) -> np.ndarray:
    """Which Gaussians [N] bool lie together with some [N] bool: there is a way from one to the next, none of whose steps is longer than
    `reach` times the usual distance of neighbours, at any moment of the clip."""
    from ..kernels.cpu.walk import pieces

    found = joins(model)
    piece = pieces(len(some), found.ends[found.near <= reach])
    return np.isin(piece, piece[some])

# SPDX-License-Identifier: GPL-3.0-or-later
"""What a stroke says by what it spans: one that goes from colour to colour means a thing of several colours.

Two strokes alone do not say whether a cup belongs to its tray, or a head to its torso.  But a stroke over a torso and a thigh crosses a
border of colours, and so do the borders to head and arms not end the thing.  One over a cup crosses none.  A stroke over a car's body
that touches a wheel crosses colours too, if the cut has found that wheel.  Motion stays a border for what is added: limbs keep a common
point, where they hardly move against each other, and two things that pass do not.

Where a stroke crosses no colours, the border itself may tell (continued()).  Where a thing goes on in another colour, as a painted ball
does, its two sides lie opposite to each other.  Things that touch lie side by side there, or one on the other.
"""
import numpy as np

from .joins import MOST_TINT, Joins

MOST = 0.85
"""The share of a stroke's Gaussians that it means.  The others are its rim."""
NEAR, STILL = 3.0, 1.0
"""Up to this distance, in units of the usual one, and this change of it (`Joins.drift`) two Gaussians hang together."""
ANOTHER = 0.5 * MOST_TINT
"""The difference of colours (`Joins.tint`) from which on a stroke goes on to another colour."""
SIZE = 0.5
"""The largest piece that is added, as a share of the Gaussians of what it hangs on."""
LEFT, LARGE = 0.12, 2.0
"""A piece of one colour that hangs on the thing belongs to it though the cut left it out, if so large a share of the stroke lies in it, and
more than of the strokes over the rest: a large part that the stroke crosses is pulled less than a small one, and so is a foot on a denied
floor.  At most it is so many times as large as the thing."""
FEW = 8
"""The fewest Gaussians of a piece of the thing that tells of another colour, if a Gaussian of the stroke lies in it."""
ON = 0.1
"""How far at least the two sides of a border lie opposite to each other, if a thing goes on there: 0 side by side, about 0.2 painted."""
UNTOLD, TOLD = (0.05, 0.7), 0.02
"""The smallest and the largest piece that may be in doubt, as shares of the Gaussians of the thing; and from which share of a piece on a
stroke tells of it."""


def spanned(found: Joins, yes: np.ndarray, no: np.ndarray, thing: np.ndarray, may: np.ndarray, like: np.ndarray) -> np.ndarray:
    """A thing [N] bool, with what of its stroke the cut left out, and the pieces of other colours that hang on it alone, if its stroke
    crosses colours.

    yes   [N] bool, Gaussians of the stroke; no [N] bool, of strokes over what does not belong to the thing
    may   [N] bool, what strokes leave open or call the thing; a piece with any other Gaussian in it is not added, unless strokes go over it
    like  [N] bool, what has a colour of the stroke: such pieces are found first, by the joins among these alone
    """
    from ..kernels.cpu.walk import pieces  # it brings numba, which enabling the add-on must not

    (i, j), count = found.ends.T, len(yes)
    firm = (found.near <= NEAR) & (found.drift <= STILL)
    plain = firm & (found.tint <= ANOTHER)

    def beyond(within: np.ndarray, across: np.ndarray, largest: float) -> tuple[np.ndarray, np.ndarray]:
        """The piece of each Gaussian beyond the thing, by the joins `within`; and which pieces hang on it, by those across its border."""
        piece, hangs = pieces(count, found.ends[within & ~thing[i] & ~thing[j]]), np.zeros(count, bool)
        hangs[piece[np.where(thing[i], j, i)[across & (thing[i] != thing[j])]]] = True
        return piece, hangs & (np.bincount(piece, minlength=count) <= largest * thing.sum())

    piece, hangs = beyond(plain, firm, LARGE)
    said, denied = (np.bincount(piece, each & ~thing, count) / max(each.sum(), 1) for each in (yes, no))
    thing = thing | (hangs & (said >= LEFT) & (said > denied))[piece]
    stroke = np.flatnonzero(yes & may)
    if not len(stroke):
        return thing
    held = np.bincount(pieces(count, found.ends[plain & may[i] & may[j]])[stroke]).max()
    own = pieces(count, found.ends[plain & thing[i] & thing[j]])
    several = (np.bincount(own, minlength=count) >= FEW) & (np.bincount(own, yes & thing, count) > 0)
    if held >= MOST * len(stroke) and several.sum() < 2:
        return thing
    for joined in firm & like[i] & like[j], firm:
        piece, hangs = beyond(joined, joined, SIZE)
        thing = thing | (hangs & (np.bincount(piece, ~may, count) == 0))[piece]
    return thing


def continued(found: Joins, place: np.ndarray, thing: np.ndarray, may: np.ndarray) -> np.ndarray:
    """A thing [N] bool, with the pieces into which it goes on; place [N, 3] is where Gaussians are at one moment, `may` as above."""
    from ..kernels.cpu.walk import pieces

    (i, j), count = found.ends.T, len(thing)
    firm = (found.near <= NEAR) & (found.drift <= STILL)
    piece = pieces(count, found.ends[firm & ~thing[i] & ~thing[j]])
    i, j, apart = _opposite(found.ends[firm], place, thing)
    beyond = piece[np.where(thing[i], j, i)]
    goes = np.bincount(beyond, apart, count) > ON * np.bincount(beyond, minlength=count)
    return thing | (goes & (np.bincount(piece, ~may, count) == 0))[piece]


def _opposite(ends: np.ndarray, place: np.ndarray, side: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The joins [E, 2] across the border of a side [N] bool: their ends [B], [B], and how far both sides lie opposite there [B]."""
    (i, j), count = ends.T, len(side)
    edge = side[i] != side[j]
    way = place[j] - place[i]
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    (a, b), own = ends[~edge].T, way[~edge].T  # where each Gaussian's neighbours of its own side lie
    many = np.maximum(np.bincount(a, minlength=count) + np.bincount(b, minlength=count), 1)
    around = np.stack([(np.bincount(a, x, count) - np.bincount(b, x, count)) / many for x in own], 1)
    i, j, way = i[edge], j[edge], way[edge]
    return i, j, np.minimum(-(around[i] * way).sum(1), (around[j] * way).sum(1))


def untold(found: Joins, place: np.ndarray, yes: np.ndarray, no: np.ndarray, thing: np.ndarray, like: np.ndarray) -> np.ndarray:
    """The pieces of one colour of which strokes do not tell whether they belong to a thing: [N] their numbers, 1 the largest; 0 is sure.

    Within the thing these have none of the stroke's colours (`like`), the stroke lies in one of its pieces, and it does not go on into
    them; around it they hang on it.  Masks and place as above.
    """
    from ..kernels.cpu.walk import pieces

    (i, j), count = found.ends.T, len(thing)
    firm = (found.near <= NEAR) & (found.drift <= STILL)
    piece = pieces(count, found.ends[firm & (found.tint <= ANOTHER) & (thing[i] == thing[j])])
    size, ours = np.bincount(piece, minlength=count), np.bincount(piece, like, count)
    hangs = np.zeros(count, bool)
    hangs[piece[np.where(thing[i], j, i)[firm & (thing[i] != thing[j])]]] = True
    low, high = (share * thing.sum() for share in UNTOLD)
    open_ = np.where(thing, ours < 0.5 * size, hangs) & (size > 0) & (size >= low) & (size <= high)
    for each in yes, no:
        open_ &= np.bincount(piece, each, count) < TOLD * size
    if ((size >= FEW) & (np.bincount(piece, yes & thing, count) > 0)).sum() > 1:  # it crosses colours
        open_ &= ~thing
    within = found.ends[firm & thing[i] & thing[j]]
    for number in np.flatnonzero(open_ & thing):
        apart = _opposite(within, place, piece == number)[2]
        open_[number] = not len(apart) or apart.mean() <= ON
    largest = np.flatnonzero(open_)
    number = np.zeros(count, np.int64)
    number[largest[np.argsort(-size[largest], kind="stable")]] = np.arange(len(largest)) + 1
    return number[piece]

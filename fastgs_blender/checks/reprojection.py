# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the cameras whose calibration is wrong, by reprojection errors of points that the other cameras triangulate.

Epipolar distances alone are not enough: if a camera on an arc is turned sideways, its features move along the epipolar lines.  So a point
is triangulated from a track's features in the other cameras, and projected into the camera; epipolar lines are used only where no three
cameras see the same point.

A camera is called wrong only if its error surely exceeds OFF (captures/evidence.py) and its own pose has no support: where things repeat,
matches that are off by a whole tile may outnumber the others, but right poses still put some features exactly on their points.  And right
cameras must say so: a right one that only two wrong ones look at has large errors too.  Else it is unsure.
"""
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from ..captures.evidence import SURE, differs, median
from ..training.initial import features
from .matching import CLOSE, Matches

OFF = 1.5
"""Reprojection error, in pixels of the sampled pictures, above which a camera counts as wrong."""
ENOUGH = 16
"""Least number of tracks for a camera's error to be trusted."""
EXACT, AROUND = 1.0, 3.0
"""Errors in pixels of features that support a pose, and up to which others are counted that may lie there by chance."""
MOST, MOST_TRIPLES = 200, 6000
"""Largest number of tracks that are evaluated for a camera, and of points of three cameras."""
FEW = 8
"""Least number of points on which three cameras must agree to be right."""


@dataclass(frozen=True, eq=False)
class Judged:
    """misses: for each view its median error in pixels against the correct cameras, NaN where too few features match; wrong: the views with
    a wrong calibration, the worst first; unsure: those whose error is large, and may be so by wrong matches alone."""

    misses: dict[str, float]
    wrong: list[str]
    unsure: list[str] = field(default_factory=list)


def judged(matches: Matches, views: Sequence[str]) -> Judged:
    """Find the wrong cameras one by one: leave out the worst camera, surely wrong or not, and measure the others again without it."""
    aside: dict[str, bool] = {}
    final: dict[str, tuple[float, bool]] = {}
    while True:
        found = {view: _miss(matches, view, list(aside)) for view in views if view not in aside}
        final |= found
        off = {view: miss for view, (miss, _) in found.items() if miss > OFF}
        known = sum(np.isfinite(miss) for miss, _ in found.values())
        if not any(sure for _, sure in found.values()) or len(off) == known <= 2 or len(aside) >= len(views) // 2:
            break
        worst = _worst(matches, off, list(aside))
        aside[worst] = found[worst][1]
    if len(aside) >= max(len(views) // 2, 2):  # nobody is right: the calibration as a whole is off
        aside, final = {}, {view: _miss(matches, view, []) for view in views}
    misses = {view: final[view][0] for view in views}
    wrong = [view for view, sure in aside.items() if sure]
    unsure = [view for view, miss in misses.items() if miss > OFF and not aside.get(view, final[view][1])]
    right = _agreeing(matches) if wrong else set()
    if len(right) < 2:
        return Judged(misses, wrong, unsure)
    doubted = [*wrong, *(view for view in views if view not in {*wrong, *right})]
    sure = [view for view in doubted if _miss(matches, view, [other for other in views if other not in {view, *right}], ENOUGH)[1]]
    return Judged(misses, sure, [view for view in unsure if view not in sure] + [view for view in wrong if view not in sure])


def _worst(matches: Matches, off: dict[str, float], without: Sequence[str]) -> str:
    """Of the cameras with large errors, the one whose removal lowers the others' errors most; where these are small without any one of
    several, the one with the largest error."""
    if len(off) == 1:
        return next(iter(off))
    tried = sorted(off, key=lambda view: -off[view])[:4]
    rest = {view: [miss for other in off if other != view and np.isfinite(miss := _miss(matches, other, [*without, view])[0])]
            for view in tried}
    return min(tried, key=lambda view: (max(np.mean(rest[view]), OFF) if rest[view] else np.inf, -off[view]))


def _agreeing(matches: Matches) -> set[str]:
    """The views that are one of three that agree on most of the points that they share: wrong poses do so by no chance."""
    triples = [(moment, {view: rows[view] for view in three}) for moment, rows in matches.all_tracks()
               for three in combinations(sorted(rows), 3)]
    triples = triples[:: max(1, -(-len(triples) // MOST_TRIPLES))]
    shared, agreed = Counter[tuple[str, ...]](), Counter[tuple[str, ...]]()
    for (_, rows), error in zip(triples, matches.points(triples)[1]):
        shared[tuple(rows)] += 1
        agreed[tuple(rows)] += int(error < EXACT)
    return {view for three, count in shared.items() if count >= FEW and agreed[three] > count / 2 for view in three}


def _miss(matches: Matches, view: str, without: Sequence[str], least: int = 0) -> tuple[float, bool]:
    """The error of a view's features in pixels, and whether it is surely too large; of fewer features than `least` it never is."""
    errors, _, _ = offsets(matches, view, without)
    if len(errors) < ENOUGH:
        errors = _lines(matches, view, without)
    return median(errors)[0], len(errors) >= least and surely_off(errors)


def _lines(matches: Matches, view: str, without: Sequence[str]) -> np.ndarray:
    """Distances in pixels of a view's matches from epipolar lines."""
    pairs = [pair.distance for pair in matches.pairs if view in (pair.a, pair.b) and not {pair.a, pair.b} & set(without)]
    return np.concatenate(pairs) if pairs else np.zeros(0)


def surely_off(errors: np.ndarray, least: float = OFF) -> bool:
    """Whether errors [M] in pixels say that a pose is wrong: by their median, and without a peak at 0, which only a right pose has."""
    middle, deviation = median(errors)
    exact, around = (errors < EXACT).sum(), ((errors >= EXACT) & (errors < AROUND)).sum() * EXACT / (AROUND - EXACT)
    return middle > least and bool(differs(middle - least, deviation, 0)) and exact - around < SURE * np.sqrt(around + 1)


def offsets(matches: Matches, view: str, without: Sequence[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of tracks that a view and at least two others see: pixels [T] between its feature and the others' point, the features' places
    [T, 2], and the points [T, 3].

    Where enough tracks have three others, only those count: two cameras cannot contradict each other along their lines.
    """
    tracks = [(moment, rows) for moment, rows in matches.all_tracks(without) if view in rows and len(rows) >= 3]
    long = [track for track in tracks if len(track[1]) >= 4]
    tracks = long if len(long) >= ENOUGH else tracks
    tracks = tracks[:: max(1, -(-len(tracks) // MOST))]
    xyz, errors = matches.points([(moment, {v: row for v, row in rows.items() if v != view}) for moment, rows in tracks])
    off, places, points = [], [], []
    for (moment, rows), point, error in zip(tracks, xyz, errors):
        if error < CLOSE:
            each = matches.features[moment, view]
            off.append(features.reprojection(each, rows[view], each.camera.world_to_camera[:3], point))
            places.append(each.places[rows[view]])
            points.append(point)
    return np.array(off), np.array(places).reshape(-1, 2), np.array(points).reshape(-1, 3)

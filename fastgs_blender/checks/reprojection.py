# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the cameras whose calibration is wrong, by reprojection errors of points that the other cameras triangulate.

Epipolar distances alone are not enough: if a camera on an arc is turned sideways, its features move along the epipolar lines.  So a point
is triangulated from a track's features in the other cameras, and projected into the camera; epipolar lines are used only where no three
cameras see the same point.
"""
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..training.initial import features
from .matching import CLOSE, Matches

OFF = 1.5
"""Reprojection error, in pixels of the sampled pictures, above which a camera counts as wrong."""
ENOUGH = 16
"""Least number of tracks for a camera's error to be trusted."""
MOST = 200
"""Largest number of tracks that are evaluated for a camera."""


@dataclass(frozen=True, eq=False)
class Judged:
    """misses: for each view its median error in pixels against the correct cameras, NaN where too few features match; wrong: the views with
    a wrong calibration, the worst first."""

    misses: dict[str, float]
    wrong: list[str]


def judged(matches: Matches, views: Sequence[str]) -> Judged:
    """Find the wrong cameras one by one: leave out the worst camera, and measure the others again without it."""
    wrong: list[str] = []
    final: dict[str, float] = {}
    while True:
        found = {view: _miss(matches, view, wrong) for view in views if view not in wrong}
        final |= found
        off = {view: miss for view, miss in found.items() if miss > OFF}
        if not off or len(off) == sum(map(np.isfinite, found.values())) <= 2 or len(wrong) >= len(views) // 2:
            break
        wrong.append(_worst(matches, off, wrong))
    if len(wrong) >= max(len(views) // 2, 2):  # nobody is right: the calibration as a whole is off
        wrong = []
        final = {view: _miss(matches, view, wrong) for view in views}
    return Judged({view: final[view] for view in views}, wrong)


def _worst(matches: Matches, off: dict[str, float], without: Sequence[str]) -> str:
    """Of the cameras with large errors, the one whose removal lowers the others' errors most."""
    if len(off) == 1:
        return next(iter(off))
    tried = sorted(off, key=lambda view: -off[view])[:4]
    rest = {view: [miss for other in off if other != view and np.isfinite(miss := _miss(matches, other, [*without, view]))]
            for view in tried}
    return min(tried, key=lambda view: (np.mean(rest[view]) if rest[view] else np.inf, -off[view]))


def _miss(matches: Matches, view: str, without: Sequence[str]) -> float:
    """The error of a view's features in pixels: reprojection errors of points of the other views, else distances from epipolar lines."""
    off, _, _ = offsets(matches, view, without)
    if len(off) >= ENOUGH:
        return float(np.median(off))
    lines = [pair.distance for pair in matches.pairs
             if view in (pair.a, pair.b) and not {pair.a, pair.b} & set(without)]
    return float(np.median([np.median(line) for line in lines])) if lines else np.nan


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

# SPDX-License-Identifier: GPL-3.0-or-later
"""Matches features between pictures of one moment without using the calibration, so that the calibration can be measured by the matches.

Matches are the inliers of one fundamental matrix (pycolmap's LO-RANSAC, with a fixed seed); a pair of pictures without a consistent matrix
is not used.  A matrix alone is not enough: on a floor of tiles, matches that are off by one tile agree with each other.  So a feature
counts only if nothing else in its own picture looks like it (features.distinct()).
"""
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np

from ..training.initial import features
from ..training.initial.dense import spread
from ..util import groups

PICTURES = 48
"""Pictures whose features are extracted, over all moments."""
MOMENTS, LEAST, LEAST_SHARE = 3, 16, 0.35
"""Moments at most; matches of a pair that must agree, and their share: fewer agree by chance."""
AGREE = 3.0
"""Pixels within which matches agree on a fundamental matrix."""
MOST_FEATURES = 2500
MOST_POINTS = 3000
CLOSE = 2.0
"""Pixels within which a point must lie by its features to be taken for one."""


@dataclass(frozen=True, eq=False)
class Pair:
    """The matches of two pictures of one moment.

    rows      [M, 2] features of the first picture and of the second
    distance  [M] mean distance in pixels of the matches from the calibration's epipolar lines; NaN in a capture without poses
    """

    moment: int
    a: str
    b: str
    rows: np.ndarray
    distance: np.ndarray


@dataclass(frozen=True, eq=False)
class Matches:
    """Features of each (moment, view), the samples they are of, and the pairs that have enough in common; tried: how many were compared."""

    features: dict[tuple[int, str], features.Features]
    samples: dict[tuple[int, str], Any]
    pairs: list[Pair]
    tried: int

    def all_tracks(self, without: Sequence[str] = ()) -> list[tuple[int, dict[str, int]]]:
        """tracks(), remembered."""
        key = tuple(sorted(without))
        if key not in self._tracks:
            self._tracks[key] = self.tracks(without)
        return self._tracks[key]

    @cached_property
    def _tracks(self) -> dict:
        return {}

    @cached_property
    def _rays(self) -> dict:
        """By (moment, view): what makes a ray of a pixel [3, 3], and the camera's place [3]."""
        return {key: (each.camera.world_to_camera[:3, :3].T @ np.linalg.inv(features.matrix(each.camera)),
                      each.camera.centre) for key, each in self.features.items()}

    def tracks(self, without: Sequence[str] = ()) -> list[tuple[int, dict[str, int]]]:
        """(moment, feature by view) of groups of features that show the same point, without some views."""
        pairs = [((pair.moment, pair.a, i), (pair.moment, pair.b, j)) for pair in self.pairs
                 if pair.a not in without and pair.b not in without for i, j in pair.rows.tolist()]
        found = []
        for group in groups.joined(sorted({key for pair in pairs for key in pair}), pairs):
            views = [view for _, view, _ in group]
            once = {view: row for _, view, row in group if views.count(view) == 1}
            if len(once) >= 2:
                found.append((group[0][0], once))
        return found

    def points(self, tracks: Sequence[tuple[int, dict[str, int]]]) -> tuple[np.ndarray, np.ndarray]:
        """The points [T, 3] of tracks by their calibrated cameras, NaN where their rays do not meet, and their largest errors [T] in
        pixels."""
        xyz, errors = np.full((len(tracks), 3), np.nan), np.zeros(len(tracks))
        seen = [(k, (moment, view), row) for k, (moment, rows) in enumerate(tracks) for view, row in rows.items()]
        if not seen:
            return xyz, errors
        track, numbers = np.array([k for k, _, _ in seen]), {key: number for number, key in enumerate(self.features)}
        picture = np.array([numbers[key] for _, key, _ in seen])
        pixels = np.array([self.features[key].places[row] for _, key, row in seen], np.float64)
        turns, centres = (np.array(each)[picture] for each in zip(*(self._rays[key] for key in numbers)))
        rays = (turns @ np.c_[pixels, np.ones(len(pixels))][..., None])[..., 0]
        across = np.eye(3) - rays[:, :, None] * rays[:, None] / (rays * rays).sum(1)[:, None, None]
        system, right = np.zeros((len(tracks), 3, 3)), np.zeros((len(tracks), 3))  # of the point that is nearest to a track's rays
        np.add.at(system, track, across)
        np.add.at(right, track, (across @ centres[..., None])[..., 0])
        meet = np.linalg.cond(system) <= 1e7
        xyz[meet] = np.linalg.solve(system[meet], right[meet][..., None])[..., 0]
        away = np.empty(len(seen))
        for number, each in enumerate(self.features.values()):
            ours = picture == number
            away[ours] = np.linalg.norm(each.camera.pixels(each.camera.local(xyz[track[ours]])) - pixels[ours], axis=1)
        np.maximum.at(errors, track, np.nan_to_num(away, nan=np.inf))  # NaN: behind the camera
        xyz[errors == np.inf] = np.nan
        return xyz, errors

    def good_points(self, without: Sequence[str] = ()) -> np.ndarray:
        """Points [P, 3] on which at least two cameras agree."""
        tracks = self.all_tracks(without)
        xyz, errors = self.points(tracks[:: max(1, -(-len(tracks) // MOST_POINTS))])
        return xyz[errors < CLOSE]


def matched(samples: Mapping[str, Sequence], posed: bool, progress: Callable[[float], None] = lambda share: None) -> Matches:
    """The matches of the pictures that were looked at; raises FastGSError where pycolmap is not installed.

    samples   samples.Sample by view; posed: whether they have cameras
    """
    pycolmap = features.pycolmap_module()
    extract = features.extractor()
    by_frame: dict[int, list] = {}
    for each in samples.values():
        for sample in each:
            by_frame.setdefault(sample.shot.frame, []).append(sample)
    frames = [frame for frame, group in sorted(by_frame.items()) if len(group) > 1]
    frames = spread(frames, int(np.clip(PICTURES // max(len(samples), 1), 1, MOMENTS)))
    chosen = [(frame, sample) for frame in frames for sample in by_frame[frame]]
    found, kept = {}, {}
    for done, (frame, sample) in enumerate(chosen):
        progress(0.8 * done / len(chosen))
        places, descriptors = extract(sample.rgb / np.float32(255))
        good = np.ones(len(places), bool)
        if sample.valid is not None:
            x, y = (np.clip(places[:, k].astype(int), 0, sample.valid.shape[1 - k] - 1) for k in (0, 1))
            good = sample.valid[y, x]
        rows = np.flatnonzero(good)
        rows = rows[:: max(1, -(-len(rows) // MOST_FEATURES))]
        found[frame, sample.shot.view] = features.Features(places[rows], descriptors[rows], sample.camera)
        kept[frame, sample.shot.view] = sample
    alone = {key: features.alone(each) for key, each in found.items()}
    todo = [(frame, a, b) for frame in frames for a, b in neighbours({s.shot.view: s.camera for s in by_frame[frame]}, posed)]
    pairs = []
    for done, (frame, a, b) in enumerate(todo):
        progress(0.8 + 0.2 * done / len(todo))
        one, other = found[frame, a], found[frame, b]
        rows = features.distinct(features.matches(one, other, np.inf), one, other, alone[frame, a], alone[frame, b])
        pair = _pair(pycolmap, frame, a, b, one, other, rows, posed)
        pairs += [pair] if pair else []
    progress(1.0)
    return Matches(found, kept, pairs, len(todo))


def _pair(pycolmap: ModuleType, moment: int, a: str, b: str, one: Any, other: Any, rows: np.ndarray, posed: bool) -> Pair | None:
    if len(rows) < LEAST:
        return None
    options = pycolmap.RANSACOptions()
    options.max_error, options.random_seed, options.max_num_trials = AGREE, 1, 5000
    tried = len(rows)
    result = pycolmap.estimate_fundamental_matrix(one.places[rows[:, 0]], other.places[rows[:, 1]], options)
    if result is None:
        return None
    rows = rows[np.asarray(result["inlier_mask"], bool)]
    if len(rows) < max(LEAST, LEAST_SHARE * tried):
        return None
    distance = np.full(len(rows), np.nan)
    if posed:
        given = features.fundamental(one.camera, other.camera)
        distance = np.mean([off_lines(given, one.places[rows[:, 0]], other.places[rows[:, 1]]),
                            off_lines(given.T, other.places[rows[:, 1]], one.places[rows[:, 0]])], 0)
    return Pair(moment, a, b, rows, distance)


def off_lines(matrix: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distances [M] of the places b [M, 2] from the lines that the fundamental matrix gives for the places a."""
    lines = np.c_[a, np.ones(len(a))] @ matrix.T
    return np.abs((lines * np.c_[b, np.ones(len(b))]).sum(1)) / np.maximum(np.linalg.norm(lines[:, :2], axis=1), 1e-12)


def neighbours(cameras: Mapping[str, Any], posed: bool) -> list[tuple[str, str]]:
    """Pairs of views that may show the same: each with those that stand and look most alike, or with the next in order without poses."""
    views = list(cameras)
    if not posed:
        return [(a, b) for i, a in enumerate(views) for b in views[i + 1:i + 1 + features.NEIGHBOURS]]
    return [(views[i], views[j]) for i, j in features.neighbours(cameras.values())]

# SPDX-License-Identifier: GPL-3.0-or-later
"""Object tracks of `.4dgs`: rigid motion of whole objects, applied to what their Gaussians do by themselves.

A pose in between two samples lies on the shortest arc.  The model holds a table of positions and rotations at times that are close
enough for straight lines between them to stay within ERROR.
"""
import math
from dataclasses import dataclass

import numpy as np

from ..model.motion import Keyframes
from ..util import rotations
from ..util.errors import FastGSError
from ..util.reading import damaged_if
from .base import LIMIT
from .fourdgs_streams import Cursor
from .straight import Timeline

ERROR = 2e-5
"""Of positions, in the file's unit of length."""
JUMP = 1e-6
"""Of t: how long the step from one pose to the next one takes where a track steps."""
LARGEST = 50_000_000
"""Numbers of a table: Gaussians times moments."""
SAMPLE = np.dtype([("time", "<f8"), ("rotation", "<f8", 4), ("translation", "<f8", 3)])


@dataclass(frozen=True, eq=False)
class Track:
    """The poses of one object: time [S] in seconds, rotation [S, 4] w x y z, translation [S, 3]; steps: each is held until the next."""

    name: int
    steps: bool
    time: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray

    def pose(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotations [T, 4] and translations [T, 3] at times [T]; the nearest sample beside the track."""
        at = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, len(self.time) - 1)
        after = np.minimum(at + 1, len(self.time) - 1)
        length = self.time[after] - self.time[at]
        share = np.clip(np.divide(time - self.time[at], length, out=np.zeros(len(time)), where=length > 0), 0, 1)[:, None]
        if self.steps:
            share = np.zeros_like(share)
        first, second = self.rotation[at], self.rotation[after]
        second = np.where((first * second).sum(1, keepdims=True) < 0, -second, second)
        return rotations.slerp(first, second, share), (1 - share) * self.translation[at] + share * self.translation[after]


def read(content: Cursor) -> Track | None:
    """A track from its record; None for one without samples.  Raises FastGSError."""
    name, interpolation, count = content.unpack("IBI")
    samples = np.frombuffer(content.take(count * SAMPLE.itemsize), SAMPLE)
    with np.errstate(all="ignore"):
        norm = np.linalg.norm(samples["rotation"], axis=1, keepdims=True)
        good = np.all(np.abs(samples["time"]) < 1e6) and np.all(np.diff(samples["time"]) > 0)
        good = good and np.all(np.abs(samples["translation"]) < LIMIT) and np.isfinite(norm).all() and (norm > 0).all()
    damaged_if(not (good and name and interpolation in (0, 1)), f"the track of its object {name} is damaged")
    return Track(name, interpolation == 1, samples["time"], (samples["rotation"] / norm)[:, [3, 0, 1, 2]], samples["translation"]) \
        if count else None


def follow(lives: dict, rotation: np.ndarray, objects: np.ndarray, tracks: list[Track], timeline: Timeline) -> dict:
    """straight()'s arrays and rotation [N, 4], with the tracks of objects [N] applied: keyword arguments for GaussianModel."""
    tracks = [track for track in tracks if (objects == track.name).any()]
    if not tracks:
        return lives | {"rotation": rotation}
    position, motion = lives["position"].astype(np.float64), lives["motion"][:, 0].astype(np.float64)
    mu = lives["mu_tau"].astype(np.float64)
    begin, end = lives["temporal"][:, 1], lives["temporal"][:, 2]
    ends = (max(-1.0, float(min(begin.min(initial=0), 0))), min(2.0, float(max(end.max(initial=1), 1))))
    reach = np.linalg.norm(position, axis=1) + np.linalg.norm(motion, axis=1) * (ends[1] - ends[0] + np.abs(mu))
    reach = [float(reach[(objects == track.name) & (reach < LIMIT)].max(initial=0)) for track in tracks]
    times = _moments(tracks, reach, timeline, ends)
    if len(times) * len(position) > LARGEST:
        raise FastGSError(f"its {len(tracks)} object tracks need {len(times)} moments for {len(position)} Gaussians, which is too much; "
                          "export it with the motion in its Gaussians.")
    places = position + motion * (times[:, None, None] - mu[:, None])
    turns = np.broadcast_to(rotations.unit(rotation.astype(np.float64)), (len(times), len(position), 4)).copy()
    for track in tracks:
        mine = objects == track.name
        turn, shift = track.pose(timeline.zero + timeline.length * times)
        places[:, mine] = places[:, mine] @ rotations.to_matrices(turn).transpose(0, 2, 1) + shift[:, None]
        turns[:, mine] = rotations.one_sign(rotations.multiply(turn[:, None], turns[:, mine]))
    basis = Keyframes(tuple(times))
    return lives | {
        "basis": basis, "position": places[0].astype(np.float32), "motion": (places - places[0]).transpose(1, 0, 2).astype(np.float32),
        "rotation_basis": basis, "rotation": turns[0].astype(np.float32),
        "rotation_motion": (turns - turns[0]).transpose(1, 0, 2).astype(np.float32)}


def _moments(tracks: list[Track], reach: list[float], timeline: Timeline, ends: tuple[float, float]) -> np.ndarray:
    """Times t, so many that straight lines between them follow every track; reach: of each track's Gaussians, from the origin."""
    moments = [np.array(ends)]
    for track, radius in zip(tracks, reach):
        t = timeline.t(track.time)
        if track.steps:
            moments += [t, t - JUMP]
            continue
        moments.append(t)
        angle = 2 * np.arccos(np.clip(np.abs((track.rotation[1:] * track.rotation[:-1]).sum(1)), 0, 1))
        pieces = np.ceil(angle * math.sqrt(max(radius, 1.0) / (8 * ERROR)))
        if pieces.sum() > LARGEST:
            raise FastGSError(f"the track of its object {track.name} turns too far; export it with the motion in its Gaussians.")
        moments += [np.linspace(a, b, int(n) + 1) for a, b, n in zip(t[:-1], t[1:], pieces) if n > 1]
    times = np.unique(np.concatenate(moments))
    return times[np.concatenate([[True], np.diff(times) > 1e-9])]


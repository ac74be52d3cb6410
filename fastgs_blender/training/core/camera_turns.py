# SPDX-License-Identifier: GPL-3.0-or-later
"""Refines where each camera looks during training.

A camera is turned by a small rotation w [3] in radians, in its own axes, so that a camera that moves in the clip has one correction too.
It is found as clocks are (camera_response.py), in closed form, by Gauss-Newton steps over the latest pictures of each camera.  The change
of a picture with the turn needs no further render: what lies in the direction (a, b, 1) moves by

    da = -a b wx + (1 + a^2) wy - b wz
    db = -(1 + b^2) wx + a b wy + a wz

and the picture changes by its own slope times that (Lucas and Kanade 1981).  Every backend can do it, as it takes a picture alone.
Shifts are not estimated: they look so much like turns that a model which is not exact makes both wrong.

A turn of all cameras together cannot be told from one of the model, so it stays zero on average: held-out cameras stay where they are.

With the setting auto, only cameras turn that held-back tracks of features showed to be wrong (initial/refine.py), and no farther than these
are unsure of: a poor model, or one seen by few cameras, is sure of wrong turns.
"""
from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...cameras.camera import Camera
from ...cameras.poses import turned
from ...captures.capture import Shot
from .camera_response import ALIKE_PIXELS, KEEP, OUTLIER, SETTLED, SOLID
from .targets import Target

FIRST, LAST = 0.05, 0.9
"""The part of a run, by its share of steps, in which poses are estimated: from small pictures on, where a turn is a small part of what they
show, until the model needs its last steps to settle."""
EVERY = 4
"""Steps between two estimates."""
FARTHER = 1.7
"""Over-relaxation of a correction: the model has already followed the camera's wrong pose a part of the way."""
PRIOR = np.radians(0.2)
"""Standard deviation of a camera's turn about each axis, as a prior."""
FARTHEST = np.radians(2.0)
"""The largest turn that training corrects."""
NOTICED = 0.4
"""Pixels by which a turn moves a picture, below which poses count as right where the settings say auto."""
LOOKED_AT = 20_000
"""Pixels of a picture that are compared, about: enough for three numbers, and little work."""


SHAPES = {"turns": (3,), "turn_sums": (14,), "turn_limits": ()}
"""Of one camera, the arrays that a checkpoint holds; all are float64."""


@dataclass(eq=False)
class CameraTurns:
    """The turns of V cameras, and the sums that they are estimated from.

    views    their names;  setting: the setting `poses`;  focal [V] in pixels
    axes     [V, 3, 3] world to camera, of each view's first camera
    turns    [V, 3] as estimated
    turn_limits  [V] the largest turn of each, in radians
    turn_sums  [V, 14] over pixels and channels: w J J' [3, 3], w J (r + J turn) [3], w r^2, w; J the change of the picture with the turn,
             r the target minus the picture
    """

    views: tuple[str, ...]
    setting: str
    focal: np.ndarray
    axes: np.ndarray
    turns: np.ndarray
    turn_sums: np.ndarray
    turn_limits: np.ndarray

    @classmethod
    def initial(cls, shots: list, setting: str, unsure: Mapping[str, float] = {}) -> CameraTurns:
        """The state at the first step of training on these shots: no turns.  Parallel projections are left as they are.

        unsure  by view: radians that it may be turned by where the setting is auto; others stay
        """
        first = {shot.view: shot.camera for shot in reversed(shots)}
        views = tuple(dict.fromkeys(shot.view for shot in shots))
        possible = len(views) > 1 and not any(camera.orthographic for camera in first.values())
        return cls(views, setting if possible else "off", np.array([abs(first[view].fx) for view in views]),
                   np.array([first[view].world_to_camera[:3, :3] for view in views]), np.zeros((len(views), 3)), np.zeros((len(views), 14)),
                   np.array([FARTHEST if setting == "on" else min(unsure.get(view, 0.0), FARTHEST) for view in views]))

    # what it does to cameras

    @property
    def differ(self) -> bool:
        """Whether cameras are turned: always, never, or (auto) where a turn moves a camera's picture by more than NOTICED."""
        return self.setting == "on" or (self.setting == "auto" and bool((self.focal * np.linalg.norm(self.turns, axis=1)).max() > NOTICED))

    def camera(self, view: str, camera: Camera) -> Camera:
        """A view's camera as it is believed to look."""
        if not self.differ or view not in self.views:
            return camera
        return replace(camera, world_to_camera=turned(camera.world_to_camera, self.turns[self.views.index(view)]))

    # how it is found

    def is_due(self, iteration: int, iterations: int) -> bool:
        """Whether this step's pictures are used to estimate poses; with auto it ends at SETTLED if none has been noticeably wrong."""
        if self.setting == "off" or iteration % EVERY or not FIRST * iterations <= iteration < LAST * iterations:
            return False
        if not self.turn_limits.any():
            return False
        return self.setting == "on" or self.differ or iteration < SETTLED * iterations

    def measure(self, shot: Shot, target: Target, picture: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        """The sums [14] over a shot's pixels that accumulate() takes.

        target   a Target, whose camera made the picture
        picture  [h, w, 3] over its background, and alpha [h, w], as TrainingBackend.over() gives them
        """
        camera, (h, w) = target.camera, alpha.shape
        step = max(1, round(np.sqrt(h * w / LOOKED_AT)))
        y, x = np.ix_(np.arange(1, h - 1, step), np.arange(1, w - 1, step))
        error = target.rgb[y, x] - picture[y, x]
        weight = (alpha[y, x] > SOLID)[..., None] / (1 + (error / OUTLIER) ** 2)
        if target.weight is not None:
            weight = weight * np.minimum(target.weight[y, x], 1)[..., None]
        if target.least is not None:
            weight = weight * ~target.least[y, x]
        across, down = camera.from_middle()
        a = ((across + camera.width / 2 - camera.cx) / camera.fx)[x]
        b = ((down + camera.height / 2 - camera.cy) / camera.fy)[y]
        a, b = (each[..., None] for each in np.broadcast_arrays(a, b))
        right = 0.5 * camera.fx * (picture[y, x + 1] - picture[y, x - 1])
        below = 0.5 * camera.fy * (picture[y + 1, x] - picture[y - 1, x])
        change = np.stack([right * a * b + below * (1 + b * b), -right * (1 + a * a) - below * a * b, right * b - below * a])
        change, weight, error = (each.reshape(-1, weight.size).astype(np.float64) for each in (change, weight, error))
        square, missing = (weight * change) @ change.T, change @ (weight * error)[0]
        if self.differ:
            missing = missing + square @ self.turns[self.views.index(shot.view)]
        return np.concatenate([square.ravel(), missing, [(weight * error**2).sum(), weight.sum()]])

    def accumulate(self, measured: Iterable[tuple[Shot, np.ndarray]]) -> dict[str, np.ndarray]:
        """A step's sums for update(), by name; measured: (shot, measure() of it) of each of its pictures."""
        sums = np.zeros_like(self.turn_sums)
        for shot, each in measured:
            sums[self.views.index(shot.view)] += each
        return {"turn_sums": sums}

    def update(self, turn_sums: np.ndarray) -> None:
        """Add the sums of a step's pictures, over all processes, and estimate anew."""
        for k in np.flatnonzero(turn_sums[:, 13] > 0):
            self.turn_sums[k] = sums = KEEP * self.turn_sums[k] + turn_sums[k]
            pull = ALIKE_PIXELS * sums[12] / sums[13] / PRIOR**2 + 1e-9
            try:
                found = np.linalg.solve(sums[:9].reshape(3, 3) + pull * np.eye(3), sums[9:12])
            except np.linalg.LinAlgError:  # pictures of one edge, far stronger than the pull
                continue
            turn = self.turns[k] + FARTHER * (found - self.turns[k])
            self.turns[k] = _within(turn, self.turn_limits[k])
        known = self.turn_sums[:, 13] > 0
        if turn_sums.any() and 2 * known.sum() > len(known):
            self._take_out_shared_turn(known)

    def _take_out_shared_turn(self, known: np.ndarray) -> None:
        """Take the turn that the known cameras [V] share out of theirs; those that are turned much farther than others count less."""
        turns = np.einsum("vji,vj->vi", self.axes[known], self.turns[known])
        shared = np.median(turns, axis=0)
        for _ in range(3):
            weights = 1 / (1 + ((turns - shared) ** 2).sum(1) / PRIOR**2)
            shared = np.average(turns, axis=0, weights=weights)
        self.turns[known] -= self.axes[known] @ shared
        self.turns = np.array([_within(*each) for each in zip(self.turns, self.turn_limits)])

    def facts(self) -> dict:
        """JSON values of what was found, empty where poses are right."""
        if not self.differ:
            return {}
        return {"poses": {view: np.round(np.degrees(turn), 4).tolist() for view, turn in zip(self.views, self.turns)}}


def _within(turn: np.ndarray, most: float) -> np.ndarray:
    """A rotation vector [3], at most so long."""
    return turn * (most / max(float(np.linalg.norm(turn)), most, 1e-30))

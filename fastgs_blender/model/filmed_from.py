# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimates from where a model was filmed, for files that do not say it.

Reconstructions of what was filmed from one side have their origin among the cameras: where all Gaussians lie to one side of it, that is
the place.  Else the shapes of the Gaussians tell it.  Training learns how far away things are less well than where they are in the
pictures: long Gaussians point at the cameras.  So from about where these stood, long Gaussians are seen end-on.  The estimate is the
place from which the mean squared cosine between their longest axes and the directions to them is largest.  Axes that point anywhere give
1/3 from everywhere, parallel ones the same from both sides.
"""
from collections.abc import Callable

import numpy as np

from ..util.rotations import to_matrices
from .framing import is_subject, without_backdrop
from .gaussians import GaussianModel
from .slicing import slice_model

BAKED = "baked mesh"
"""The source that the provenance of a baked model names: nobody has filmed it, and all of its sides are there."""
FORWARD = 0.6
"""If the mean of the unit directions from the origin to the Gaussians is longer than this, all of them lie to one side of it."""
LONG = 2.0
"""A Gaussian is long whose longest axis is so many times the second."""
FEWEST, MOST = 500, 4000
"""Long Gaussians that the estimate needs, and that it uses."""
LOOKED_AT = 20_000
"""Gaussians among which they are looked for."""
DIRECTIONS, STEPS, ROUNDS = 200, 24, 6
"""Places around the model that are tried at each distance; then, around the best one and the one opposite, in each round of smaller
and smaller steps."""
HEIGHT = 0.6
"""Sine of the largest angle above and below the model: what stands upright, such as hair or grass, is seen end-on from above, and what
stands on the ground may have its origin between its feet."""
DISTANCES = (1.0, 1.5, 2.0, 3.0, 5.0)
"""Tried distances from the model's middle, in median distances of its Gaussians from there."""
OUTSIDE = 1.5
"""The nearest that counts: of cameras that stood amid the Gaussians none is a good place."""
CLEAR, ONE_SIDED = 0.04, 0.004
"""By how much the mean squared cosine is above its median of all places, and above that of the best place on the other side."""


def filmed_from(model: GaussianModel, t: float, up: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """About where the cameras stood that filmed a model, and the middle of what they filmed, [3] each; None where nothing tells.

    t   when it is looked at
    up  [3] unit vector, the model's direction upwards
    The same model gives the same place.
    """
    if model.provenance.get("source") == BAKED:
        return None
    inside = without_backdrop(model)
    rng = np.random.default_rng(0)
    if len(inside) > LOOKED_AT:
        inside = inside.take(np.sort(rng.choice(len(inside), LOOKED_AT, replace=False)))
    now = slice_model(inside, t)
    sizes = np.sort(now.scale, axis=1)
    subject = is_subject(now.position)
    if not subject.any():
        return None
    middle = np.median(now.position[subject], axis=0)
    size = np.median(np.linalg.norm(now.position[subject] - middle, axis=1))
    if one_sided(now.position[subject], up) and OUTSIDE * size < np.linalg.norm(middle) < DISTANCES[-1] * size:
        return np.zeros(3), middle
    long = np.flatnonzero(subject & (sizes[:, 2] > LONG * sizes[:, 1]))
    if len(long) < FEWEST:
        return None
    long = rng.choice(long, min(len(long), MOST), replace=False)
    places = now.position[long]
    axes = to_matrices(now.rotation[long])[np.arange(len(long)), :, now.scale[long].argmax(1)]

    places = places - middle
    across, squares = (places * axes).sum(1)[:, None], (places**2).sum(1)[:, None]

    def end_on(eyes: np.ndarray) -> np.ndarray:
        """The mean squared cosine [E] from eyes [E, 3], which are told from the middle."""
        away = squares - 2 * places @ eyes.T + (eyes**2).sum(1)
        return ((across - axes @ eyes.T) ** 2 / np.maximum(away, 1e-9 * size**2)).mean(0)

    around = directions(DIRECTIONS)
    around = around[np.abs(around @ np.asarray(up, np.float64)) < HEIGHT]
    tried = (size * np.array(DISTANCES)[:, None, None] * around).reshape(-1, 3)
    found = end_on(tried)
    first = tried[found.argmax()]
    sides = np.array([_best(end_on, start, float(np.linalg.norm(first)) / 2) for start in (first, -first)])
    worse, better = np.sort(end_on(sides))
    eye = sides[end_on(sides).argmax()]
    clear = better > max(np.median(found) + CLEAR, worse + ONE_SIDED)
    return (middle + eye, middle) if clear and np.linalg.norm(eye) > OUTSIDE * size else None


def one_sided(position: np.ndarray, up: np.ndarray) -> bool:
    """Whether positions [M, 3] lie to one side of the origin, neither above nor below it."""
    ahead = mean_direction(position)
    return bool(np.linalg.norm(ahead) > max(FORWARD, abs(ahead @ np.asarray(up, np.float64)) / HEIGHT))


def mean_direction(position: np.ndarray) -> np.ndarray:
    """The mean [3] of the unit directions from the origin to positions [M, 3]; it is short where these lie all around."""
    position = position.astype(np.float64)
    return (position / np.maximum(np.linalg.norm(position, axis=1, keepdims=True), 1e-12)).mean(0)


def _best(values: Callable[[np.ndarray], np.ndarray], place: np.ndarray, step: float) -> np.ndarray:
    """The place [3] of the largest value near another one: in each round the best of some around it, if it is better."""
    for _ in range(ROUNDS):
        tried = np.concatenate([place[None], place + step * directions(STEPS)])
        place = tried[values(tried).argmax()]
        step /= 1.7
    return place


def directions(count: int) -> np.ndarray:
    """Unit vectors [count, 3] spread evenly: Fibonacci's sphere."""
    i = np.arange(count) + 0.5
    height, turn = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    flat = np.sqrt(1 - height**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), height], 1)

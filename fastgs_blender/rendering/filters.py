# SPDX-License-Identifier: GPL-3.0-or-later
"""Filters hide Gaussians of a model by their properties (size, opacity, speed, colour ...), the same ones at all times."""
import itertools
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from ..cameras.viewpoints import camera_of
from ..model.appearance import SH, SH_C0, momentary
from ..model.gaussians import GaussianModel
from ..model.slicing import opacities_at, positions_at, sigmoid
from ..util.errors import FastGSError
from .importance import importance_rank
from .masks import unpack_mask

TIMES = 17
"""Moments of the clip at which speeds and lifetimes are looked at."""
CELL = 0.02
"""Edge of the cells in which neighbours are counted, by the size of the model without its outer tenth."""
NOTHING = 0.1
"""Share of a large value up to which smaller ones hardly differ, where values are parted."""


@dataclass(frozen=True)
class Filter:
    """Some Gaussians: those of which a value lies from low to high.

    kind    one of KINDS
    keep    whether only they are shown, rather than all others
    colour  sRGB [3], of the kind "COLOUR"
    """

    kind: str
    low: float = -np.inf
    high: float = np.inf
    keep: bool = False
    colour: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "colour", tuple(float(value) for value in self.colour))
        if self.kind not in KINDS:
            raise FastGSError(f"the filter {self.kind!r} is unknown; there are {', '.join(KINDS)}.")
        if np.isnan((self.low, self.high, *self.colour)).any():
            raise FastGSError(f"the limits and the colour of a filter ({self.kind.lower()}) must be numbers, not NaN.")

    def holds(self, model: GaussianModel) -> np.ndarray:
        """Which Gaussians have a value from low to high: [N] bool."""
        value = values(model, self.kind, self.colour)
        return (value >= self.low) & (value <= self.high)


def _size(model: GaussianModel, _: Any) -> np.ndarray:
    return np.exp(model.scale.astype(np.float64).max(1))


def _opacity(model: GaussianModel, _: Any) -> np.ndarray:
    return sigmoid(model.opacity)


def _speed(model: GaussianModel, _: Any) -> np.ndarray:
    total, weight = np.zeros(len(model)), np.zeros(len(model))
    for t, sigma in _moments(model):
        velocity = model.basis.rate(model.motion, t, model.mu_tau.astype(np.float64))
        total += sigma * np.linalg.norm(velocity, axis=1)
        weight += sigma
    return total / np.maximum(weight, 1e-12) / max(model.clip.duration, 1e-9)


def _lifetime(model: GaussianModel, _: Any) -> np.ndarray:
    return np.sum([sigma >= model.raster.alpha_cut for _, sigma in _moments(model)], 0) / TIMES * model.clip.duration


def _moments(model: GaussianModel) -> Iterator[tuple[float, np.ndarray]]:
    """Yields times of the clip, and the opacities [N] of the Gaussians then."""
    for t in (np.arange(TIMES) + 0.5) / TIMES:
        yield t, opacities_at(model, t)


def base_colours(model: GaussianModel) -> np.ndarray:
    """The colours [N, 3] of Gaussians; of harmonics and decoders their constant part."""
    base = model.features[:, :3].astype(np.float64)
    return 0.5 + SH_C0 * base if isinstance(momentary(model.appearance), SH) else base


def _colour(model: GaussianModel, colour: ArrayLike) -> np.ndarray:
    return np.abs(base_colours(model) - colour).max(1)


def _neighbours(model: GaussianModel, _: Any) -> np.ndarray:
    position = np.nan_to_num(positions_at(model, 0.5))
    low, high = np.percentile(position, (5, 95), axis=0) if len(position) else (np.zeros(3), np.ones(3))
    size = max(CELL * (high - low).max(), 1e-12)
    cell = np.clip(np.floor((position - low) / size), -2**19, 2**19).astype(np.int64) + 2**19
    step = np.array([1, 1 << 21, 1 << 42])
    keys, own, count = np.unique(cell @ step, return_inverse=True, return_counts=True)
    total = np.zeros(len(keys), np.int64)
    for offset in itertools.product((-1, 0, 1), repeat=3):
        at = np.minimum(np.searchsorted(keys, keys + offset @ step), max(len(keys) - 1, 0))
        total += np.where(keys[at] == keys + offset @ step, count[at], 0)
    return (total[own.ravel()] - 1).astype(np.float64)


def _cameras(model: GaussianModel, _: Any) -> np.ndarray:
    """How many of the capture's cameras see each Gaussian [N], at the time at which it is most opaque."""
    best, count = np.full(len(model), -1.0), np.zeros(len(model))
    cameras = [camera_of(viewpoint) for viewpoint in model.surroundings.cameras]
    for t, sigma in _moments(model) if cameras else ():
        at = np.flatnonzero(sigma > best)
        best[at] = sigma[at]
        position = positions_at(model, t, at)
        count[at] = sum(_in_picture(camera, position) for camera in cameras)
    return count


def _in_picture(camera: Any, position: np.ndarray) -> np.ndarray:
    """Whether a camera has points [M, 3] in its picture: [M] bool."""
    view = camera.local(position)
    at = camera.pixels(view)
    return (view[:, 2] > 0) & ((at >= 0) & (at <= (camera.width, camera.height))).all(1)


KINDS: dict[str, Callable] = {
    "SIZE": _size, "OPACITY": _opacity, "SPEED": _speed, "LIFETIME": _lifetime, "COLOUR": _colour, "NEIGHBOURS": _neighbours,
    "CAMERAS": _cameras}
"""What filters look at, each as values [N] of a model.

SIZE        the largest standard deviation, in the model's units
OPACITY     without the temporal factor
SPEED       the mean, weighted by the opacity at each time, in units per second: what a trained Gaussian does unseen does not count
LIFETIME    seconds in which it can be seen
COLOUR      largest difference of a channel from the filter's colour; of harmonics and decoders their constant part counts
CAMERAS     how many cameras of the capture (surroundings.py) have it in their pictures while it is seen best; what hides it from them
            does not count.  0 for all where the file knows no cameras
NEIGHBOURS  how many others are in the cells around it, in the middle of the clip; few are what is called floaters
"""

_values: WeakKeyDictionary = WeakKeyDictionary()
_hidden: WeakKeyDictionary = WeakKeyDictionary()
_lock = threading.Lock()


def values(model: GaussianModel, kind: str, colour: Sequence[float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """The numbers [N] float32 that filters of a kind compare with their limits; cached as long as the model lives."""
    key = kind, tuple(colour) if kind == "COLOUR" else ()
    with _lock:
        found = _values.setdefault(model, {}).get(key)
    if found is None:
        with np.errstate(all="ignore"):
            found = KINDS[kind](model, np.asarray(colour)).astype(np.float32)
        with _lock:
            known = _values.setdefault(model, {})
            for old in [k for k in known if k[0] == kind]:  # of colours the last one is kept
                del known[old]
            known[key] = found
    return found


def parting(value: np.ndarray, weight: np.ndarray | None = None) -> float:
    """The number that parts values [N] >= 0 into small and large ones best (Otsu 1979, of their logarithms).

    weight  [N], how much each counts; None: all count the same

    The largest hundredth counts as one, and what is far less than a tenth of that as nothing.  So slow things are large beside still ones.
    """
    known = np.isfinite(value)
    value, weight = value[known].astype(np.float64), None if weight is None else weight[known]
    if not len(value) or not value.max() > 0:
        return 1.0
    top = np.percentile(value, 99) or value.max()
    least = NOTHING * top
    count, edges = np.histogram(np.log1p(np.minimum(value, top) / least), 256, (0, np.log1p(1 / NOTHING)), weights=weight)
    middle = 0.5 * (edges[1:] + edges[:-1])
    below = np.cumsum(count)[:-1]
    above, total = count.sum() - below, np.cumsum(count * middle)[:-1]
    with np.errstate(all="ignore"):
        gap = total / below - (count @ middle - total) / above
        spread = np.nan_to_num(below * above * gap * gap)
    best = np.flatnonzero(spread >= spread.max() * (1 - 1e-9))  # a gap between the two is parted in its middle
    return float(least * np.expm1(0.5 * (edges[best[0] + 1] + edges[best[-1] + 1])))


def hidden(model: GaussianModel, filters: Sequence[Any], mask: str = "", density: float = 1.0) -> np.ndarray:
    """Which Gaussians filters, a mask and a density hide: [N] bool, or [0] where there are none; the last answer is kept while the
    model lives.  Of a density below 1 the most important Gaussians are left (importance.py).
    """
    if not filters and not mask and density >= 1:
        return np.zeros(0, bool)
    asked = tuple(filters), mask, density
    with _lock:
        known = _hidden.get(model)
    if known is not None and known[0] == asked:
        return known[1]
    out = unpack_mask(mask, len(model))
    for each in filters:
        out |= ~each.holds(model) if each.keep else each.holds(model)
    if density < 1:
        out |= importance_rank(model) >= density
    with _lock:
        _hidden[model] = asked, out
    return out

# SPDX-License-Identifier: GPL-3.0-or-later
"""Sequences: clips that are a model of their own at each moment, read or computed when that moment is shown.

A GaussianModel and a Sequence are both sources: source.moment(t) is the model to slice at t, and the time to slice it at.  Whoever
shows, measures or writes a source asks for the moment first; everything after that knows models alone.
"""
import itertools
import threading
import weakref
from collections import OrderedDict, deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ..util import rotations
from ..util.errors import FastGSError
from .gaussians import Clip, GaussianModel
from .slicing import sigmoid

MEMORY = 384 * 2**20
"""Bytes of models that all sequences together keep in memory; the moment that is shown is kept however large it is."""
AHEAD = 3
"""Moments that are read before they are asked for."""
STRIDE = 4
"""Frames between two moments that follow each other in playback, at most; further apart somebody has jumped."""
PROBES = 4096
"""Gaussians of two frames that are compared."""
NEAR = 0.25
"""Two frames have their Gaussians in one order where these lie nearer to each other than this share of the distance of any two."""
ENDS = 1e-6
"""Of a frame: times that are nearer to it than this are its own."""


class NotRead(FastGSError):
    """Raised for a moment that is not in memory, where the caller does not allow reading it."""


@dataclass(frozen=True)
class FreeClip(Clip):
    """A clip without a frame rate of its own: one frame of it lasts as long as one of whatever plays it."""

    free: ClassVar[bool] = True
    fps: float = 24.0


class Cache:
    """Models of moments, at most `limit` bytes, those used last.  Threads that want one moment wait for one reading of it."""

    def __init__(self, limit: int = MEMORY) -> None:
        self.limit = limit
        self._models: OrderedDict[tuple, tuple[object, GaussianModel]] = OrderedDict()
        self._making: dict[tuple, threading.Lock] = {}
        self._lock = threading.Lock()
        self._gone: deque[int] = deque()

    def get(self, key: tuple, state: object, make: Callable[[], GaussianModel] | None) -> GaussianModel:
        """The model of a key, made if it is not there or was made in another state; raises NotRead where make is None."""
        with self._lock:
            known = self._models.get(key)
            if known is not None and known[0] == state:
                self._models.move_to_end(key)
                return known[1]
            making = self._making.setdefault(key, threading.Lock())
        if make is None:
            raise NotRead("the moment is not read yet.")
        with making:
            with self._lock:
                known = self._models.get(key)
            if known is None or known[0] != state:
                known = state, make()
                self._put(key, known)
        return known[1]

    def _put(self, key: tuple, known: tuple[object, GaussianModel]) -> None:
        with self._lock:
            self._drop()
            self._models[key] = known
            self._models.move_to_end(key)
            self._making.pop(key, None)
            total = sum(model.nbytes for _, model in self._models.values())
            while total > self.limit and len(self._models) > 1:
                total -= self._models.popitem(last=False)[1][1].nbytes

    def drop(self, key: tuple) -> None:
        """Forget the model of a key."""
        with self._lock:
            self._models.pop(key, None)

    def nbytes(self, owner: int | None = None) -> int:
        """Bytes of all models, or of those of one owner."""
        with self._lock:
            self._drop()
            return sum(model.nbytes for key, (_, model) in self._models.items() if owner is None or owner == key[0])

    def forget(self, owner: int) -> None:
        """Drop the models of an owner, the first part of their keys: now, or where a thread is in here, which the collector of garbage may
        have stopped to call this, when the next one comes."""
        self._gone.append(owner)
        if self._lock.acquire(blocking=False):
            try:
                self._drop()
            finally:
                self._lock.release()

    def _drop(self) -> None:
        while self._gone:
            owner = self._gone.popleft()
            for key in [key for key in self._models if key[0] == owner]:
                del self._models[key]


cache = Cache()
_owners = itertools.count()
_reader = ThreadPoolExecutor(1, thread_name_prefix="fastgs-sequence")


def ahead(read: Callable[..., GaussianModel], *given: Any) -> Future:
    """Let read(*given) run in the thread that reads ahead."""
    return _reader.submit(read, *given)


class Sequence:
    """A clip of models.

    clip    its time line: t = f / frame_count at frame f; a FreeClip where no frame rate is known
    at      [F] the frames that there is a model for, increasing; other frames show the nearest of these, or what lies between two
            where their Gaussians match
    read    read(i) -> the model of frame at[i], which does not change in time; safe to call from any thread
    state   state(i) -> a value that changes when that model's file does
    about   for error messages: what the frames come from
    alike   whether all frames are known to hold the same Gaussians in the same order; else their places tell

    Example:
        source = fg.open_source("still_####.ply")
    """

    def __init__(self, clip: Clip, at: np.ndarray, read: Callable[[int], GaussianModel], state: Callable[[int], object] = lambda i: None,
                 about: str = "the sequence", alike: bool = False) -> None:
        self.clip, self.at, self._read, self._state, self.about = clip, np.asarray(at, np.float64), read, state, about
        self._alike = alike
        self._owner = next(_owners)
        self._matches: dict[tuple, bool] = {}
        self._last: int | None = None
        self._ahead: list = []
        weakref.finalize(self, cache.forget, self._owner)
        first = self.frame(0)
        self._count, self.axes, self.colour_space, self.provenance = len(first), first.axes, first.colour_space, first.provenance
        self.surroundings = first.surroundings

    def __len__(self) -> int:
        """The number of Gaussians on the first frame, and of Chapters in all."""
        return self._count

    @property
    def nbytes(self) -> int:
        """Bytes of its models that are in memory."""
        return cache.nbytes(self._owner)

    def frame(self, i: int, read: bool = True) -> GaussianModel:
        """The model of the i-th frame that there is; raises NotRead where it is not in memory and may not be read."""
        state = self._state(i)
        return cache.get((self._owner, i), state, (lambda: self._read(i)) if read else None)

    def moment(self, t: float, hold: bool = False, read: bool = True) -> tuple[GaussianModel, float]:
        """The model to show at t, and the time to slice it at.

        hold  show the nearer frame between two frames, even where their Gaussians match
        read  whether files may be read: else NotRead is raised where that is needed
        """
        i, j, share = self._between(t)
        if read:
            self._look_ahead(i)
        if i == j or hold or not self.matches(i, j, read):
            return self.frame(i if share < 0.5 else j, read), 0.0
        make = (lambda: blended(self.frame(i), self.frame(j), share)) if read else None
        return cache.get((self._owner, i, share), (self._state(i), self._state(j)), make), 0.0

    def _between(self, t: float) -> tuple[int, int, float]:
        """The frames on either side of t, and how far it is from the first to the second; twice the same where it is a frame's."""
        place = float(np.clip(t * self.clip.frame_count, self.at[0], self.at[-1]))
        i = min(int(np.searchsorted(self.at, place + ENDS, side="right")) - 1, len(self.at) - 1)
        if place <= self.at[i] + ENDS:
            return i, i, 0.0
        return i, i + 1, float((place - self.at[i]) / (self.at[i + 1] - self.at[i]))

    def matches(self, i: int, j: int, read: bool = True) -> bool:
        """Whether the i-th and the j-th frame hold the same Gaussians in the same order; NotRead as in frame()."""
        if self._alike:
            return len(self.frame(i, read)) == len(self.frame(j, read))  # some may have been left out, because they are not finite
        key = i, self._state(i), self._state(j)
        if key not in self._matches:
            self._matches[key] = match(self.frame(i, read), self.frame(j, read))
        return self._matches[key]

    def _look_ahead(self, i: int) -> None:
        """Let the frames be read that come next if playback goes on as it does."""
        step = 0 if self._last is None else i - self._last
        if step == 0 and self._last is not None:
            return
        self._last = i
        for task in self._ahead:
            task.cancel()
        steps = range(1, AHEAD + 1) if 0 < abs(step) <= STRIDE else ()
        self._ahead = [ahead(self.frame, (i + step * k) % len(self.at)) for k in steps]

    def __repr__(self) -> str:
        return f"Sequence({self.about}, {len(self.at)} frames, {self.clip!r})"


class Computed(Sequence):
    """A clip whose models are computed at any time t, by compute(t): a network's, or a formula's that no basis of time holds.

    state  state() -> a value that changes when the files do that it is computed from
    """

    def __init__(self, clip: Clip, compute: Callable[[float], GaussianModel], state: Callable[[], object] = lambda: None,
                 about: str = "the model") -> None:
        self._compute = compute
        super().__init__(clip, np.arange(clip.frame_count), lambda i: compute(clip.t_of_frame(i)), lambda i: state(), about)

    def moment(self, t: float, hold: bool = False, read: bool = True) -> tuple[GaussianModel, float]:
        """As Sequence.moment(); exact between frames, which `hold` does not change."""
        t = float(t)
        return cache.get((self._owner, "t", t), self._state(0), (lambda: self._compute(t)) if read else None), 0.0


def match(a: GaussianModel, b: GaussianModel) -> bool:
    """Whether two models of a moment are the same Gaussians in the same order, as far as their places tell."""
    kinds = [(m.appearance, m.axes, m.colour_space, m.raster) for m in (a, b)]
    if len(a) != len(b) or not len(a) or kinds[0] != kinds[1]:
        return False
    chosen = np.linspace(0, len(a) - 1, min(len(a), PROBES)).astype(int)
    first, second = a.position[chosen].astype(np.float64), b.position[chosen].astype(np.float64)
    own = np.median(np.linalg.norm(first - second, axis=1))
    other = np.median(np.linalg.norm(first - np.roll(second, len(chosen) // 2, axis=0), axis=1))
    return bool(own <= NEAR * other)


def blended(a: GaussianModel, b: GaussianModel, share: float) -> GaussianModel:
    """The model between two models that match: linear in places, ln of sizes, opacities and colours; rotations the shorter way."""
    def mixed(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return first + np.float32(share) * (second - first)

    turn = np.where(np.sum(a.rotation * b.rotation, 1, keepdims=True) < 0, -b.rotation, b.rotation)
    odds = np.clip(mixed(sigmoid(a.opacity), sigmoid(b.opacity)), 1e-7, 1 - 1e-7)
    return replace(a, position=mixed(a.position, b.position), scale=mixed(a.scale, b.scale), features=mixed(a.features, b.features),
                   rotation=mixed(rotations.unit(a.rotation), rotations.unit(turn)), opacity=np.log(odds / (1 - odds)))


Source = GaussianModel | Sequence

# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene of a `.4dgs` file while it is read, its Gaussians still in integers, and its two temporal models.

gaussian-birth has all Gaussians in chunks.  keyframe-delta has states of a population, each a change of an earlier one: a state holds over
its own interval, and what holds unchanged over several becomes one Gaussian with a window.
"""
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..util.errors import FastGSError
from ..util.reading import damaged_if
from . import fourdgs_streams as wire
from .fourdgs_tracks import Track

COLUMNS = {a: slice(sum(wire.CHANNELS[b] for b in range(a)), sum(wire.CHANNELS[b] for b in range(a + 1))) for a in wire.REQUIRED}
WIDTH = sum(wire.CHANNELS[a] for a in wire.REQUIRED)
FIXED = (wire.SIGMA, wire.FLAGS, wire.WINDOW)
"""What a change may not touch, for the grids of others follow from it."""


@dataclass
class Scene:
    """The contents of a `.4dgs` file while it is read.

    tables  one of the attributes [N, channels] int64 for each chunk, or for all Gaussians of keyframe-delta
    bands   for each table, {band: coefficients [N, 3 (2 band + 1)] 0..255}
    spans   of keyframe-delta: begin and end [N] in seconds of what holds
    room    how many Gaussians there can be, so far as the file's length tells
    """

    duration: float
    cutoff: float
    temporal_model: str
    degree: int
    room: int
    steps: dict[str, float] = field(default_factory=dict)
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    windows: np.ndarray = field(default_factory=lambda: np.zeros((1, 2)))
    axes: str = "RDF"
    tracks: list[Track] = field(default_factory=list)
    tables: list[dict[int, np.ndarray]] = field(default_factory=list)
    bands: list[dict[int, np.ndarray]] = field(default_factory=list)
    spans: tuple[Any, Any] = (-np.inf, np.inf)


def complete(table: dict[int, np.ndarray], count: int, what: str) -> dict[int, np.ndarray]:
    """The table; raises FastGSError where an attribute that every Gaussian has is missing."""
    missing = [wire.NAMES[a] for a in wire.REQUIRED if a not in table]
    damaged_if(missing and count, f"{what} in it has no {', '.join(missing)}")
    return table if count else {a: np.zeros((0, wire.CHANNELS[a]), np.int64) for a in wire.CHANNELS}


def band_of(degree: int, number: int, content: wire.Cursor, count: int) -> np.ndarray:
    """The coefficients [count, 3 (2 number + 1)] of a band; raises FastGSError."""
    damaged_if(not 1 <= number <= max(degree, 1), f"it has band {number} of spherical harmonics, and its degree is {degree}")
    values = wire.stream(content, count, band=True)[1]
    if values is None or values.shape[1] != 3 * (2 * number + 1) or (values.size and (values.min() < 0 or values.max() > 255)):
        raise FastGSError(f"band {number} of its spherical harmonics is damaged; copy or export the file again.")
    return values


class Births:
    """The temporal model gaussian-birth: chunks of Gaussians that have windows of their own."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    def chunk(self, place: int, begin: float, end: float, table: dict[int, np.ndarray], count: int) -> None:
        """A chunk."""
        self.scene.tables.append(complete(table, count, "a chunk"))
        self.scene.bands.append({})
        self.scene.room -= count

    def delta(self, place: int, content: wire.Cursor) -> None:
        """A change, which there cannot be."""
        raise FastGSError("it has a delta chunk, which its temporal model does not know; the file is damaged.")

    def band(self, number: int, content: wire.Cursor) -> None:
        """Spherical harmonics of the chunk before them."""
        bands, count = self.scene.bands[-1], len(self.scene.tables[-1][wire.FLAGS])
        damaged_if(number in bands, f"a chunk in it has band {number} of spherical harmonics twice")
        bands[number] = band_of(self.scene.degree, number, content, count)

    def finish(self) -> None:
        """Nothing is left to do."""


@dataclass
class State:
    """A population: identities [N], sorted; a row of integers for each [N, M]: the attributes, then the bands."""

    place: int
    identity: np.ndarray
    rows: np.ndarray


class States:
    """The temporal model keyframe-delta: reads states in the order of the file, and hands the Gaussians that they make to the scene."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.width = _band(scene.degree + 1).start
        self.first: State | None = None
        self.last: State | None = None
        self.end = 0.0
        self.shown = State(-1, np.zeros(0, np.int64), np.zeros((0, self.width), np.int64))
        self.since = np.zeros(0)
        self.born: np.ndarray | None = None
        self.bands: set[int] = set()
        self.done: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def chunk(self, place: int, begin: float, end: float, table: dict[int, np.ndarray], count: int) -> None:
        """A whole state."""
        self._close()
        self.first = self._open(begin, end, State(place, *self._rows(table, count, "a keyframe")), _named(table, count))

    def delta(self, place: int, content: wire.Cursor) -> None:
        """A state that says what changed against another one: the last keyframe's or the last."""
        self._close()
        begin, end, _, mode, reference, _, _, *counts = content.unpack("ddIBQQHIII")
        codec, size = content.text(), content.number("Q")
        wire.check_room(max(counts), self.scene.room)
        body = wire.unpacked(content.block(), codec, size)
        updates, births, deaths = (wire.streams(body.block(), count, "a delta chunk") for count in counts)
        base = {0: self.first, 1: self.last}.get(mode)
        if base is None or base.place != reference:
            raise FastGSError("a delta chunk refers to a state that is not there; the file is damaged, so copy or export it again.")
        touched = _named(updates, counts[0])
        gone, new = _named(deaths, counts[2]), self._rows(births, counts[1], "a delta chunk")
        damaged_if(len(np.unique(np.concatenate([touched, gone, new[0]]))) != sum(counts), "a delta chunk names a Gaussian twice")
        rows = base.rows.copy()
        self._update(rows, _places(base.identity, touched), updates)
        keep = np.ones(len(rows), bool)
        keep[_places(base.identity, gone)] = False
        identity = np.concatenate([base.identity[keep], new[0]])
        order = np.argsort(identity, kind="stable")
        damaged_if(np.any(np.diff(identity[order]) == 0), "a delta chunk brings a Gaussian to life that lives")
        self._open(begin, end, State(place, identity[order], np.concatenate([rows[keep], new[1]])[order]), _named(births, counts[1]))

    def band(self, number: int, content: wire.Cursor) -> None:
        """Spherical harmonics of those that the last record brought to life."""
        if self.born is None or self.last is None or number in self.bands:
            raise FastGSError("it has spherical harmonics that belong to nothing; the file is damaged.")
        values = band_of(self.scene.degree, number, content, len(self.born))
        self.bands.add(number)
        if number <= self.scene.degree:
            self.last.rows[_places(self.last.identity, self.born), _band(number)] = values

    def finish(self) -> None:
        """Hand over what was found."""
        self._close()
        if abs(self.end - self.scene.duration) > 1e-9 * max(1, self.end):
            raise FastGSError(f"its states end at {self.end:g} s, and the scene at {self.scene.duration:g} s; the file is damaged.")
        self._emit(np.ones(len(self.shown.rows), bool), self.end)
        empty = np.zeros((0, self.width), np.int64), np.zeros(0), np.zeros(0)
        rows, begin, end = (np.concatenate(part) for part in zip(empty, *self.done, strict=True))
        self.scene.tables = [{a: rows[:, columns] for a, columns in COLUMNS.items()}]
        self.scene.bands = [{b: rows[:, _band(b)] for b in range(1, self.scene.degree + 1)}]
        self.scene.spans = begin, end

    def _rows(self, table: dict[int, np.ndarray], count: int, what: str) -> tuple[np.ndarray, np.ndarray]:
        """Identities, sorted, and rows of Gaussians that are given whole."""
        identity = _named(table, count)
        order = np.argsort(identity, kind="stable")
        damaged_if(np.any(np.diff(identity[order]) == 0), f"{what} in it names a Gaussian twice")
        table = complete(table, count, what)
        rows = np.zeros((count, self.width), np.int64)
        for a, columns in COLUMNS.items():
            rows[:, columns] = table[a]
        return identity[order], rows[order]

    def _update(self, rows: np.ndarray, places: np.ndarray, updates: dict[int, np.ndarray]) -> None:
        """Add differences to rows; rotations are said anew."""
        for a, values in updates.items():
            damaged_if(a in FIXED, f"a delta chunk changes attribute {a}, which may not change")
            if a in (wire.OMITTED, wire.ROTATION):
                rows[places, COLUMNS[a]] = values
            elif a in COLUMNS:
                rows[places, COLUMNS[a]] += values
        damaged_if(rows.size and np.abs(rows).max() >= 2**31, "a number in it leaves 32 bits after its changes")

    def _open(self, begin: float, end: float, state: State, born: np.ndarray) -> State:
        """Begin a state; the bands of spherical harmonics of `born`, in the file's order, may still come."""
        if not (abs(begin - self.end) <= 1e-9 * max(1, abs(self.end)) and begin <= end < np.inf):
            raise FastGSError(f"a state in it begins at {begin:g} s where the one before ends at {self.end:g} s; the file is damaged.")
        self.begin, self.end = begin, end
        self.last, self.bands, self.born = state, set(), born
        return state

    def _close(self) -> None:
        """Compare the last state with what was shown before it: what differs ends, and the rest goes on."""
        if self.born is None or self.last is None:
            return
        damaged_if(len(self.born) and self.bands != set(range(1, self.scene.degree + 1)), "bands of spherical harmonics are missing")
        old, new = self.shown, self.last
        place = np.searchsorted(old.identity, new.identity).clip(0, max(0, len(old.identity) - 1))
        same = np.zeros(len(new.identity), bool)
        if len(old.identity) and len(new.identity):
            same = (old.identity[place] == new.identity) & (old.rows[place] == new.rows).all(1)
        ends = np.ones(len(old.identity), bool)
        ends[place[same]] = False
        self._emit(ends, self.begin)
        since = np.full(len(new.identity), self.begin)
        since[same] = self.since[place[same]]
        self.shown, self.since, self.born = State(new.place, new.identity, new.rows.copy()), since, None

    def _emit(self, which: np.ndarray, end: float) -> None:
        if which.any():
            self.done.append((self.shown.rows[which], self.since[which], np.full(which.sum(), end)))


def _band(number: int) -> slice:
    """The columns of a band of spherical harmonics in a state's rows."""
    begin = WIDTH + 3 * (number**2 - 1)
    return slice(begin, begin + 3 * (2 * number + 1))


def _named(table: dict[int, np.ndarray], count: int) -> np.ndarray:
    """The identities of a group; raises FastGSError where there are none."""
    if wire.IDENTITY not in table:
        damaged_if(count, "its Gaussians have no identities, which keyframe-delta needs")
        return np.zeros(0, np.int64)
    return wire.identities(table[wire.IDENTITY])


def _places(identity: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Where identities stand in a sorted list; raises FastGSError where one is not in it."""
    place = np.searchsorted(identity, wanted)
    if np.any(place >= len(identity)) or np.any(identity[np.minimum(place, len(identity) - 1)] != wanted):
        raise FastGSError("a change names a Gaussian that does not live; the file is damaged.")
    return place

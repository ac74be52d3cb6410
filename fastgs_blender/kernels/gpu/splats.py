# SPDX-License-Identifier: GPL-3.0-or-later
"""The splats of instances on a GPU: a row for each Gaussian, in several pieces where one buffer would not hold them (128 MiB, if a GPU has
no more).

What goes through all rows is run for one piece after the other.  What takes splats in any order, listing and blending, cannot see several
pieces at once: of a band of the picture, the splats that touch it are gathered in a piece of their own, in their order.  Where these do
not fit either, the band is divided (blend.py).
"""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...cameras.camera import Camera
from ...rendering.instances import ViewedInstance
from ...rendering.layout import Layout
from ...rendering.quantities import Shown
from .device import Buffer, Device
from .guesses import room_for
from .lists import scan, sort
from .scene import Pack, View

NOWHERE = 0xFFFFFFFF
"""The depth of what is not drawn."""
FILLED = 16
"""Numbers that wgsl/fill.wgsl writes at most."""


@dataclass(frozen=True, eq=False)
class Piece:
    """Splats that follow each other, in rows (wgsl/project.wgsl).

    first  number of its first row among those of all pieces
    rows   their number
    quads  4 channels each, of a splat
    """

    a: Buffer
    b: Buffer
    channels: Buffer
    depths: Buffer
    first: int
    rows: int
    quads: int

    @classmethod
    def empty(cls, device: Device, first: int, rows: int, quads: int) -> Piece:
        """Rows that are not initialised; raises TooLarge."""
        a, b, channels, depths = (device.buffer(numbers * rows) for numbers in (4, 4, 4 * quads, 1))
        return cls(a, b, channels, depths, first, rows, quads)

    @property
    def arrays(self) -> tuple[tuple[Buffer, int], ...]:
        """The buffers, each with the numbers of a row."""
        return (self.a, 4), (self.b, 4), (self.channels, 4 * self.quads), (self.depths, 1)


@dataclass(frozen=True, eq=False)
class Splats:
    """The splats of instances, in the order of their Gaussians; there is always a piece, if only one without rows."""

    pieces: list[Piece]

    @property
    def rows(self) -> int:
        """Their number."""
        return self.pieces[-1].first + self.pieces[-1].rows

    @property
    def quads(self) -> int:
        """4 channels each, of a splat."""
        return self.pieces[0].quads

    def piece_of(self, row: int) -> Piece:
        """The piece that holds a row."""
        return next(piece for piece in self.pieces if row < piece.first + piece.rows)

    def drawn(self, device: Device) -> int:
        """How many of them are drawn; waits for the device."""
        return sum(int((device.read(piece.depths, np.uint32, piece.rows) != NOWHERE).sum()) for piece in self.pieces)


def project(device: Device, instances: list[ViewedInstance], camera: Camera, layout: Layout, found: list[list[Pack]],
            then: Callable[[Piece], None] = lambda piece: None) -> Splats:
    """The splats of all instances; found: the packs of each one's model.  A pack's splats lie in one piece.

    then  is called with each piece
    """
    quads, views = -(-layout.channels // 4), [View(device, instance, camera, layout) for instance in instances]
    groups: list[list[tuple[View, Pack]]] = [[]]
    most, rows = device.binding // (16 * quads), 0
    for view, packs in zip(views, found, strict=True):
        for pack in packs:
            if groups[-1] and rows + pack.count > most:
                groups.append([])
                rows = 0
            groups[-1].append((view, pack))
            rows += pack.count
    pieces: list[Piece] = []
    for parts in groups:
        first = pieces[-1].first + pieces[-1].rows if pieces else 0
        piece, done = Piece.empty(device, first, sum(pack.count for _, pack in parts), quads), 0
        for view, pack in parts:
            device.run("project", pack.count, view.parameters(pack, done, 4 * quads), pack.buffer, view.extra, view.hidden,
                       piece.a, piece.b, piece.channels, piece.depths, BENDS=bool(view.instance.settings.bends))
            done += pack.count
        if layout.quantities:
            _fill(device, piece, parts, layout)
        then(piece)
        pieces.append(piece)
    return Splats(pieces)


def _fill(device: Device, splats: Piece, parts: list[tuple[View, Pack]], layout: Layout) -> None:
    """Write the layout's quantities into the channels: what all Gaussians of an instance have in common on the device, and what each has
    for itself, with a read-back, by array code that serves every backend."""
    own = {name: quantity for name, quantity in layout.quantities.items() if quantity.same is None or quantity.width > FILLED}
    done = 0
    for view, pack in parts:
        for name, quantity in layout.quantities.items():
            if quantity.same is not None and name not in own:
                values = np.zeros(FILLED, np.float32)
                values[:quantity.width] = quantity.same(view.instance)
                job = [[pack.count, done, 4 * splats.quads, layout.places[name].start], [quantity.width, 0, 0, 0], values]
                device.run("fill", pack.count, job, splats.channels)
        done += pack.count
    if not own:
        return
    seen = device.read(splats.depths, np.uint32, splats.rows) != NOWHERE
    channels = device.read(splats.channels, np.float32, 4 * splats.quads * splats.rows).reshape(splats.rows, -1).copy()
    done = 0
    for view, pack in parts:
        index = np.flatnonzero(seen[done:done + pack.count])
        shown = Shown(view.instance, pack.first + index)
        for name, quantity in own.items():
            channels[done + index, layout.places[name]] = quantity.of(shown)
        done += pack.count
    device.write(splats.channels, channels)


def front_to_back(device: Device, splats: Splats) -> Buffer:
    """The rows of splats by their depths, of which the bits are sorted; what is not drawn comes last."""
    keys = device.buffer(splats.rows)
    for piece in splats.pieces:
        device.copy(piece.depths, keys, piece.rows, 0, piece.first)
    return sort(device, keys, counted(device, splats.rows), splats.rows, 32)[1]


def counted(device: Device, number: int) -> Buffer:
    """The numbers 0, 1, 2 ..."""
    rows = device.buffer(number)
    device.run("iota", number, [[number, 0, 0, 0]], rows)
    return rows


def gathered(device: Device, order: Buffer, splats: Splats, grid: tuple[int, int, int, int], guess: bool) -> tuple[Piece, Buffer]:
    """The splats that touch a grid of tiles, in their order, and the row of each; raises TooLarge.

    guess  whether their number may be guessed (guesses.py): rows that are left over are not drawn; else it is read back
    """
    places = device.buffer(splats.rows + 1)
    device.clear(places)
    for piece in splats.pieces:
        job = [list(grid), [splats.rows, piece.first, piece.rows, 0]]
        device.run("touch", splats.rows, job, order, piece.depths, piece.a, piece.b, places)
    scan(device, places, splats.rows + 1)
    room, guessed = room_for(device, ("splats", grid), min(device.binding // (16 * splats.quads), splats.rows), guess,
                             lambda: int(device.read(places, np.uint32, 1, splats.rows)[0]), "splats")
    found, rows = Piece.empty(device, 0, room, splats.quads), device.buffer(room)
    for piece in splats.pieces:
        for (values, numbers), (copies, _) in zip(piece.arrays, found.arrays, strict=True):
            device.run("gather", splats.rows, [[splats.rows, piece.first, piece.rows, numbers]], order, places, values, copies)
    longest = device.buffer(1) if guessed is None else guessed.longest
    device.run("gather_rows", splats.rows, [[splats.rows, room, 0, 0]], order, places, rows, found.depths, longest, device.spilled)
    return found, rows

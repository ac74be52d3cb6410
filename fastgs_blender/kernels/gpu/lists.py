# SPDX-License-Identifier: GPL-3.0-or-later
"""Prefix sums, radix sort, and the tile lists on a GPU: the splats that touch each tile, front to back."""
from dataclasses import dataclass
from typing import Any

import numpy as np

from .device import Array, Buffer, Device, TooLarge
from .guesses import room_for
from .shaders import TILE

BLOCK = 2048
"""Numbers that a workgroup scans at once."""
KEYS = 1024
"""Keys that a workgroup sorts."""
DIGIT = 8
"""Bits by which a pass of a sort sorts."""
ENTRIES = 1 << 25
"""Entries of tile lists held at once; a picture with more is drawn in bands."""
TILES = 1 << 18
"""Tiles drawn at once, so that a workgroup's counts stay below 2^32."""


def scan(device: Device, values: Buffer, count: int) -> None:
    """Exclusive prefix sums of `count` integers, in place."""
    if not count:
        return
    blocks = -(-count // BLOCK)
    sums = device.buffer(blocks)
    device.run("scan_block", blocks, [[count, BLOCK, 0, 0]], values, sums, groups=True)
    if blocks > 1:
        scan(device, sums, blocks)
        device.run("scan_add", count, [[count, 0, 0, 0]], values, sums)


def sort(device: Device, keys: Buffer, values: Buffer, count: int, bits: int) -> tuple[Buffer, Buffer]:
    """Keys of so many bits in their order, and each one's value; equal keys keep theirs.  Both buffers are written to."""
    if not count:
        return keys, values
    blocks, digits = -(-count // KEYS), 1 << DIGIT
    together = min(max(BLOCK // blocks, 1), digits)  # digits whose counts a workgroup scans as one row
    others = device.buffer(count), device.buffer(count)
    counts, totals = device.buffer(digits * blocks), device.buffer(digits)
    device.clear(totals)
    for shift in range(0, bits, DIGIT):
        job = [[count, shift, blocks, together]]
        device.run("sort_count", blocks, job, keys, counts, groups=True)
        device.run("scan_block", -(-digits // together), [[digits * blocks, together * blocks, 0, 0]], counts, totals, groups=True)
        device.run("sort_scatter", blocks, job, counts, totals, keys, values, *others, groups=True)
        (keys, values), others = others, (keys, values)
    return keys, values


@dataclass(frozen=True, eq=False)
class TileLists:
    """The splats of each tile of a grid, front to back.

    grid     first tile in x and y of the image, columns, rows
    lists    [tiles + 1 + entries]: where in it each tile's list begins and the last one ends, and then the lists: rows of splats
    values   of each entry: which it is among the entries of its splat and of those before it; runs [splats + 1] says where these begin
    entries  their number; the room for them, where it was guessed
    """

    grid: tuple[int, int, int, int]
    lists: Array
    values: Buffer
    runs: Buffer
    entries: int


def list_tiles(device: Device, order: Buffer, splats: Any, grid: tuple[int, int, int, int], most: int, guess: bool = False,
               only: tuple[Array, int] | None = None) -> TileLists:
    """The lists of a grid of tiles for splats (splats.Piece) in their order; raises TooLarge where they have over `most` entries.

    guess  whether their length may be guessed (guesses.py); else it is read back
    only   numbers of tiles, and which of them is that of the grid's first tile: a tile whose number is 0 gets an empty list
    """
    count, tiles = splats.rows, grid[2] * grid[3]
    if tiles > TILES:
        raise TooLarge(f"a picture of {tiles} tiles is more than it draws at once")
    runs = device.buffer(count + 1)
    device.clear(runs)
    wanted, first = (order, 0) if only is None else only
    chosen = {"ALL": only is None}
    device.run("tiles_count", count, [list(grid), [count, 0, first, 0]], order, splats.depths, splats.a, splats.b, wanted, runs, **chosen)
    scan(device, runs, count + 1)
    entries, guessed = room_for(device, ("entries", grid), most, guess, lambda: int(device.read(runs, np.uint32, 1, count)[0]),
                                "tile entries")
    lists = device.zeros((tiles + 1 + entries,), np.uint32)
    keys, owner, values = (device.buffer(entries) for _ in range(3))
    if entries:
        job = [list(grid), [count, entries, first, 0]]
        device.run("tiles_emit", count, job, order, runs, splats.a, splats.b, wanted, keys, owner, values, **chosen)
        if guessed is not None:
            device.run("tiles_pad", entries, [[entries, tiles, count, 0]], runs, keys, values, guessed.longest, device.spilled)
        keys, values = sort(device, keys, values, entries, tiles.bit_length())
        device.run("tiles_ranges", entries + 1, [[entries, tiles, 0, 0]], keys, values, owner, lists)
    return TileLists(grid, lists, values, runs, entries)


def grid_of(window: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """The tiles of a window (x, y, width, height): first in x and y of the image, columns, rows."""
    x0, y0, width, height = window
    left, top = x0 // TILE, y0 // TILE
    return left, top, (x0 + width - 1) // TILE - left + 1, (y0 + height - 1) // TILE - top + 1

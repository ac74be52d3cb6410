# SPDX-License-Identifier: GPL-3.0-or-later
"""Blends splats into a picture on a GPU: lists them by tile and rasterises, in as many bands of rows of tiles as its memory asks for."""
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from ...cameras.camera import Camera
from ...rendering.layout import PROBES
from .device import Array, Buffer, Device, TooLarge
from .holdout import Occluder
from .lists import ENTRIES, TileLists, grid_of, list_tiles
from .shaders import TILE
from .splats import Piece, Splats, counted, gathered


def batch(quads: int) -> int:
    """How many splats of so many quads the threads of a tile read together: as many as fit into WebGPU's 16 KiB, a power of two."""
    return min(1 << (16_000 // (16 * quads + 36)).bit_length() - 1, 256)


@dataclass(frozen=True, eq=False)
class How:
    """How splats are blended.

    probes    which of layout.PROBES are wanted, in their order
    trace     keep what the backward pass needs, instead of probes
    band      alpha fades in over this width above the cut (protocol.TrainingBackend.forward)
    tiles     one number for each tile of the window: only those are drawn whose number is not 0; None: all
    occluder  the triangles of a holdout, or None.  It needs the splats' planes, and so does
    by_pixel  sorting in each pixel (layout.Layout)
    plane     the first channel of these
    core      from which channel to which they are summed over the core of each pixel (layout.py)
    """

    probes: Sequence[str] = ()
    trace: bool = False
    band: float = 0.0
    tiles: Array | None = None
    occluder: Occluder | None = None
    by_pixel: bool = False
    plane: int = 0
    core: tuple[int, int] = (0, 0)
    places: dict[str, int] = field(init=False)
    """Of the probes, and of what a holdout stops, in Band.flat."""

    def __post_init__(self) -> None:
        names = [name for name in PROBES if name in self.probes]
        object.__setattr__(self, "places", {name: 1 + i for i, name in enumerate(names)} | (
            {"held": 1 + len(names), "covered": 2 + len(names)} if self.occluder else {}))

    @property
    def smooth(self) -> dict:
        """The constants of shaders that let alpha fade in."""
        return {"SMOOTH": self.band > 0, "PER_BAND": 1 / self.band if self.band > 0 else 0.0}


@dataclass(frozen=True, eq=False)
class Band:
    """A part of a picture: rows top..bottom of the image.

    channels  [h, w, 4 quads]
    flat      [h, w, P]: alpha, then what How.places says; with a trace: alpha, transmittance, and the place of the last splat
    splats    those that the lists are of, and
    rows      the row of each of these among all, in the order of depth
    """

    top: int
    bottom: int
    channels: Array
    flat: Array
    lists: TileLists
    splats: Piece
    rows: Buffer


def blend_all(device: Device, order: Buffer, splats: Splats, camera: Camera, how: How, progress: Callable[[float], None]) -> list[Band]:
    """Blend splats in their order into the camera's window: in one go, or in as many bands as it takes.  A row of tiles that does not fit
    fails."""
    rows = grid_of(camera.window)[3]
    waiting, bands = [(0, rows)], []
    while waiting:
        first, last = waiting.pop()
        try:
            bands.append(blend(device, order, splats, camera, (first, last), how))
            progress(last / rows)
        except TooLarge:
            if last - first == 1:
                raise
            middle = (first + last) // 2
            waiting += [(middle, last), (first, middle)]
    return bands


def blend(device: Device, order: Buffer, splats: Splats, camera: Camera, rows: tuple[int, int], how: How) -> Band:
    """Blend the splats into the rows of tiles first..last of the camera's window; raises TooLarge."""
    x0, y0, width, height = camera.window
    left, top, columns, _ = grid_of(camera.window)
    first, last = max(y0, (top + rows[0]) * TILE), min(y0 + height, (top + rows[1]) * TILE)
    grid = left, top + rows[0], columns, rows[1] - rows[0]
    entry = 16 * (splats.quads + 2) if how.trace else 4  # bytes: the backward pass has a row of sums for each
    own, piece, guess = order, splats.pieces[0], how.trace and device.guessing
    if len(splats.pieces) > 1:
        piece, own = gathered(device, order, splats, grid, guess)
        order = counted(device, piece.rows)
    lists = list_tiles(device, order, piece, grid, min(ENTRIES, device.binding // entry), guess,
                       None if how.tiles is None else (how.tiles, rows[0] * columns))
    shape, numbers = (last - first, width), 3 if how.trace else 1 + len(how.places)
    if how.trace:
        device.fits(4 * (piece.quads + 1) * shape[0] * width)  # the seeds of the backward pass, and a decoder's slopes are less
    channels, flat = device.empty((*shape, 4 * piece.quads)), device.empty((*shape, numbers))
    cover = lists.lists if how.occluder is None else how.occluder.cover(grid, first, last)
    places = {name.upper(): how.places.get(name, 0) for name in (*PROBES, "held")}
    job = [[x0, first, x0 + width, last], list(grid), [first, numbers, how.plane, 0], [camera.width / 2, camera.height / 2, 0.0, 0.0]]
    inputs = [lists.lists, piece.a, piece.b, piece.channels]
    constants = {"QUADS": piece.quads, "HOLDOUT": how.occluder is not None, "CORE": how.core[0], "END": how.core[1], **places}
    if how.by_pixel:
        device.run("raster_by_pixel", columns * grid[3], job, *inputs, cover, channels, flat, groups=True, **constants)
    else:
        device.run("raster", columns * grid[3], job, *inputs, piece.depths, cover, channels, flat, groups=True, TRACE=how.trace,
                   BATCH=batch(piece.quads), **constants, **how.smooth)
    return Band(first, last, channels, flat, lists, piece, own)

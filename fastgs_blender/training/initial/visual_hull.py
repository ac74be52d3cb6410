# SPDX-License-Identifier: GPL-3.0-or-later
"""The visual hull (Laurentini 1994) of what moves, from films of cameras that stand still.

A photograph of the empty place says nothing of what moves before it in the films.  Where something may be at a frame, as all films that see
that place agree, the photograph does not count; elsewhere it does, so that nothing is left to hang in the air where few cameras look.
"""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from ...cameras.camera import Camera
from ...captures.capture import Capture, Shot, by_view
from ...captures.pixels.plain import grown
from ..core.moving_pixels import MovingPixels, stands
from ..core.targets import smaller
from .geometry import depth_range, project, sample, visible

CELLS = 72
"""Cells of the volume along each side."""
SIDE = 80
"""Pixels of a film's picture along its longer side: as large as a cell in the middle of a rig."""
MOVES = 0.1
"""Mean share of such a pixel, from which on something moves there."""
MOST_VIEWS, FEWEST = 16, 2
"""Films that are asked, evenly spread; and how many must see a cell."""


def hull_of(capture: Capture, store: Any, say: Callable[[str], Any] = print) -> VisualHull | None:
    """The visual hull that a capture with a scan needs; None without a scan, or where films do not tell what moves, which is said."""
    if not capture.scan:
        return None
    hull = VisualHull(capture, store)
    if hull.known:
        return hull
    say("the scan gives starting points alone: no two films tell where something moves, because their cameras move or there are few frames")
    return None


class VisualHull:
    """Where something may move in the films of a capture, frame by frame: pixels that differ from the film's median, or that masks of the
    subject show."""

    def __init__(self, capture: Capture, store: Any) -> None:
        self._capture, self._store = capture, store
        self._moving = MovingPixels(store, capture.films, lambda shot, pixels: pixels.rgb)
        still = [shots for shots in by_view(capture.films).values() if all(stands(shot, shots[0]) for shot in shots)]
        chosen = [still[i] for i in np.unique(np.linspace(0, len(still) - 1, MOST_VIEWS).round().astype(int))] if still else []
        self._shots: dict[int, list[Shot]] = {}
        for shot in (shot for shots in chosen for shot in shots):
            self._shots.setdefault(shot.frame, []).append(shot)
        films = replace(capture, shots=capture.films)
        half = max(float(np.linalg.norm(films.centres() - films.focus, axis=1).max(initial=0)), depth_range(films)[1] / 4)
        ticks = np.linspace(-half, half, CELLS)
        self._cell = 2 * half / (CELLS - 1)
        self._grid = films.focus + np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), -1).reshape(-1, 3)
        self._places = {shots[0].view: _seen(shots[0].camera, self._grid) for shots in chosen if shots[0].camera is not None}
        self.cells = lru_cache(maxsize=None)(self._cells)

    @property
    def known(self) -> bool:
        """Whether films tell where something moves: at least two of cameras that stand still, or with masks."""
        first = next(iter(self._shots.values()), [])
        return sum(self._moves(shot) is not None for shot in first) >= FEWEST

    def _cells(self, frame: int) -> np.ndarray:
        """Centres [P, 3] of the cells in which something may be at a frame."""
        seen, agree = np.zeros((2, len(self._grid)), np.int16)
        for shot in self._shots.get(frame, []):
            moves = self._moves(shot)
            if moves is not None and shot.camera is not None:
                rows, places = self._places[shot.view]
                seen[rows] += 1
                size = moves.shape[1] / shot.camera.width, moves.shape[0] / shot.camera.height
                agree[rows] += sample(moves[..., None], places * size)[:, 0]
        return self._grid[(seen >= FEWEST) & (agree == seen)]

    def _moves(self, shot: Shot) -> np.ndarray | None:
        """Which pixels [h, w] of a film's small picture show what moves, and those beside them; None: not known."""
        pixels = self._store.pixels(shot)
        subject = pixels.mask if self._capture.mask_means == "foreground" else None
        share = self._moving.share(shot, pixels)
        if share is None and subject is None:
            return None
        share = np.maximum(*(np.zeros(pixels.rgb.shape[:2], np.float32) if each is None else each for each in (share, subject)))
        return grown(smaller(share, max(1, -(-max(share.shape) // SIDE))) > MOVES)

    def covers(self, camera: Camera, frame: int) -> np.ndarray:
        """Which pixels [h, w] of a picture show a cell in which something may be at a frame."""
        cells = self.cells(frame)
        places, depth = project(camera, cells)
        ahead = depth > 0
        places, reach = places[ahead], 0.75 * self._cell * camera.fx / depth[ahead]
        low, high = (np.clip(np.round(places + way * reach[:, None]).astype(int), 0, (camera.width, camera.height)) for way in (-1, 1))
        corners = np.zeros((camera.height + 1, camera.width + 1), np.int32)  # each square begins and ends in two rows and columns
        for x, y, sign in ((low, low, 1), (high, low, -1), (low, high, -1), (high, high, 1)):
            np.add.at(corners, (y[:, 1], x[:, 0]), sign)
        return corners.cumsum(0).cumsum(1)[:-1, :-1] > 0


def _seen(camera: Camera, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rows of the points [n, 3] that a camera sees, and their pixels."""
    rows = np.flatnonzero(visible(camera, grid))
    return rows, project(camera, grid[rows])[0].astype(np.float32)

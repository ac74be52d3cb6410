# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds which pixels of a still camera's film move, so that training can give them more weight.

Most of a room stands still.  What moves covers few pixels, each in few pictures, and a mean over all pixels hardly asks for it.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...captures.capture import Shot, by_view
from ...captures.pixels.store import Pixels
from .targets import smaller

LOOKS, FEWEST = 15, 4
"""Pictures of a camera whose median shows what stands still; and fewer tell nothing."""
SIDE = 480
"""Pictures are compared at no more than this size (their longer side)."""
LOW, HIGH = 0.03, 0.10
"""Differences in colour (0..1) below which a pixel stands still, and above which it surely moves; between them lies noise."""


class MovingPixels:
    """How much each pixel of a shot moves; for shots of cameras that stand still, and that have no mask.

    shots   those that training uses, by which a camera's still picture is found
    masked  gives the picture [h, w, 3] to look at of a shot that has a mask; None: such shots tell nothing
    """

    def __init__(self, store: Any, shots: Sequence[Shot], masked: Callable[[Shot, Pixels], np.ndarray] | None = None) -> None:
        self._store, self._shots, self._masked, self._still = store, by_view(shots), masked, dict[str, np.ndarray | None]()

    def share(self, shot: Shot, pixels: Pixels) -> np.ndarray | None:
        """[h, w] float32 of a shot's pixels, as its camera filmed them: 0 stands still, 1 moves; None where it is not known."""
        picture = self._compared(shot, pixels)
        still = None if picture is None else self._still_picture(shot.view)
        if picture is None or still is None:
            return None
        h, w = picture.shape[:2]
        return _share(smaller(picture, _reduction(h, w)), still, h, w)

    def changed(self, earlier: MovingPixels, view: str, h: int, w: int) -> np.ndarray | None:
        """share() [h, w] of what stands still in a camera's film, against the same of an earlier part of it."""
        now, before = self._still_picture(view), earlier._still_picture(view)
        return None if now is None or before is None else _share(now, before, h, w)

    def _still_picture(self, view: str) -> np.ndarray | None:
        """The median [h, w, 3] of some of a camera's pictures, made when it is asked for first."""
        if view not in self._still:
            shots = self._shots.get(view, [])
            usable = len(shots) >= FEWEST and all((self._masked or shot.mask is None) and stands(shot, shots[0]) for shot in shots)
            self._still[view] = self._median(shots) if usable else None
        return self._still[view]

    def _median(self, shots: Sequence[Shot]) -> np.ndarray | None:
        picked = [shots[i] for i in np.unique(np.linspace(0, len(shots) - 1, min(LOOKS, len(shots))).round().astype(int))]
        looks = [self._compared(shot, self._store.pixels(shot)) for shot in picked]
        known = [smaller(look, _reduction(*look.shape[:2])) for look in looks if look is not None]
        return np.median(known, axis=0).astype(np.float32) if len(known) == len(looks) else None

    def _compared(self, shot: Shot, pixels: Pixels) -> np.ndarray | None:
        if pixels.mask is None:
            return pixels.rgb
        return None if self._masked is None else self._masked(shot, pixels)


def _share(picture: np.ndarray, still: np.ndarray, h: int, w: int) -> np.ndarray:
    """How much each pixel [h, w] differs, of reduced pictures: 0 not at all, 1 surely."""
    red, green, blue = np.moveaxis(np.abs(picture - still), -1, 0)
    change = np.maximum(np.maximum(red, green), blue)  # ten times as fast as max(-1)
    share = np.clip((change - LOW) / (HIGH - LOW), 0, 1)
    r = _reduction(h, w)
    rows, columns = (np.minimum(np.arange(n) // r, m - 1) for n, m in zip((h, w), share.shape))
    return share[np.ix_(rows, columns)]


def stands(shot: Shot, first: Shot) -> bool:
    """Whether the camera of a shot is that of another one, at the same place."""
    a, b = shot.camera, first.camera
    return a is b or (a is not None and b is not None and (a.width, a.height, a.fx, a.fy) == (b.width, b.height, b.fx, b.fy)
                      and np.array_equal(a.world_to_camera, b.world_to_camera))


def _reduction(h: int, w: int) -> int:
    return max(1, -(-max(h, w) // SIDE))

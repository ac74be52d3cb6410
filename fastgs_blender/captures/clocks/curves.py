# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures curves over time for each camera of a capture: the brightness of its pictures, and the change from one picture to the next."""
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ...cameras.lens import Lens
from ...util.errors import FastGSError
from ...util.threads import gathered
from ..capture import Capture, Shot, by_view
from ..pixels import decoding
from ..pixels.probe import picture_size

SIDE = 160
"""Pictures are shrunk to this for their curves: details and noise say nothing about time."""
MOST_FRAMES = 600
"""Frames that are looked at, from the middle of a longer clip."""
FLASH, BRIGHTER = 8.0, 0.02
"""A flash: a change of brightness so many times the usual one, and at least so large (0..1)."""
LEAST_CHANGE = 2e-4
"""Mean change from picture to picture (0..1) below which nothing moves."""


@dataclass(frozen=True, eq=False)
class Curves:
    """The curves of V views over the F frames from `first` on; NaN where a picture is missing.

    brightness  [V, F] mean of each picture, 0..1
    change      [V, F - 1] mean absolute difference of a picture and the next
    """

    views: tuple[str, ...]
    first: int
    brightness: np.ndarray
    change: np.ndarray


def curves(capture: Capture, progress: Callable[[int, int], None] | None = None, most: int = MOST_FRAMES) -> Curves:
    """The curves of all views of a capture; progress(done, of) counts pictures.

    Pictures are decoded small and are not kept.  Raises FastGSError where one cannot be decoded.
    """
    frames = range(capture.clip.frame_count)
    frames = frames[max((len(frames) - most) // 2, 0):][:most]
    views = {view: [shot for shot in shots if shot.frame in frames] for view, shots in by_view(capture.shots).items()}
    total, done = sum(map(len, views.values())), [0] * len(views)
    report = progress or (lambda done, of: None)

    def work(k: int, shots: list[Shot]) -> tuple[np.ndarray, np.ndarray]:
        return _of_view(shots, frames, lambda: done.__setitem__(k, done[k] + 1))

    found = gathered([partial(work, k, shots) for k, shots in enumerate(views.values())], lambda: report(sum(done), total))
    return Curves(tuple(views), frames.start, np.array([b for b, _ in found]), np.array([c for _, c in found]))


def _of_view(shots: Sequence[Shot], frames: range, count: Callable[[], None]) -> tuple[np.ndarray, np.ndarray]:
    brightness, change = np.full(len(frames), np.nan), np.full(len(frames) - 1, np.nan)
    if not shots:
        return brightness, change
    scale = min(1.0, SIDE / max(picture_size(shots[0].image)))
    plain = [replace(shot, camera=None, mask=None, image=replace(shot.image, lens=Lens(), intrinsics=None)) for shot in shots]
    before, last = None, -2
    for shot, found in decoding.decode(plain, scale):
        if isinstance(found, FastGSError):
            raise found
        picture = found[..., :3].astype(np.float32).mean(2) / (255 if found.dtype == np.uint8 else 65535)
        at = shot.frame - frames.start
        brightness[at] = picture.mean()
        if before is not None and last == at - 1 and before.shape == picture.shape:
            change[at - 1] = np.abs(picture - before).mean()
        before, last = picture, at
        count()
    return brightness, change


def flashes(found: Curves) -> np.ndarray | None:
    """The rises of brightness [V, F - 1] of a flash, or of a lamp that is switched, 0 elsewhere; None unless most views show one."""
    steps = np.nan_to_num(np.diff(found.brightness, axis=1))
    usual = np.median(np.abs(steps), axis=1, keepdims=True)
    flash = np.where(np.abs(steps) > np.maximum(FLASH * usual, BRIGHTER), steps, 0.0)
    return flash if (flash != 0).any(1).mean() > 0.5 else None


def moving(found: Curves) -> list[int]:
    """The views in whose pictures something moves."""
    return [k for k, change in enumerate(found.change) if np.isfinite(change).any() and np.nanmedian(change) > LEAST_CHANGE]


def activity(change: np.ndarray) -> np.ndarray:
    """The curve of a view's changes [n] as it is compared: logarithms, so that near and far cameras are alike, less what changes slowly."""
    known = np.isfinite(change)
    filled = np.interp(np.arange(len(change)), np.flatnonzero(known), change[known])
    values = np.log(filled + 0.1 * np.median(filled) + 1e-6)
    width = max(5, 2 * (len(values) // 4) + 1)
    return values - smoothed(values, width)


def smoothed(values: np.ndarray, width: int) -> np.ndarray:
    """The mean over `width` (odd) samples around each one, the ends mirrored."""
    reach = min(width // 2, len(values) - 1)
    padded = np.pad(values, reach, "reflect")
    sums = np.cumsum(np.r_[0.0, padded])
    return (sums[2 * reach + 1:] - sums[:-2 * reach - 1]) / (2 * reach + 1)

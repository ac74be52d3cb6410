# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the clock offsets of a capture's cameras from their sound, a flash, or the motion in their pictures."""
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...util.arguments import one_of
from ...util.arguments import shown as described
from ...util.errors import FastGSError
from ..capture import Capture, Shot
from ..evidence import differs
from . import epipolar
from .curves import Curves, activity, curves, flashes, moving
from .files import Clocks
from .lags import COMMON_SHARE, LEAST_COMMON, compared, grown, offsets_from_pairs
from .sound import heard, onsets

WAYS = ("auto", "sound", "flash", "motion")
NEIGHBOURS = 8
"""Cameras that each one is compared with by curves: in a large rig not all pairs are."""
ALIKE, ALONE = 0.5, 0.1
"""Least correlation of two cameras' curves of motion, and how far it must stand above that of other shifts."""
CHANCE = 4.5
"""Curves of motion count as alike above this many standard deviations of the correlation that curves of as many samples have by chance, by
Fisher's z, the best of several shifts: in 15 frames, or 40 of slow motion, almost only equal curves are."""
LEAST = 0.1
"""Frames by which an offset must differ from 0 to count (captures/evidence.py)."""
VAGUE, MOST_VAGUE = 0.15, 0.3
"""Standard deviations, in frames, beyond which motion leaves a clock unsure: one whose offset does not count; and any one, in the planes of
known poses (of a camera that was turned by two degrees, an offset of six frames was found)."""
FLASH_ERROR, CURVES_ERROR = 0.3, 1.0
"""Standard deviations in frames of what a flash gives, and of what curves of motion give, which are only alike (genlocked people before
four cameras: up to 2 frames)."""


@dataclass(frozen=True, eq=False)
class Found:
    """What the search gave.

    clocks  only what is sure: the offsets of all others are 0
    curves  of what moves, or None where they were not needed
    lost    views whose clock is unsure: it could not be compared, or not well enough
    measured  the offsets as they were found, by view, also those that are not surely different from 0
    All are against the times that the capture's shots have.
    """

    clocks: Clocks
    curves: Curves | None
    lost: tuple[str, ...]
    measured: Mapping[str, float]


def find_offsets(capture: Capture, way: str = "auto", progress: Callable[[int, int], None] | None = None,
                 misplaced: Collection[str] = ()) -> Found:
    """The offsets of a capture against those that it was opened with; of one without any, open_capture(path, offsets={}), its offsets.

    way       "auto", "sound", "flash" or "motion"; auto: sound where all cameras have some and it is clear; else motion where poses are
              known and enough moves; else a flash; else motion
    progress  called as progress(done, of) while pictures are looked at
    misplaced  views whose poses are wrong: they are not compared by poses, and have no clock then
    Returns `clocks`, whose median offset is 0; `lost`, the names of views whose clock is unsure, with the offset 0; `curves` of what moves,
    None where they were not needed.  `fastgs sync` refines these offsets by a short training.
    Raises FastGSError, with the reason, where nothing can be found.

    Example:
        found = fg.find_offsets(fg.open_capture("my-capture", offsets={}))
        fg.write_clocks("my-capture", found.clocks)
    """
    if not isinstance(capture, Capture):
        raise FastGSError(f"offsets are found of a Capture, as open_capture() gives it, not of {described(capture)}.")
    one_of(way, "how offsets are found", WAYS)
    if len(capture.views) < 2:
        raise FastGSError(f"{capture.path}: it has one camera, whose clock has none to be compared with.")
    if way in ("auto", "sound"):
        found = _by_sound(capture)
        if found is not None and not found.lost:
            return found
        if way == "sound":
            raise FastGSError(f"{capture.path}: " + ("its cameras have no sound in common" if found is None else
                              f"the sound of {', '.join(found.lost)} fits no other camera's") + "; find the offsets with --by motion.")
    by_planes = by_epipolar_planes(capture, progress, misplaced=misplaced) if way in ("auto", "motion") else None
    if by_planes is not None and 2 * len({*by_planes.lost} - {*misplaced}) < len(capture.views):
        return by_planes
    shown = curves(capture, progress)
    flash = flashes(shown) if way in ("auto", "flash") else None
    if flash is not None:
        found = _aligned(capture, shown, list(flash), list(range(len(flash))), "flash")
        if not found.lost or way == "flash":
            return found
    elif way == "flash":
        raise FastGSError(f"{capture.path}: most of its cameras show no flash; find the offsets with --by motion.")
    return _by_curves(capture, shown)


def by_epipolar_planes(capture: Capture, progress: Callable[[int, int], None] | None = None,
                       pictures: epipolar.Pictures | None = None, misplaced: Collection[str] = ()) -> Found | None:
    """The offsets of cameras whose poses are known (epipolar.py); None where no pair of them could be compared.

    pictures   gives the pictures of shots; None: they are decoded
    misplaced  views whose poses are wrong: they are lost
    """
    placed = replace(capture, shots=[shot for shot in capture.shots if shot.view not in misplaced])
    views, pairs = epipolar.pairs(placed, progress or (lambda done, of: None), pictures)
    if not pairs:
        return None
    offsets, deviations = offsets_from_pairs(len(views), pairs)
    centres = {shot.view: shot.camera.centre for shot in capture.shots if shot.camera is not None}
    # Clocks do not go by where cameras stand, but when the sides of a thing that turns are seen does.
    deviations = np.hypot(deviations, grown(offsets, np.array([centres[view] for view in views])))
    deviations[deviations > MOST_VAGUE] = np.inf
    return _found(capture, dict(zip(views, zip(offsets, deviations))), "motion", None, VAGUE)


def _by_curves(capture: Capture, shown: Curves) -> Found:
    still = {shot.view for shot in capture.shots} - _moved(capture)
    usable = [k for k in moving(shown) if shown.views[k] in still]
    if len(usable) < 2:
        some = "more than one" if usable else "any"
        raise FastGSError(f"{capture.path}: nothing moves in the pictures of {some} of its cameras, so clocks cannot be compared; choose "
                          "a part of the clip in which something moves, or clap or flash a lamp when you film.")
    found = _aligned(capture, shown, [activity(shown.change[k]) for k in usable], usable, "motion")
    if 2 * len(found.measured) <= len(capture.views):  # offsets are against most of the others, not against one that looks alike
        raise FastGSError(f"{capture.path}: what moves looks too different from camera to camera for their clocks to be compared; choose a "
                          "longer part of the clip, or clap or flash a lamp when you film.")
    return found


def _moved(capture: Capture) -> set[str]:
    """The views whose cameras move, because their pictures change all the time."""
    poses: dict[str, set] = {}
    for shot in capture.shots:
        if shot.camera is not None:
            poses.setdefault(shot.view, set()).add(shot.camera.world_to_camera.tobytes())
    return {view for view, each in poses.items() if len(each) > 1}


def _pairs(count: int) -> list[tuple[int, int]]:
    return [(i, (i + k) % count) for k in range(1, min(NEIGHBOURS, count // 2) + 1) for i in range(count) if 2 * k < count or i < k]


def _aligned(capture: Capture, shown: Curves, lines: list[np.ndarray], rows: list[int], way: str) -> Found:
    """The Found offsets of the views `rows`, by aligning their curves `lines`."""
    length = min(map(len, lines))
    most = max(1, min(int((1 - COMMON_SHARE) * length), length - LEAST_COMMON))
    error, chance = (CURVES_ERROR, CHANCE) if way == "motion" else (FLASH_ERROR, 0.0)
    pairs = [pair for i, j in _pairs(len(lines)) if (pair := compared(lines, i, j, most, error)) is not None]
    pairs = [pair for pair in pairs if pair.alone >= ALONE
             and pair.alike >= max(ALIKE, np.tanh(chance / np.sqrt(max(pair.common - 3, 1e-6))))]
    offsets, spread = offsets_from_pairs(len(lines), pairs)
    spread = np.hypot(spread, error)  # what curves of several cameras are alike in is wrong in the same way
    values = {shown.views[row]: (offsets[k], spread[k]) for k, row in enumerate(rows)}
    return _found(capture, values, way, shown, VAGUE if way == "motion" else np.inf)


def _found(capture: Capture, values: dict[str, tuple[float, float]], way: str, shown: Curves | None, vague: float = np.inf) -> Found:
    """Found of (offset, standard deviation) by view, in the frames of the capture: an offset is taken where it surely differs from the one
    that the capture's times state."""
    offsets, lost = dict.fromkeys(capture.views, 0.0), []
    stated = stated_offsets(capture.shots, capture.clip.frame_count)
    values = {view: (offset - stated[view], deviation) for view, (offset, deviation) in values.items()}
    for view in capture.views:
        offset, deviation = values.get(view, (np.nan, np.inf))
        if differs(offset, deviation, LEAST):
            offsets[view] = float(offset)
        elif not deviation < vague:
            lost.append(view)
    known = {view: float(deviation) for view, (_, deviation) in values.items() if np.isfinite(deviation)}
    return Found(Clocks(offsets, known, way), shown, tuple(lost), {view: float(values[view][0]) for view in known})


def stated_offsets(shots: Sequence[Shot], frame_count: int) -> dict[str, float]:
    """How much the times of shots differ from their frames, by view, less the median: fractions of a sync.json, or the layout's times."""
    late: dict[str, list[float]] = {}
    for shot in shots:
        late.setdefault(shot.view, []).append(shot.t * frame_count - shot.frame)
    offsets = {view: float(np.median(values)) for view, values in late.items()}
    middle = float(np.median(list(offsets.values())))
    return {view: value - middle for view, value in offsets.items()}


def _by_sound(capture: Capture) -> Found | None:
    """By sound; None unless at least two cameras are videos with sound."""
    videos = {shot.view: shot.image.path for shot in reversed(capture.shots) if shot.image.frame is not None}
    lines = {view: line for view, path in videos.items() if (line := onsets(path)) is not None}
    views = [view for view in capture.views if view in lines]
    if len(views) < 2:
        return None
    pairs = [pair for i, j in _pairs(len(views)) if (pair := heard([lines[view] for view in views], i, j)) is not None]
    pairs = [replace(pair, lag=pair.lag * capture.clip.fps, error=pair.error * capture.clip.fps) for pair in pairs]
    offsets, spread = offsets_from_pairs(len(views), pairs)
    if not np.isfinite(offsets).any():
        return None
    moved = {shot.view: shot.frame - shot.image.frame for shot in capture.shots if shot.image.frame is not None}  # sounds begin with files
    offsets -= [moved[view] for view in views]
    offsets -= np.nanmedian(offsets)
    return _found(capture, {view: (offsets[k], spread[k]) for k, view in enumerate(views)}, "sound", None)

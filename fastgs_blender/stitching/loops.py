# SPDX-License-Identifier: GPL-3.0-or-later
"""find_loop(): where a clip is cut so that it can be played over and over, by its pictures and by how these change.

Two moments are alike if small pictures of them from several places are, and if the pictures change alike (Schoedl et al. 2000).  The loop
begins at the one and ends at the other.  Around the seam the end fades into the beginning.
"""
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from ..cameras.camera import Camera
from ..cameras.poses import look_at
from ..cameras.viewpoints import camera_of
from ..model.filmed_from import directions, filmed_from
from ..model.framing import is_subject, without_backdrop
from ..model.sequence import Source
from ..model.slicing import opacities_at, positions_at
from ..rendering.api import render
from ..rendering.instances import Instance, ObjectSettings
from ..util.arguments import real
from ..util.errors import FastGSError

SIDE = 48
"""Pixels of a picture along its longer side."""
VIEWS = 4
MOST = 120
"""Moments at which a clip is looked at."""
MOTION = 1.0
"""Weight of how pictures change from frame to frame, by that of the pictures."""
AS_GOOD = 1.15
"""A shorter loop is taken where its seam is no more than so many times as visible as the best."""
NO_BETTER = 1.05
"""The whole clip is taken where every cut's seam is seen more than so many times as much as its own end."""
FINE = 8
"""Parts of a frame in which the end of the loop is looked for at last."""


@dataclass(frozen=True)
class Loop:
    """A part of a clip that can be played over and over.  Frames are the clip's, from 0; fractions are sub-frames.

    start    the frame with which it begins
    length   frames until it begins anew
    fade     frames at its beginning over which the end goes and the beginning comes
    whole    how much the picture changes at once from the last frame of the clip to its first, by the usual change of a frame
    cut      the same at the seam of the cut alone,
    blended  and with the fade, at its largest
    motion   how alike the motion is on both sides of the seam: 1 the same, 0 none of it, -1 backwards
    seam     how much is seen of it in all, fade and motion included: 1 no more than of any frame
    uncut    whether it is all of the clip, because no cut is better

    Example:
        loop = fg.find_loop(model.take(slice(None, None, 50)), least=10, fade=4)
        print(loop.start, loop.length, loop.cut, loop.blended)
    """

    start: float
    length: float
    fade: float
    whole: float
    cut: float
    blended: float
    motion: float
    seam: float
    uncut: bool

    @property
    def end(self) -> float:
        """The frame at which the fade ends: the last one that is shown."""
        return self.start + self.length + self.fade


def find_loop(source: Source, *, least: float | None = None, fade: float = 8.0, first: float = 0.0, last: float | None = None,
              settings: ObjectSettings | None = None, progress: Callable[[float], Any] | None = None) -> Loop:
    """The best loop in a clip, by small pictures from a few places: the shortest of those whose seam is about as good as the best one's.

    It is the whole clip, without a fade, where every cut's seam is seen more than that clip's own end.

    least        frames that it lasts at least; None: half of the clip
    fade         frames over which the end fades into the beginning; 0 cuts.  It is at most half of the loop
    first, last  frames of the clip between which it lies, with its fade
    settings     how the source is shown, such as what of it is masked
    progress     called with 0..1 between pieces of work; what it raises stops the work and passes through

    Raises FastGSError for a still and where the clip is too short for such a loop.

    Example:
        loop = fg.find_loop(model.take(slice(None, None, 50)), least=10, fade=4)
    """
    progress = progress or (lambda share: None)
    count = source.clip.frame_count
    last = count - 1.0 if last is None else real(last, "the last frame", 0, count - 1)
    first, fade = real(first, "the first frame", 0, count - 1), real(fade, "the frames of the fade", 0)
    if count < 2 or last - first < 3:
        raise FastGSError("a loop needs a clip of at least four frames; a still has no loop.")
    least = (last - first) / 2 if least is None else real(least, "the least length of a loop", 2)
    fade = min(fade, least / 2)
    step = next(step for step in (0.5, 1.0, max((last - first) / MOST, 1.0)) if (last - first) / step <= MOST)
    if least + fade > last - first:
        raise FastGSError(f"the clip has {last - first + 1:g} frames, which is too short for a loop of {least:g} and a fade of {fade:g}; "
                          "ask for less.")
    eyes = Eyes(source, settings or ObjectSettings(), first, last)
    at = first + step * np.arange(int((last - first) / step + 1e-9) + 1)
    pictures = []
    for k, frame in enumerate(at):
        pictures.append(eyes.picture(frame))
        progress(0.85 * (k + 1) / len(at))
    seen = np.stack(pictures)
    i, j = _best(seen, at, least, fade)
    start, end = float(at[i]), float(at[j])
    around = np.linspace(max(end - step, start + least), min(end + step, last - fade), 2 * FINE + 1)
    aim = np.stack([eyes.picture(start), eyes.picture(min(start + 1, last)) - eyes.picture(start)])
    off = []
    for k, frame in enumerate(around):
        here, after = eyes.picture(frame), eyes.picture(min(frame + 1, last))
        off.append(np.square(here - aim[0]).mean() + MOTION * np.square(after - here - aim[1]).mean())
        progress(0.85 + 0.1 * (k + 1) / len(around))
    on_grid = np.abs(around - end).argmin()
    best = int(np.argmin(off))
    end = float(around[best] if off[best] < 0.9 * off[on_grid] else around[on_grid])
    usual = float(np.sqrt(np.square(np.diff(seen, axis=0)).mean(1)).mean() / step)
    cut, whole = eyes.judged(start, end - start, fade, usual), eyes.judged(first, last + 1 - first, 0.0, usual)
    progress(1.0)
    return replace(whole, uncut=True) if cut.seam > NO_BETTER * whole.seam else replace(cut, whole=whole.cut)


def _best(seen: np.ndarray, at: np.ndarray, least: float, fade: float) -> tuple[int, int]:
    """The numbers of the moments [S] at which the loop begins and begins anew, by their pictures [S, D]."""
    change = np.gradient(seen, axis=0)
    cost = _apart(seen) + MOTION * _apart(change)
    if fade:  # what is shown together has to be alike for as long as it is
        width = max(round(fade / float(at[1] - at[0])), 1)
        summed, rows = np.zeros_like(cost), len(cost)
        for k in range(width + 1):
            summed[:rows - k, :rows - k] += cost[k:, k:]
        cost = summed / (width + 1)
    length = at[None] - at[:, None]
    fits = (length >= least - 1e-9) & (at[None] + fade <= at[-1] + 1e-6)
    cost = np.where(fits, cost, np.inf)
    usual = float(np.square(np.diff(seen, axis=0)).mean()) if len(seen) > 1 else 0.0
    # what is far less than a step from one moment to the next is no difference of the seams
    good = cost <= AS_GOOD**2 * cost.min() + 0.05 * usual
    i, j = np.nonzero(good)
    shortest = length[i, j] <= length[i, j].min() + 1e-9
    i, j = i[shortest], j[shortest]
    best = int(np.argmin(cost[i, j]))
    return int(i[best]), int(j[best])


def _apart(x: np.ndarray) -> np.ndarray:
    """Mean squared differences [S, S] of rows [S, D]."""
    x = x - x.mean(0)
    squares = (x * x).mean(1)
    return np.maximum(squares[:, None] + squares - 2 * (x @ x.T) / x.shape[1], 0)


class Eyes:
    """Small pictures of a source from a few places: those of its capture's cameras, else around its subject."""

    def __init__(self, source: Source, settings: ObjectSettings, first: float, last: float):
        self.source, self.settings, self.last = source, settings, last
        known = source.surroundings.cameras
        if known:
            chosen = np.unique(np.linspace(0, len(known) - 1, VIEWS).round().astype(int))
            self.cameras = [_small(camera_of(known[k])) for k in chosen]
        else:
            self.cameras = self._around((first + last) / 2)

    def _around(self, frame: float) -> list[Camera]:
        model, t = self.source.moment(self.source.clip.t_of_frame(frame))
        inside = without_backdrop(model)
        place = positions_at(inside, t)[opacities_at(inside, t) > 0.1]
        place = place[np.isfinite(place).all(1)]
        if not len(place):
            raise FastGSError("nothing of the clip is seen in its middle; trim it first.")
        place = place[is_subject(place)]
        middle, size = np.median(place, 0), float(np.linalg.norm(np.ptp(place, axis=0)))
        up = {"RDF": (0, -1, 0), "RUB": (0, 1, 0)}.get(model.axes, (0, 0, 1))
        eye = filmed_from(model, t, np.array(up, float))
        found = []
        for way in directions(VIEWS):
            target, place = middle, middle + max(size, 1e-6) * way * [1, 1, 1]
            if eye is not None:  # where the cameras stood, and a little beside it
                target, away = eye[1], float(np.linalg.norm(eye[0] - eye[1]))
                place = eye[0] + 0.15 * away * way
            found.append(Camera(SIDE, SIDE, SIDE * 0.9, SIDE * 0.9, SIDE / 2, SIDE / 2, look_at(place, target, up)))
        return found

    def picture(self, *shown: float | tuple[float, float]) -> np.ndarray:
        """What is seen at a frame, or of frames with the opacity that each has: [D], sRGB over grey."""
        scene = []
        for each in shown:
            frame, share = each if isinstance(each, tuple) else (each, 1.0)
            model, t = self.source.moment(self.source.clip.t_of_frame(float(frame)))
            look = self.settings.under(ObjectSettings(opacity=share, antialias=self.settings.antialias))
            scene.append(Instance(model, np.eye(4), t, look))
        out = []
        for camera in self.cameras:
            found = render(scene, camera)
            out.append((found["rgb"] + 0.5 * (1 - found["alpha"])[..., None]).ravel())
        return np.concatenate(out).astype(np.float64)

    def judged(self, start: float, length: float, fade: float, usual: float) -> Loop:
        """A loop with the jumps that are seen in it, by the usual change of a frame."""
        def jump(before: np.ndarray, after: np.ndarray) -> float:
            return float(np.sqrt(np.square(after - before).mean()) / max(usual, 1e-6))

        def step(frame: float) -> np.ndarray:
            return self.picture(frame + 1) - self.picture(frame)

        end = start + length
        goes, comes = self.picture(end - 1), self.picture(start)
        ahead = 0.0 if end + 1 <= self.last else -1.0
        if end <= self.last and start + ahead >= 0:
            going, coming = step(end + ahead), step(start + ahead)
            motion = _alike(going, coming)
        else:  # what would follow is not known, so steps are compared that are two frames apart, with others that are
            going, coming = step(end - 2), step(start)
            motion = min(_alike(going, coming) + 1 - 0.5 * (_alike(step(end - 4), going) + _alike(coming, step(start + 2))), 1.0)
        cut = blended = jump(goes, comes)
        if fade:
            times = np.arange(-1, np.ceil(fade) + 1)
            shown = [self.picture(*faded(start, length, fade, at)) for at in times]
            blended = max(jump(a, b) for a, b in pairwise(shown))
        natural = max(1.0, jump(0 * going, going), jump(0 * coming, coming))
        seam = float(np.sqrt(max(blended / natural, 1.0) ** 2 + 2 * MOTION * (1 - motion)))
        return Loop(start, length, fade, cut, cut, blended, motion, seam, False)


def _alike(one: np.ndarray, other: np.ndarray) -> float:
    """The cosine between two changes of pictures."""
    return float((one * other).sum() / max(np.linalg.norm(one) * np.linalg.norm(other), 1e-12))


def faded(start: float, length: float, fade: float, at: float) -> list[tuple[float, float]]:
    """The frames that a loop shows `at` frames after its beginning, each with its opacity."""
    at %= length
    if at >= fade:
        return [(start + at, 1.0)]
    share = at / fade
    return [(frame, opacity) for frame, opacity in ((start + at, share), (start + at + length, 1 - share)) if opacity > 0]


def _small(camera: Camera) -> Camera:
    size = SIDE / max(camera.width, camera.height)
    return camera.stretched(*(max(1, round(size * side)) for side in (camera.width, camera.height)))

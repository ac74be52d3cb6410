# SPDX-License-Identifier: GPL-3.0-or-later
"""Puts films together by their time stamps: phones film with varying rates, and films of 29.97, 30 and 60 frames a second meet in a rig."""
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np

from ..util.errors import FastGSError
from .pixels.video import MOST_FRAMES, index
from .rig_camera import RigCamera

NEAR = 0.75
"""Frames of the time line from a moment, within which a picture shows it; beyond, it is missing."""


def evened(cameras: Sequence[RigCamera], fps: float) -> tuple[list[RigCamera], float, list[str]]:
    """The cameras with one picture for each moment of one time line, its frames per second, and a note where films were not even.

    fps  of the layout, which stays where all films are even and of one rate
    The time line has the rate of most even films.  Each film begins at its first picture; clocks (sync.json) come on top.
    """
    films = {camera.name: seconds for camera in cameras if (seconds := _seconds(camera)) is not None}
    known = {path: index(path) for camera in cameras if camera.name in films for path in _paths(camera)}
    rates = Counter(round(each.fps, 2) for each in known.values())
    if len(films) < 2 or (len(rates) == 1 and all(each.constant for each in known.values())):
        return list(cameras), fps, []
    even = {path: each.fps for path, each in known.items() if each.constant}
    beats = list(even.values()) or [1 / float(np.median(np.diff(seconds))) for seconds in films.values() if len(seconds) > 1]
    usual = Counter(map(round, beats)).most_common(1)[0][0]
    beat = float(np.median([each for each in beats if round(each) == usual]))
    said = ", ".join(f"{rate:g}" for rate in sorted(rates))
    timeless = [camera.name for camera in cameras if camera.name not in films and any(picture is not None for picture in camera.pictures)]
    if timeless:
        return list(cameras), fps, [f"films of {said} frames a second are taken picture for picture, as {timeless[0]} says no times"]
    note = f"films are put together by their time stamps (frames a second: {said}{'' if len(rates) > 1 else ', varying'})"
    return [_on_the_beat(camera, films[camera.name], beat) if camera.name in films else camera for camera in cameras], beat, [note]


def _on_the_beat(camera: RigCamera, seconds: np.ndarray, beat: float) -> RigCamera:
    """The camera with the picture that is nearest to each moment."""
    at = seconds * beat
    if not at[-1] < MOST_FRAMES:
        raise FastGSError(f"{_paths(camera)[0]}: its time stamps jump, to {seconds[-1]:.3g} seconds; "
                          "convert it to a constant frame rate.")
    moments = np.arange(int(np.floor(at[-1] + 0.5)) + 1)
    between = (at[:-1] + at[1:]) / 2
    nearest = np.searchsorted(between, moments)
    late = at[nearest] - moments
    pictures = [camera.pictures[k] if abs(off) < NEAR else None for k, off in zip(nearest, late)]
    pose = camera.pose if camera.pose is None or np.ndim(camera.pose) == 2 else np.asarray(camera.pose)[nearest]
    masks = [camera.masks[k] for k in nearest if k < len(camera.masks)]
    return replace(camera, pictures=pictures, pose=pose, masks=masks, late=late.tolist())


def _seconds(camera: RigCamera) -> np.ndarray | None:
    """Seconds of each picture of a film after its first one, chapter after chapter; None of what is no film, or has no time stamps."""
    found: list[np.ndarray] = []
    begin = 0.0
    with suppress(FastGSError):  # told with the frames
        for path, group in groupby(camera.pictures, lambda picture: None if picture is None else picture.path):
            frames = [picture.frame for picture in group if picture is not None and picture.frame is not None]
            if path is None or not frames or (times := index(path).seconds) is None:
                return None
            found.append(begin + times[frames])
            begin = found[-1][-1] + 1 / index(path).fps
        return np.concatenate(found) - found[0][0] if found else None
    return None


def _paths(camera: RigCamera) -> list[Path]:
    return list(dict.fromkeys(picture.path for picture in camera.pictures if picture is not None))

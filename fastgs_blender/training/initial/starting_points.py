# SPDX-License-Identifier: GPL-3.0-or-later
"""Chooses the starting points: triangulated from the pictures, the layout's point file, or random points.

The source and the number of points are printed.  The result depends on the seed and the pictures alone.
"""
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ...captures.capture import Capture, Points
from ...util.errors import FastGSError
from ..core.schedule import POINTS, generator
from ..core.settings import Settings
from .dense import FEW, joined, picture, spread, triangulated
from .geometry import depth_range, sample, unproject, visible

SOURCES = {"triangulate": "triangulated features", "file": "the layout's point file", "random": "random points"}


def initial_points(capture: Capture, store: Any, settings: Settings, say: Callable[[str], None] = print,
                   progress: Callable[[int, int], None] = lambda done, of: None) -> tuple[Points, Any]:
    """The points that training starts from, at most settings.init_points, and the store with colours in which cameras agree, where it is
    found that they differ (CorrectedStore); t is NaN for points that are visible at all times.

    Those on the place that a scan shows come on top, as many again.
    settings.init  "auto": the first source that gives points, in SOURCES' order; or a source's name
    progress        called as progress(done, of)
    Raises FastGSError where the wanted source gives none.
    """
    order = list(SOURCES) if settings.init == "auto" else [settings.init]
    refused = []
    for kind in order:
        try:
            points, how, seen = _MAKERS[kind](capture, store, settings, progress)
        except FastGSError as error:
            if settings.init != "auto":
                raise
            refused.append(str(error))
            continue
        if len(points) >= FEW or kind == order[-1]:
            break
        refused.append(f"{SOURCES[kind]}: only {len(points)}.")
    for reason in refused:
        say(f"no starting points from this source: {reason}")
    found = len(points)
    points = thinned(points, settings.init_points, settings.seed)
    timed = 0 if points.t is None else int(np.isfinite(points.t).sum())
    kept = f", {len(points)} kept" if len(points) < found else ""
    say(f"starting points: {found} ({how}){kept}; {timed} of them belong to a moment, {len(points) - timed} to all times")
    if capture.films and capture.scan:
        place, _ = initial_points(replace(capture, shots=capture.scan), store, settings, say)
        times = np.full(len(points), np.nan, np.float32) if points.t is None else points.t
        points = joined([Points(place.xyz, place.rgb, np.full(len(place), np.nan, np.float32)), replace(points, t=times)])
    return points, seen


def thinned(points: Points, most: int, seed: int) -> Points:
    """At most so many of the points, drawn at random, as float32."""
    rows = np.arange(len(points))
    if len(rows) > most:
        rows = np.sort(generator(seed, POINTS, 1).choice(rows, most, replace=False))
    kept: dict[str, Any] = {name: None if array is None else np.asarray(array, np.float32)[rows] for name, array in vars(points).items()}
    return Points(**kept | {"rgb": np.clip(kept["rgb"], 0, 1)})


# The sources: functions of (capture, store, settings, progress) that return points, a clause about them, and a store


def from_file(capture: Capture, store: Any, settings: Settings, progress: Callable[[int, int], None]) -> tuple[Points, str, Any]:
    if capture.points is None:
        raise FastGSError(f"{capture.path}: its layout brings no point file.")
    return capture.points, SOURCES["file"], store


def random_points(capture: Capture, store: Any, settings: Settings, progress: Callable[[int, int], None]) -> tuple[Points, str, Any]:
    """Points behind random pixels in the pixels' colours, where at least half as many cameras see as at the best-seen place."""
    rng = generator(settings.seed, POINTS, 3)
    shots = spread(capture.training, 64)
    near, far = depth_range(capture)
    cameras = list({shot.camera.world_to_camera.tobytes(): shot.camera for shot in shots}.values())
    clouds = []
    for shot in shots:
        image, camera, inside = picture(capture, store, settings, shot, 256)
        n = 4 * settings.init_points // len(shots) + 1
        places = rng.uniform(0, 1, (n, 2)) * (camera.width, camera.height)
        depth = 1 / rng.uniform(1 / far, 1 / near, n)
        good = np.ones(n, bool) if inside is None else sample(inside[..., None], places)[:, 0] > 0.5
        clouds.append((unproject(camera, places, depth)[good], sample(image, places)[good]))
    xyz, rgb = (np.concatenate(parts) for parts in zip(*clouds))
    seen = np.sum([visible(camera, xyz) for camera in cameras], 0)
    common = seen >= seen.max(initial=0) / 2
    return thinned(Points(xyz[common], rgb[common]), settings.init_points, settings.seed), "random, where several cameras look", store


_MAKERS = {"triangulate": triangulated, "file": from_file, "random": random_points}

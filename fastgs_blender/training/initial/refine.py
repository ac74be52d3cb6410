# SPDX-License-Identifier: GPL-3.0-or-later
"""Refines the given poses and focal lengths of a rig that stands still, by features that its pictures have in common (bundle.py).

Every fifth track is held back.  A refined camera is taken where the features that it has of these tracks fit surely better
(captures/evidence.py); the others stay as they were given, and all do if the tracks as a whole do not fit clearly better.  Cameras that
were bumped are found again first (bumped.py), and taken by themselves, as they hardly count among many.
Cameras that are held out are neither looked at nor changed: the prior keeps the world in its place around them.
"""
import json
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ...cameras import poses
from ...cameras.camera import Camera
from ...captures.capture import Capture, Shot, by_view
from ...captures.evidence import AROUND, differs
from ...util.errors import FastGSError
from ...util.outputs import replacing
from ...util.reading import read_json, reading
from ..core.settings import Settings
from . import bumped, bundle, features
from .dense import FEW_CAMERAS, enlarged, picture, spread
from .geometry import sample

PICTURES, MOMENTS = 96, 3
"""Pictures that are compared, over all moments; moments at most."""
WIDE = 5.0
"""Pixels from the epipolar lines of the given cameras within which a match is looked for, and within which a point fits its track."""
NEIGHBOURS = 8
"""Cameras with which each one is compared."""
MOST_FEATURES = 2500
"""In one picture."""
LEAST_VIEWS, ENOUGH, MOST = 3, 100, 6000
"""Cameras to be trained on, and tracks, with fewer of which nothing is refined; tracks that are used at most."""
CERTAIN = 500
"""Tracks of the first moment that are enough to see that no camera needs to be refined: then no other moment is looked at."""
HELD_BACK = 5
"""Every so many tracks, one is held back."""
BETTER, BY = 0.9, 0.05
"""Where the error of the held-back tracks falls below this share of what it was, and by so many pixels, refined cameras are taken: those
whose own features come nearer by as much."""
MOVED = 0.02
"""Share of the capture's extent by which a bumped camera is said to be moved, too."""
LEAST_HELD = 8
"""Features of held-back tracks, with fewer of which nothing is told of a camera."""
NOTHING: dict = {"cameras": {}}
"""What is known of a run whose cameras stay as they were given."""


def refinement(capture: Capture, store: Any, settings: Settings, path: Path, begun: bool, say: Callable[[str], None] = print,
               progress: Callable[[int, int], None] = lambda done, of: None) -> dict:
    """What is to be changed in the cameras of a run, which the file `path` keeps: a resumed run changes the same.

    begun  the run has a checkpoint: without that file it goes on with the cameras that were given
    Returns {"cameras": {view: {"turn": [3], "shift": [3], "focal": factor, "unsure": radians}}, "before": pixels, "after": pixels}, see
    captures/refined.py; no cameras where these stay.  unsure: by how much more training may turn it.  Raises FastGSError where the
    folder's file is damaged.
    """
    if path.exists() and (known := kept(path, capture)) is not None:
        return known
    if begun or settings.poses == "off" or (settings.poses == "auto" and capture.model is not None):  # a bake knows its cameras
        return NOTHING
    try:
        found = found_by_tracks(capture, store, settings, say, progress)
    except FastGSError as error:
        if settings.poses == "on":
            raise
        say(f"cameras: as they were given ({str(error).rstrip('.')})")
        found = NOTHING
    with replacing([path]) as (part,):
        part.write_text(json.dumps({"capture": _name(capture), **found}, indent=1), "utf-8")
    return found


def kept(path: Path, capture: Capture) -> dict | None:
    """What a file says is to be changed, None if it is of another capture; raises FastGSError."""
    again = "delete it to refine the cameras again"
    with reading(path, again):
        values = read_json(path, advice=again)
        if values["capture"] != _name(capture):
            return None
        cameras = {}
        for view, entry in values["cameras"].items():
            where = f"{path}: the camera of {view}"
            cameras[view] = {"turn": poses.numbers(entry["turn"], (3,), where).tolist(),
                             "shift": poses.numbers(entry["shift"], (3,), where).tolist(),
                             "focal": poses.number(entry["focal"], where, 0.5, 2.0),
                             "unsure": poses.number(entry.get("unsure", 0.0), where, 0.0, 1.0)}
        return {"cameras": cameras, **{name: poses.number(values[name], f"{path}: {name}")
                                    for name in ("before", "after") if name in values}}


def found_by_tracks(capture: Capture, store: Any, settings: Settings, say: Callable[[str], None] = print,
                    progress: Callable[[int, int], None] = lambda done, of: None) -> dict:
    """See refinement(); raises FastGSError where pycolmap is missing, or pictures cannot be read."""
    shots = by_view(capture.films)
    if len(shots) < LEAST_VIEWS or not all(map(_stands, shots.values())):
        return NOTHING
    first = {view: each[0] for view, each in shots.items()}
    given, lenses = [shot.camera for shot in first.values() if shot.camera is not None], [_lens(shot) for shot in first.values()]
    before = after = np.nan
    for tracks, sizes, moved in tracked(capture, store, settings, list(shots), progress):
        if len(tracks) < ENOUGH:
            continue
        rig = rig_of(given, lenses, sizes)
        start = _moved(rig, moved)
        better, before, after, used = compared(start, tracks, moved)
        if settings.poses == "auto" and len(tracks) >= CERTAIN and before - after < BY / 2 and not moved:
            break
    if len(tracks) < ENOUGH or np.isnan(before):
        say(f"cameras: as they were given, because their pictures have too little in common to refine them ({len(tracks)} points)")
        return NOTHING
    for k in moved:
        far = float(np.linalg.norm(better.centres[k] - rig.centres[k]))
        say(f"cameras: {list(first)[k]} looks elsewhere than its calibration says, as after a bump: it is turned by "
            f"{_degrees(better, rig)[k]:.2f} degrees{f' and moved by {far:.2g}' if far > MOVED * capture.extent else ''}")
    if not after < (BETTER * before if settings.poses == "auto" else before) or (settings.poses == "auto" and before - after < BY):
        others = "the others are " if moved else ""
        say(f"cameras: {others}as they were given; they fit their pictures to {before:.2f} pixels, refined ones to {after:.2f}")
        if not moved:
            return NOTHING
        used &= np.isin(np.arange(len(used)), list(moved))
        better, after = replace(better, shrink=start.shrink), before
    else:
        say(f"cameras: {int(used.sum())} refined by features that they see together, which now fit to {after:.2f} pixels instead of "
            f"{before:.2f}; turned by up to {_degrees(better, start).max():.2f} degrees, focal lengths changed by up to "
            f"{100 * np.abs(1 / better.shrink - 1).max():.2f} %")
    turns, focal = bundle.turned(better, rig), 1 / better.shrink
    unsure = AROUND * after / rig.pixels.min(1)
    changes = {view: {"turn": np.round(turns[k], 10).tolist(), "shift": np.round(better.centres[k] - rig.centres[k], 10).tolist(),
                      "focal": round(float(focal[k]), 10), "unsure": round(float(unsure[k]), 10)}
               for k, view in enumerate(first) if used[k]}
    return {"cameras": changes, "before": round(before, 4), "after": round(after, 4)}


def tracked(capture: Capture, store: Any, settings: Settings, views: Sequence[str],
            progress: Callable[[int, int], None] = lambda done, of: None,
            ) -> Iterator[tuple[bundle.Tracks, np.ndarray, dict[int, np.ndarray]]]:
    """The tracks of features in the views' pictures of one moment, and then of all that are looked at; the focal lengths [V, 2] of
    these pictures in pixels; and world-to-camera [4, 4] of the views, by number, that were bumped.

    progress(done, of) is called for each picture and for each moment's matches.
    """
    by_frame: dict = {}
    for shot in capture.films:
        by_frame.setdefault(shot.frame, []).append(shot)
    most = max(map(len, by_frame.values()))
    frames = [frame for frame, shots in sorted(by_frame.items()) if len(shots) == most]
    moments = [by_frame[frame] for frame in spread(frames, int(np.clip(PICTURES // most, 1, MOMENTS)))]
    moments = [[enlarged(capture, shot) for shot in shots] for shots in moments]
    of, done = sum(map(len, moments)) + len(moments), count(1)
    progress(0, of)
    extract = features.extractor()
    pixels, camera, point, rays, slopes, points = np.ones((len(views), 2)), [], [], [], [], 0
    again: dict[int, np.ndarray] = {}
    for number, shots in enumerate(moments):
        store.fill(shots=shots)
        found = []
        for shot in shots:
            image, small, inside = picture(capture, store, settings, shot, features.LARGEST_SIDE)
            places, descriptors = extract(image)
            if inside is not None:
                good = sample(inside[..., None], places)[:, 0] > 0.5
                places, descriptors = places[good], descriptors[good]
            step = max(1, -(-len(places) // MOST_FEATURES))
            found.append(features.Features(places[::step], descriptors[::step], small))
            pixels[views.index(shot.view)] = small.fx, small.fy
            progress(next(done), of)
        moved, groups = bumped.placed_again([bumped.at(each, again.get(views.index(shot.view))) for shot, each in zip(shots, found)], WIDE,
                                             NEIGHBOURS)
        again |= {views.index(shots[k].view): pose for k, pose in moved.items()}
        planes = [(f.places - (f.camera.cx, f.camera.cy)) / (f.camera.fx, f.camera.fy) for f in found]
        tilts = [_by_shrink(shot, plane) for shot, plane in zip(shots, planes)]
        for track in groups:
            if len(track) < (2 if most <= FEW_CAMERAS else 3):
                continue
            camera += [views.index(shots[k].view) for k, _ in track]
            rays += [planes[k][n] for k, n in track]
            slopes += [tilts[k][n] for k, n in track]
            point += [points] * len(track)
            points += 1
        progress(next(done), of)
        if number not in (0, len(moments) - 1):
            continue
        pairs = (np.reshape(each, (-1, 2)) for each in (rays, slopes))
        tracks = bundle.Tracks(np.array(camera, np.int64), np.array(point, np.int64), *pairs)
        known = np.isfinite(tracks.slopes).all(1)
        whole = tracks.by_point(known * 1.0) == tracks.by_point(np.ones(len(known))) if len(tracks) else np.zeros(0, bool)
        yield tracks.take(whole), pixels, again


def compared(rig: bundle.Rig, tracks: bundle.Tracks, moved: Collection[int] = ()) -> tuple[bundle.Rig, float, float, np.ndarray]:
    """The rig that fits tracks better, the errors in pixels of held-back tracks by the given one and by that one, and which cameras [V] are
    surely better in it, or were bumped (moved); the others are as given."""
    points = bundle.placed(rig, tracks)
    good = (bundle.track_errors(rig, tracks, points) < WIDE) & _wide_enough(rig, tracks, points)
    good &= np.cumsum(good) % max(1, -(-int(good.sum()) // MOST)) == 0
    if good.sum() < ENOUGH:
        return rig, np.nan, np.nan, np.zeros(len(rig.lens), bool)
    tracks, points = tracks.take(good), points[good]
    back = np.arange(len(tracks)) % HELD_BACK == HELD_BACK - 1
    rest = tracks.take(~back)
    best, _ = bundle.adjusted(rig, rest, points[~back])
    validation = tracks.take(back)
    sure = _surely_better(rig, best, validation) & np.isin(np.arange(len(rig.lens)), rest.camera)
    focal = np.isin(rig.lens, rig.lens[sure])  # cameras with one lens have one focal length
    sure[list(moved)] = True
    better = replace(best, turns=np.where(sure[:, None, None], best.turns, rig.turns),
                     centres=np.where(sure[:, None], best.centres, rig.centres), shrink=np.where(focal, best.shrink, rig.shrink))
    before, after = (float(np.median(bundle.track_errors(each, validation, bundle.placed(each, validation)))) for each in (rig, better))
    return better, before, after, sure | focal


def _surely_better(given: bundle.Rig, better: bundle.Rig, validation: bundle.Tracks) -> np.ndarray:
    """Which cameras [V] have features in held-back tracks that surely lie nearer to where the better rig's other cameras put their points,
    than by the given camera.  (Where one camera is wrong, points get better for all that see them.)"""
    sure = np.zeros(len(given.lens), bool)
    for camera in range(len(sure)):
        own = validation.camera == camera
        others = ~own & np.isin(validation.point, validation.point[own])
        known = others & (np.bincount(validation.point[others], minlength=len(validation))[validation.point] > 1)
        if not known.any():
            continue
        points, number = np.unique(validation.point[known], return_inverse=True)
        placed = bundle.placed(better, bundle.Tracks(validation.camera[known], number, validation.rays[known], validation.slopes[known]))
        looks = own & np.isin(validation.point, points)
        mine = bundle.Tracks(validation.camera[looks], np.searchsorted(points, validation.point[looks]), validation.rays[looks],
                             validation.slopes[looks])
        before, after = (np.linalg.norm(bundle.misses(rig, mine, placed), axis=1).clip(max=WIDE) for rig in (given, better))
        nearer = before - after
        if len(nearer) >= LEAST_HELD:
            sure[camera] = nearer.mean() > 0 and differs(nearer.mean(), nearer.std() / np.sqrt(len(nearer) - 1), BY)
    return sure


def _degrees(rig: bundle.Rig, given: bundle.Rig) -> np.ndarray:
    """By how much each camera [V] is turned."""
    return np.degrees(np.linalg.norm(bundle.turned(rig, given), axis=1))


def _moved(rig: bundle.Rig, found: Mapping[int, np.ndarray]) -> bundle.Rig:
    """The rig with some cameras at other poses [4, 4]."""
    turns, centres = rig.turns.copy(), rig.centres.copy()
    for k, pose in found.items():
        turns[k], centres[k] = pose[:3, :3], -pose[:3, :3].T @ pose[:3, 3]
    return replace(rig, turns=turns, centres=centres)


def rig_of(cameras: Sequence[Camera], lenses: Sequence, pixels: np.ndarray) -> bundle.Rig:
    """The rig of V cameras; those with equal intrinsics and equal `lenses` (any values) have one focal length.  pixels: see bundle.Rig."""
    matrices = np.array([camera.world_to_camera for camera in cameras])
    kinds = [(c.width, c.height, c.fx, c.fy, c.cx, c.cy, lens) for c, lens in zip(cameras, lenses)]
    known = list(dict.fromkeys(kinds))
    turns = matrices[:, :3, :3]
    return bundle.Rig(turns, -np.einsum("vji,vj->vi", turns, matrices[:, :3, 3]), np.asarray(pixels, np.float64), np.ones(len(cameras)),
                      np.array([known.index(kind) for kind in kinds]))


def _stands(shots: Sequence[Shot]) -> bool:
    """Whether a view has one perspective camera at all times."""
    first: Any = shots[0].camera
    same = {(c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.world_to_camera.tobytes()) for c in (shot.camera for shot in shots) if c}
    turn = first.world_to_camera[:3, :3]
    return len(same) == 1 and not first.orthographic and np.abs(turn @ turn.T - np.eye(3)).max() < 1e-6


def _lens(shot: Shot) -> tuple | None:
    return None if shot.image is None else (shot.image.lens, shot.image.intrinsics)


def _by_shrink(shot: Shot, plane: np.ndarray, step: float = 1e-3) -> np.ndarray:
    """Derivative [F, 2] of places on the image plane by the factor between the given focal length and the true one.

    The lens' picture stays where it is: with a pinhole the places grow by that factor, else it is undistorted with another focal length.
    """
    lens = None if shot.image is None else shot.image.lens
    if lens is None or lens.is_pinhole:
        return plane
    distorted = lens.distort(plane)
    return (lens.undistort(distorted * (1 + step)) - lens.undistort(distorted * (1 - step))) / (2 * step)


def _wide_enough(rig: bundle.Rig, tracks: bundle.Tracks, points: np.ndarray) -> np.ndarray:
    """Whether the rays of each point [P] are LEAST_ANGLE degrees apart, as seen from the first one that tells."""
    rays = points[tracks.point] - rig.centres[tracks.camera]
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
    ends = np.append(np.searchsorted(tracks.point, np.arange(len(tracks))), len(tracks.point))
    return np.array([features.widest_angle(rays[a:b]) > features.LEAST_ANGLE for a, b in pairwise(ends)])


def _name(capture: Capture) -> str:
    return str(Path(capture.path).resolve())

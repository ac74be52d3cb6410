# SPDX-License-Identifier: GPL-3.0-or-later
"""Starting points over space and time from the pictures: triangulated features bound the scene, or the outlines of a subject that is cut
out; plane sweeps add its surfaces, once more along large planes.

Points that look the same at other moments belong to all times; all others carry the moment at which they were found, and a velocity.
"""
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...cameras.camera import Camera
from ...captures.capture import Capture, Points, Shot, by_view
from ...captures.gains import gains_of
from ...captures.pixels.store import Pixels
from ...training.core.settings import Settings
from ...util.backends import load_backend
from ...util.errors import FastGSError
from ..core.camera_response import CameraResponse, CorrectedStore
from ..core.costs import sweep_side
from ..core.moving_pixels import stands
from ..core.schedule import POINTS, generator
from ..core.targets import cover_of, small_camera, smaller, use_of_mask
from . import features, planes, still, sweep
from .geometry import depth_range, project, sample, visible
from .neighbours import neighbour_distance
from .velocity import in_motion
from .visual_hull import VisualHull

SMALLEST_SIDE = 640
"""Features are looked for in pictures of this size at least, where the files have them: in smaller ones there are few."""
MOMENTS, FEATURE_MOMENTS, WITNESSES = 16, 4, 6
"""Moments of the clip at which surfaces, and features, are looked for; and at which it is asked whether something stays."""
FEW = 30
"""Features at a moment, on average, with fewer than which triangulation has failed."""
FEW_CAMERAS = 6
"""Cameras up to which most of what they film is seen by two of them at best."""
MOST_VIEWS = 24
"""Pictures of a moment that are compared; more are spread evenly."""
SAME_SIDE = np.radians(20)
"""Angle within which a view sees what the mean of other views sees."""
FEATURE_PIXELS = 18_000
"""Pixels of a picture whose features take as long as another part of the work does for a picture: what is left is told by parts."""
COMPANY, LONELY = 16, 4.0
"""Distance to that many nearest points, in medians, beyond which a point is a stray."""
STEADY, MOSTLY = 0.2, 0.8
"""Mean difference of colour (0..1) below which a place looks the same, and the share of the pictures of other moments that must
agree on it for what belongs to all times."""


def triangulated(capture: Capture, store: Any, settings: Settings,
                 progress: Callable[[int, int], None] = lambda done, of: None) -> tuple[Points, str, Any]:
    """At most settings.init_points points, a clause about them, and the store with colours in which cameras agree on them; calls
    progress(done, of) for parts of about the same length: features of moments, and their surfaces that are found, compared and followed.

    Raises FastGSError where the pictures give too few features, and no outlines.
    """
    moments = chosen_moments(capture)
    some = spread(moments, FEATURE_MOMENTS)
    shown_first = some[0][0].camera
    assert shown_first is not None
    slow = max(1, round(shown_first.width * shown_first.height / FEATURE_PIXELS))
    of, done = slow * len(some) + (4 if settings.init_motion else 3) * len(moments) + 1, 0

    def tick(parts: int = 1) -> None:
        nonlocal done
        done += parts
        progress(done, of)

    progress(0, of)
    found, corrected = _features(capture, store, settings, some, lambda: tick(slow))
    how, bounds = f"{len(found)} features triangulated", found.xyz
    if len(found) < FEW * len(some):
        how, bounds = "outlines of the subject", _within_outlines(capture, store, settings, some)
        if len(bounds) < FEW:
            raise FastGSError(f"{capture.path}: only {len(found)} features could be triangulated at {len(some)} moments.")
        found = found.take(slice(0))
    else:
        store = corrected
    if found.t is None or not np.isfinite(found.t).all():
        return evenly(found, settings.init_points), how, store
    side = sweep_side(max(map(len, moments)))
    pictures = [[picture(capture, store, settings, shot, side) for shot in shots] for shots in moments]
    near, far = depths_of(bounds, capture)
    few = few_cameras(moments)
    centres = capture.centres() if few else None
    depths = []
    for shown in pictures:
        depths.append(sweep.swept(shown, near, far))
        tick()
    witnesses = 2 if few else 3
    standing = None
    if not few and stand_still(moments):
        standing, large = still.standing(([picture(capture, store, settings, shot, still.SIDE) for shot in its] for its in zip(*moments)),
                                         near, far, settings.seed)
    else:
        known = [xyz for k in spread(range(len(moments)), FEATURE_MOMENTS) for xyz, _ in sweep.surfaces(pictures[k], depths[k], witnesses)]
        large = planes.large(np.concatenate(known), settings.seed)
    tick()
    for k, shown in enumerate(pictures):
        depths[k] = planes.laid(shown, depths[k], large, near, far)
        tick()
    steady_ones, timed, swept = [], [], 0
    for k, shots in enumerate(moments):
        clouds = [Points(xyz, rgb, np.full(len(xyz), shots[0].t))
                  for xyz, rgb in sweep.surfaces(pictures[k], depths[k], witnesses)]
        swept += sum(map(len, clouds))
        cloud = drawn(joined([found.take(found.t == shots[0].t), *clouds]), 2 * settings.init_points, settings.seed, k)
        agree, against = votes(cloud, pictures[k], depths[k], few)
        cloud = among_others(cloud.take(agree > 2 * against), centres)
        others = spread([i for i in range(len(moments)) if i != k], WITNESSES)
        elsewhere = [votes(cloud, pictures[i], depths[i], few) for i in others]
        agree, against = np.sum(elsewhere, 0) if elsewhere else np.zeros((2, len(cloud)))
        steady = (agree > 0) & (agree >= MOSTLY * (agree + against))
        steady_ones.append(cloud.take(steady))
        timed.append(cloud.take(~steady))
        tick()
    if settings.init_motion:
        def seen(cloud: Points, k: int) -> np.ndarray:
            agree, against = votes(cloud, pictures[k], depths[k], few)
            return agree > against

        at_rest, timed = timed, []
        for k in range(len(at_rest)):
            timed.append(in_motion(at_rest, k, seen))
            tick()
    steadily = evenly(among_others(joined(steady_ones) if standing is None else standing, centres), settings.init_points // 2)
    share = (settings.init_points - len(steadily)) // len(timed)
    always = Points(steadily.xyz, steadily.rgb, np.full(len(steadily), np.nan))
    how += f", {swept} places on surfaces that pictures agree on, at {len(moments)} moments"
    return joined([always, *(drawn(cloud, share, settings.seed, k) for k, cloud in enumerate(timed))]), how, store


def _features(capture: Capture, store: Any, settings: Settings, moments: list[list[Shot]],
              tick: Callable[[], None]) -> tuple[Points, CorrectedStore]:
    """Points triangulated from features at these moments, and the store with colours in which cameras agree on these points; tick() is
    called after each moment.

    Features are found whatever the exposures are; the plane sweep compares colours.
    """
    extract, few = features.extractor(), few_cameras(moments)
    clouds, looks, toward = [], [], []
    for shots in moments:
        pictures = [picture(capture, store, settings, enlarged(capture, shot) if few else shot, features.LARGEST_SIDE) for shot in shots]
        found = []
        for image, camera, inside in pictures:
            places, descriptors = extract(image)
            good = sample(inside[..., None], places)[:, 0] > 0.5 if inside is not None else np.ones(len(places), bool)
            found.append(features.Features(places[good], descriptors[good], camera))
        xyz, tracks = features.triangulated(found, 2 if few else min(len(shots), 3))
        shown = [sample(image, project(camera, xyz)[0]) for image, camera, _ in pictures]
        for row, (point, track) in enumerate(zip(xyz, tracks)):
            views = [k for k, _ in track]
            looks.append({shots[k].view: shown[k][row] for k in views})
            rays = np.array([pictures[k][1].centre for k in views]) - point
            mean = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).sum(0)
            toward.append(mean / max(np.linalg.norm(mean), 1e-12))
        moment = np.nan if len({shot.frame for shot in shots}) > 1 else shots[0].t
        clouds.append(Points(xyz, np.zeros((len(xyz), 3)), np.full(len(xyz), moment)))
        tick()
    points = joined(clouds)
    _look_from_elsewhere(capture, store, settings, moments, points, np.array(toward), looks)
    response = response_of(capture, settings, looks)
    rgb = np.array([np.mean([response.in_model_colours(*pair) for pair in each.items()], 0) for each in looks]).reshape(-1, 3)
    return Points(points.xyz, rgb, points.t), CorrectedStore(store, response)


def _within_outlines(capture: Capture, store: Any, settings: Settings, moments: list[list[Shot]]) -> np.ndarray:
    """Places [P, 3] that lie within a subject's outlines in all pictures of a moment; none where pictures are not cut out."""
    if any(shown_part(capture, settings, shot, store.pixels(shot)) is None for shot in moments[0]):
        return np.zeros((0, 3))
    hull = VisualHull(capture, store)
    return np.concatenate([hull.cells(shots[0].frame) for shots in moments])


def response_of(capture: Capture, settings: Settings, looks: list[dict[str, np.ndarray]]) -> CameraResponse:
    """How cameras differ, from the colours [3] of points in the views that see them (captures/gains.py)."""
    views = capture.training_views
    place = {view: k for k, view in enumerate(views)}
    table = np.full((len(looks), len(views), 3), np.nan)
    for row, each in zip(table, looks):
        for view, colour in each.items():
            row[place[view]] = colour
    return CameraResponse.initial(views, capture.clip.frame_count, settings, gains_of(table))


def _look_from_elsewhere(capture: Capture, store: Any, settings: Settings, moments: list[list[Shot]], points: Points, toward: np.ndarray,
                         looks: list[dict[str, np.ndarray]]) -> None:
    """Add the colours that points have in views which are not among the moments' pictures, at the points' own moments.

    toward  [P, 3] mean directions to the cameras that see the points: what is seen from much the same side is not hidden there
    """
    compared, times = {shot.view for shots in moments for shot in shots}, {shots[0].frame: shots[0].t for shots in moments}
    for view, shots in by_view(capture.training).items():
        for shot in [shot for shot in shots if view not in compared and shot.frame in times]:
            image, camera, inside = picture(capture, store, settings, shot, features.LARGEST_SIDE)
            places, _ = project(camera, points.xyz)
            away = camera.centre - points.xyz
            near = (away * toward).sum(1) > np.cos(SAME_SIDE) * np.linalg.norm(away, axis=1)
            for k in np.flatnonzero(near & visible(camera, points.xyz) & (points.t == times[shot.frame])):
                if inside is None or sample(inside[..., None], places[k:k + 1])[0, 0] > 0.5:
                    looks[k][view] = sample(image, places[k:k + 1])[0]


def votes(cloud: Points, pictures: Sequence[tuple], depths: Sequence[Any], few: bool = False) -> np.ndarray:
    """Counts [2, P] of a moment's pictures that agree with each point, and that contradict it (they see through it, or another colour).

    A picture in which something is before the point says nothing.  few: one whose neighbours nowhere look alike there says nothing either,
    for with few cameras that is often because none of them shows the place.
    """
    found = np.zeros((2, len(cloud)), np.int64)
    for (image, camera, _), its in zip(pictures, depths):
        if its is not None:
            load_backend("cpu").vote(cloud.xyz, cloud.rgb, camera, image, its.depth, its.cost, sweep.AGREE, STEADY,
                                     sweep.ALIKE if few else np.inf, *found)
    return found


def drawn(points: Points, most: int, seed: int, *key: int) -> Points:
    """At most so many of the points, drawn at random: each surface keeps its share; an even spacing would prefer stray points."""
    if len(points) <= most:
        return points
    return points.take(np.sort(generator(seed, POINTS, 2, *key).choice(len(points), most, replace=False)))


def among_others(points: Points, centres: np.ndarray | None = None) -> Points:
    """The points without isolated ones and small isolated groups: surfaces have many neighbours.

    centres  [V, 3] of few cameras: distances count by how far away the nearest of them is, for the same pixels are farther apart on a
             far wall
    """
    if len(points) <= COMPANY:
        return points
    apart = neighbour_distance(points.xyz, count=COMPANY)
    if centres is not None:
        apart = apart / np.maximum(np.min([np.linalg.norm(points.xyz - centre, axis=1) for centre in centres], 0), 1e-12)
    return points.take(apart <= LONELY * np.median(apart))


def chosen_moments(capture: Capture) -> list[list[Shot]]:
    """The films' shots at up to MOMENTS evenly spread frames, grouped by frame; with one shot per frame, one group of all times."""
    by_frame: dict[int, list[Shot]] = {}
    films = capture.films or capture.scan
    for shot in films:
        by_frame.setdefault(shot.frame, []).append(shot)
    frames = [frame for frame, shots in sorted(by_frame.items()) if len(shots) >= 2]
    if not frames:
        return [spread(films, MOST_VIEWS)]
    return [spread(by_frame[frame], MOST_VIEWS) for frame in spread(frames, MOMENTS)]


def spread(values: Sequence, most: int) -> list:
    """At most so many items of a list, evenly spread."""
    if len(values) <= most:
        return list(values)
    return [values[i] for i in np.round((np.arange(most) + 0.5) * len(values) / most - 0.5).astype(int)]


def picture(capture: Capture, store: Any, settings: Settings, shot: Shot, side: int) -> tuple[np.ndarray, Camera, np.ndarray | None]:
    """A shot's rgb with its longer side at most `side`, the camera at that size, and the mask [h, w] of valid pixels (None: all)."""
    assert shot.camera is not None
    pixels = store.pixels(shot)
    reduction = -(-max(pixels.rgb.shape[:2]) // side)
    inside = shown_part(capture, settings, shot, pixels)
    known = pixels.valid if pixels.least is None else ~pixels.least.any(-1) & (True if pixels.valid is None else pixels.valid)
    if known is not None:
        inside = known.astype(np.float32) * (1 if inside is None else inside)
    return (np.ascontiguousarray(smaller(pixels.rgb, reduction)), small_camera(shot.camera, reduction),
            None if inside is None else smaller(inside, reduction))


def few_cameras(moments: list[list[Shot]]) -> bool:
    """Whether the moments have few pictures: two that agree are enough then, and more is asked of what contradicts them."""
    return 1 < max(map(len, moments)) <= FEW_CAMERAS and len({shot.frame for shot in moments[0]}) == 1


def stand_still(moments: list[list[Shot]]) -> bool:
    """Whether all moments have the same cameras at the same places, often enough to tell what stands still."""
    first = moments[0]
    return len(moments) >= still.FEWEST and all(
        [shot.view for shot in shots] == [shot.view for shot in first] and all(map(stands, shots, first)) for shots in moments)


def enlarged(capture: Capture, shot: Shot) -> Shot:
    """The shot with a picture of SMALLEST_SIDE pixels, or as large as its file: for runs that train on smaller ones."""
    camera = shot.camera
    assert camera is not None
    factor = min(SMALLEST_SIDE / max(camera.width, camera.height), 1 / capture.scale)
    if factor <= 1:
        return shot
    return replace(shot, camera=camera.stretched(round(camera.width * factor), round(camera.height * factor)))


def shown_part(capture: Capture, settings: Settings, shot: Shot, pixels: Pixels) -> np.ndarray | None:
    """The share of each pixel [h, w] that masks leave of a picture; None: all of it."""
    use = use_of_mask(settings, capture, shot, pixels.mask)
    if use == "around" and pixels.mask is not None:
        return 1 - pixels.mask
    return pixels.mask if use == "only" else cover_of(use, pixels)


def depths_of(xyz: np.ndarray, capture: Capture) -> tuple[float, float]:
    """Nearest and farthest depth of the points in all cameras, widened for surfaces that have no features."""
    depths = np.concatenate([project(shot.camera, xyz)[1][visible(shot.camera, xyz)] for shot in spread(capture.training, 64)])
    if len(depths) < FEW:
        return depth_range(capture)
    low, high = np.percentile(depths, (2, 98))
    return 0.6 * low, 2 * high


def joined(clouds: list[Points]) -> Points:
    """All points, with their times, and with their velocities where one of the clouds has some."""
    xyz, rgb, t = (np.concatenate([getattr(cloud, name) for cloud in clouds]) for name in ("xyz", "rgb", "t"))
    if all(cloud.velocity is None for cloud in clouds):
        return Points(xyz, rgb, t)
    velocity = [np.zeros_like(cloud.xyz) if cloud.velocity is None else cloud.velocity for cloud in clouds]
    return Points(xyz, rgb, t, velocity=np.concatenate(velocity))


def evenly(points: Points, most: int) -> Points:
    """At most so many of the points, evenly spread: the first in each cell of the finest grid that gives no more."""
    if len(points) <= most:
        return points
    low = points.xyz.min(0)
    coarse, fine = max(float(np.ptp(points.xyz, axis=0).max()), 1e-12), 0.0
    best = np.arange(min(most, 1))
    for _ in range(14):
        size = np.sqrt(coarse * fine) if fine else coarse / 32
        cell = np.minimum((points.xyz - low) / size, 2**20).astype(np.int64)
        first = np.unique(cell @ np.array([1, 2**21, 2**42]), return_index=True)[1]
        if len(first) <= most:
            coarse, best = size, first
        else:
            fine = size
    return points.take(np.sort(best))

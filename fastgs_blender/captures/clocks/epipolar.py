# SPDX-License-Identifier: GPL-3.0-or-later
"""Compares the clocks of two calibrated cameras by what moves in each epipolar plane.

A plane through the centres of two cameras cuts both pictures in a line.  What moves in that plane is on both lines at the same moment, and
the plane at the edge of a moving thing touches it in both pictures, however far apart the cameras stand.  So the share of motion by plane
and frame is nearly the same function for both cameras, shifted by their clocks ("motion barcodes", Ben-Artzi et al. 2016).

    occupancy  0..1 of each pixel and frame: how far it is from its median over time, above the noise
    profile    [K, F] of a camera in a pair: how much of the K planes is occupied
    lag        the shift of one profile against the other with the least truncated square of the difference; what only one camera sees
               is cut off.  (Shifts by a few planes as well, for calibrations that are not exact, made lags worse: up and down moves at
               the same speed cancel such errors, while a shift of planes is as good as one of time for what moves evenly.)

Absolute differences would give a median of lags.  A fast edge comes into each plane at a whole frame in both pictures, so that the median
would be a whole number of frames.
"""
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from ...cameras.camera import Camera
from ...util.errors import FastGSError
from ...util.threads import gathered
from ..capture import Capture, Shot, by_view
from ..pixels import decoding
from .lags import Pair, between

Pictures = Callable[[list[Shot], Camera], Iterable[tuple[Shot, np.ndarray]]]
"""Gives the pictures [h, w, 3 or more] of shots, uint8, uint16 or float32 in 0..1, in any order; the camera is theirs, but small."""

SIDE, MOST_FRAMES, LEAST_FRAMES = 320, 96, 12
"""Pictures are shrunk to this; frames that are compared, from the middle of a longer clip; frames that two clips must have in common."""
NEIGHBOURS = 6
"""Cameras that each one is compared with: the nearest ones."""
LEAST_SHARE = 1 / 3
"""Frames of these that a camera must have pictures of: one camera a moment in turn (D-NeRF's splits) tells no clock, two rates do."""
PLANES, LEAST_PLANES, LEAST_PIXELS = 96, 6, 200
"""Epipolar planes of a pair; those in which something must move in both cameras; pixels that must see what the other camera may see."""
NOISE, SOLID = 2.0, 8.0
"""Differences from the median over time, in units of the noise, at which a pixel begins to count and counts in full."""
FULL = 3.0
"""Occupied pixels of a plane that make it about two thirds occupied."""
MOVES, CUT = 0.25, 0.5
"""Least change of a plane's profile over the clip, in sum, for it to count; largest difference of two profiles that counts."""
PARTS = 8
"""Parts of the clip, each of which is left out once for the standard deviation of the lag."""
ALONE = 0.1
"""How much lower the least difference must be than at shifts of more than two frames, as a share of the median difference."""
FINE = 0.05
"""Frames between two shifts that are tried near the best whole one."""
MOST_LAG = 24
"""Frames of the largest lag that is looked for."""
LEAST_ERROR, COARSE = 0.05, 144
"""Standard deviation of a pair's lag at best, in frames (measured on a dome of 31 genlocked cameras); pictures whose longer side has fewer
pixels than this give worse ones."""
DEPTHS = np.array([0.3, 0.5, 0.7, 0.85, 1.0, 1.15, 1.3, 1.6, 2.0, 3.0])
"""Depths at which a pixel's ray may be seen by the other camera, in units of the cameras' distance from what they look at."""


def pairs(capture: Capture, progress: Callable[[int, int], None] = lambda done, of: None,
          pictures: Pictures | None = None) -> tuple[list[str], list[Pair]]:
    """The views that stand still and have a pose, and the lags of pairs of them, by their places in that list.

    A pair that tells nothing is left out.  pictures: gives the pictures of shots; None: they are decoded
    progress  called as progress(done, of) for each picture
    Raises FastGSError where a picture cannot be decoded.
    """
    standing = _standing(capture)
    views = list(standing)
    cameras = {view: _shrunk(shots[0].camera) for view, shots in standing.items() if shots[0].camera is not None}
    if capture.clip.frame_count < LEAST_FRAMES or len(views) < 2:
        return views, []
    occupied = _occupancies(standing, cameras, pictures or _decoded, progress)
    centres = np.array([cameras[view].centre for view in views])
    depths = DEPTHS * np.linalg.norm(centres - capture.focus, axis=1).mean()
    found = []
    for i, j in _neighbours(centres):
        profiles = _profiles(cameras[views[i]], cameras[views[j]], occupied[i], occupied[j], depths)
        if profiles is not None and (lag := lag_of(*profiles)) is not None:
            coarse = max(1.0, COARSE / max(cameras[views[i]].width, cameras[views[i]].height))
            found.append(Pair(i, j, lag[0], float(np.hypot(lag[1], LEAST_ERROR * coarse)), lag[2]))
    return views, found


def _standing(capture: Capture) -> dict[str, list[Shot]]:
    """By view: its shots in the middle of the clip; only views that stand still and film most of the time."""
    begin = max((capture.clip.frame_count - MOST_FRAMES) // 2, 0)
    shots = by_view(shot for shot in capture.shots if begin <= shot.frame < begin + MOST_FRAMES)
    least = max(2, LEAST_SHARE * min(capture.clip.frame_count, MOST_FRAMES))
    return {view: each for view, each in shots.items() if len(each) >= least and all(map(_stands_as(each[0].camera), each))}


def _stands_as(first: Camera | None) -> Callable[[Shot], bool]:
    return lambda shot: (first is not None and shot.camera is not None and not first.orthographic
                         and bool((shot.camera.world_to_camera == first.world_to_camera).all()))


def _shrunk(camera: Camera) -> Camera:
    factor = min(1.0, SIDE / max(camera.width, camera.height))
    return camera.stretched(max(1, round(camera.width * factor)), max(1, round(camera.height * factor)))


def _decoded(shots: list[Shot], small: Camera) -> Iterator[tuple[Shot, np.ndarray]]:
    """Decodes pictures as the small camera would have taken them."""
    by_source = {shot.image: shot for shot in shots}
    for shot, found in decoding.decode([replace(shot, camera=small, mask=None) for shot in shots], 1.0):
        if isinstance(found, FastGSError):
            raise found
        yield by_source[shot.image], found


def _occupancies(standing: dict[str, list[Shot]], cameras: dict[str, Camera], pictures: Pictures,
                 progress: Callable[[int, int], None]) -> list[np.ndarray]:
    """Of each view: its occupancy() [pixels, F]; a frame that it lacks is the one before."""
    total, done = sum(map(len, standing.values())), dict.fromkeys(standing, 0)
    numbers = [shot.frame for shots in standing.values() for shot in shots]
    first, last = min(numbers), max(numbers)

    def work(view: str) -> np.ndarray:
        small, frames = cameras[view], {}
        for shot, picture in pictures(standing[view], small):
            most = 1 if picture.dtype == np.float32 else np.iinfo(picture.dtype).max
            grey = picture[..., :3].mean(2, dtype=np.float32) / np.float32(most)
            frames[shot.frame] = decoding.shrink(grey, (small.height, small.width)).reshape(-1)
            done[view] += 1
        known = frames[min(frames)]
        return occupancy(np.stack([known := frames.get(f, known) for f in range(first, last + 1)], 1))

    return gathered([partial(work, view) for view in standing], lambda: progress(sum(done.values()), total))


def occupancy(frames: np.ndarray) -> np.ndarray:
    """How far each pixel is from its median over time, above the noise, uint8: 255 is full; frames [pixels, F] in 0..1."""
    noise = 1.5 * float(np.median(np.abs(np.diff(frames, axis=1)))) + 2 / 255
    away = np.abs(frames - np.median(frames, axis=1, keepdims=True))
    return (255 * np.clip((away / noise - NOISE) / (SOLID - NOISE), 0, 1) + 0.5).astype(np.uint8)  # of all views at once: bytes, not floats


def _neighbours(centres: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of cameras: each with those that stand nearest, but not where it stands itself."""
    apart = np.linalg.norm(centres[:, None] - centres, axis=-1)
    apart[apart < 1e-6 * max(apart.max(), 1e-30)] = np.inf
    nearest = np.argsort(apart, axis=1, kind="stable")[:, :NEIGHBOURS]
    return sorted({(min(i, int(j)), max(i, int(j))) for i, row in enumerate(nearest) for j in row if np.isfinite(apart[i, j])})


def _profiles(a: Camera, b: Camera, in_a: np.ndarray, in_b: np.ndarray, depths: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The profiles [K, F] of two cameras; None where they cannot see the same.

    A plane is named by its angle around the line through both centres, a pixel's plane by its ray: its depth does not matter.
    """
    along = b.centre - a.centre
    along /= np.linalg.norm(along)
    ahead = a.world_to_camera[2, :3] + b.world_to_camera[2, :3]
    ahead = ahead - ahead @ along * along
    if np.linalg.norm(ahead) < 1e-3:
        return None
    ahead /= np.linalg.norm(ahead)
    aside = np.cross(along, ahead)
    angles, seen = [], []
    for camera, other in ((a, b), (b, a)):
        rays = _rays(camera)
        angles.append(np.arctan2(rays @ aside, rays @ ahead))
        seen.append(_seen_by(other, camera.centre, rays, depths))
    if min(each.sum() for each in seen) < LEAST_PIXELS:
        return None
    low = max(angle[each].min() for angle, each in zip(angles, seen))
    high = min(angle[each].max() for angle, each in zip(angles, seen))
    if not high > low:
        return None
    of_a, of_b = (_profile(np.floor((angle - low) / (high - low) * PLANES), each, occupied)
                  for angle, each, occupied in zip(angles, seen, (in_a, in_b)))
    return of_a, of_b


def _rays(camera: Camera) -> np.ndarray:
    """Directions [pixels, 3] in the world, of depth 1."""
    y, x = (np.mgrid[:camera.height, :camera.width] + 0.5).reshape(2, -1)
    return np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], 1) @ camera.world_to_camera[:3, :3]


def _seen_by(other: Camera, centre: np.ndarray, rays: np.ndarray, depths: np.ndarray) -> np.ndarray:
    """Whether another camera has a point of each ray [pixels, 3] in its picture."""
    turn, place = other.world_to_camera[:3, :3], other.world_to_camera[:3, :3] @ centre + other.world_to_camera[:3, 3]
    turned = turn @ rays.T
    seen = np.zeros(len(rays), bool)
    for depth in depths:
        x, y, z = place[:, None] + depth * turned
        u, v = other.fx * x + (other.cx * z), other.fy * y + other.cy * z
        seen |= (z > 0) & (u >= 0) & (u < other.width * z) & (v >= 0) & (v < other.height * z)
    return seen


def _profile(plane: np.ndarray, seen: np.ndarray, occupied: np.ndarray) -> np.ndarray:
    """How much of each plane is occupied, 0..1 [K, F]; plane [pixels] their numbers, occupied [pixels, F] as occupancy() gives it."""
    rows = np.flatnonzero(seen & (plane >= 0) & (plane < PLANES))
    rows = rows[np.argsort(plane[rows], kind="stable")]
    numbers, starts = np.unique(plane[rows], return_index=True)
    sums = np.zeros((PLANES, occupied.shape[1]), np.float32)
    sums[numbers.astype(int)] = np.add.reduceat(occupied[rows], starts, axis=0, dtype=np.float32) / 255
    return 1 - np.exp(-sums / FULL)


def lag_of(a: np.ndarray, b: np.ndarray) -> tuple[float, float, float] | None:
    """(lag in frames, its standard deviation, how much it stands alone) of two profiles [K, F]: b at f shows what a shows at f + lag.

    None where too little moves in both, or other shifts fit nearly as well.
    """
    frames = a.shape[1]
    a, b = _smoothed(a), _smoothed(b)
    moves = (np.abs(np.diff(a)).sum(1) > MOVES) & (np.abs(np.diff(b)).sum(1) > MOVES)
    most = min(MOST_LAG, frames - LEAST_FRAMES, frames // 2)
    if moves.sum() < LEAST_PLANES or most < 1:
        return None
    lags = np.arange(-most, most + 1.0)
    a, b = a[moves], b[moves]
    costs = _mean(_costs(a, b, lags).sum(1))
    at = int(costs.argmin())
    others = np.abs(lags - lags[at]) > 2
    alone = float((costs[others].min() - costs[at]) / max(np.median(costs), 1e-9)) if others.any() else 0.0
    if alone < ALONE:
        return None
    fine = lags[at] + np.arange(-24, 25) * FINE
    parts = _costs(a, b, fine, fine[[0, -1]])
    whole = parts.sum(1)
    lag = _lowest(fine, _mean(whole))
    without = np.array([_lowest(fine, _mean(whole - parts[:, part])) for part in range(PARTS)])
    spread = np.sqrt((PARTS - 1) / PARTS * ((without - without.mean())**2).sum())  # jackknife
    return lag, float(spread), alone


def _smoothed(profile: np.ndarray) -> np.ndarray:
    """With weights 1, 2, 1 over time: interpolation between frames blurs too, and must not make fractions fit better."""
    padded = np.pad(profile, ((0, 0), (1, 1)), "edge")
    return (padded[:, :-2] + 2 * padded[:, 1:-1] + padded[:, 2:]) / 4


def _costs(a: np.ndarray, b: np.ndarray, lags: np.ndarray, ends: np.ndarray | None = None) -> np.ndarray:
    """Sums [lags, PARTS, 2] of the truncated squares of differences over planes and frames, and how many frames; ends: lags between which
    all compare the same frames, or None."""
    frames = np.arange(a.shape[1])
    part = frames * PARTS // len(frames)
    found = np.zeros((len(lags), PARTS, 2))
    for n, lag in enumerate(lags):
        low, high = (lag, lag) if ends is None else ends
        inside = (frames + low >= 0) & (frames + high <= frames[-1])
        cost = np.minimum((between(a, (frames + lag)[inside]) - b[:, inside])**2, CUT**2).sum(0)
        found[n] = np.stack([np.bincount(part[inside], cost, PARTS), np.bincount(part[inside], minlength=PARTS)], 1)
    return found


def _mean(sums: np.ndarray) -> np.ndarray:
    return np.where(sums[..., 1] > 0, sums[..., 0] / np.maximum(sums[..., 1], 1), np.inf)


def _lowest(lags: np.ndarray, costs: np.ndarray) -> float:
    """Where the costs [lags] are lowest: the vertex of a parabola through half a frame around the lowest."""
    at = int(costs.argmin())
    near = np.abs(lags - lags[at]) < 0.5 + FINE
    square, slope, _ = np.polyfit(lags[near] - lags[at], costs[near], 2)
    return float(lags[at] + (np.clip(-slope / (2 * square), -0.5, 0.5) if square > 0 else 0.0))

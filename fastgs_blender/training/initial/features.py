# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangulates points of one moment: COLMAP's SIFT features, matched along epipolar lines and triangulated by pycolmap.

The poses are known, so that a match need only be looked for along a line, and nothing random decides: the same pictures give
the same points in every run.
"""
import signal
import threading
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from ...cameras.camera import Camera
from ...util import groups
from ...util.errors import FastGSError

LARGEST_SIDE = 1024
"""Pictures are shrunk to this for features."""
MOST_FEATURES = 4000
"""In one picture."""
PEAK = 0.002
"""Least contrast of a feature; a third of COLMAP's, because small pictures have few of them."""
ON_LINE = 1.5
"""Pixels within which a match lies by its epipolar line, and a point by its features."""
ALIKE, RATIO = 0.8, 0.88
"""Least cosine of two matching descriptors, and the most that the next best may reach of the best one's distance."""
LEAST_ANGLE, MOST_ANGLE = 2.0, 60.0
"""Degrees between the rays of a point, and between the viewing directions of two cameras that are compared."""
APART = 4.0
"""Pixels between two features from which they are of different things, and not one of two sizes."""
ALONE, DISTINCT = 0.4, 0.8
"""Least distance of a feature's descriptor from all others of its picture, and the largest share of it that a match may be apart."""
NEIGHBOURS = 4
"""Cameras with which each one is compared where not all pairs are."""


Track = list[tuple[int, int]]
"""Features that show the same point: (picture, feature), at most one of a picture."""


@dataclass(frozen=True, eq=False)
class Features:
    """The features of one picture: places [F, 2] in pixels, unit descriptors [F, 128], and the camera at that picture size."""

    places: np.ndarray
    descriptors: np.ndarray
    camera: Camera


def pycolmap_module() -> ModuleType:
    """pycolmap; raises FastGSError where it is not installed."""
    terminate = signal.getsignal(signal.SIGTERM)
    try:
        import pycolmap
    except ImportError as error:
        raise FastGSError(f"triangulating needs pycolmap, which cannot be imported ({error}): pip install pycolmap") from error
    # Its log takes SIGTERM for a crash; a training run saves and stops.
    if terminate is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, terminate)
    # It reports every step, and its failures are told in our own words.
    pycolmap.logging.minloglevel = pycolmap.logging.FATAL  # type: ignore[assignment]
    return pycolmap


def extractor() -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """A function from a picture [h, w, 3] in 0..1 to (places [F, 2], descriptors [F, 128])."""
    pycolmap = pycolmap_module()
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu, options.num_threads = False, 1
    options.sift.max_num_features, options.sift.peak_threshold = MOST_FEATURES, PEAK
    sift = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)

    def extract(rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        keypoints, described = sift.extract_from_uint8_array(np.uint8(rgb @ np.array([0.299, 0.587, 0.114]) * 255 + 0.5))
        places, descriptors = pycolmap.keypoints_to_matrix(keypoints), np.asarray(described.data, np.float32)
        order = np.lexsort(places.T[::-1])
        lengths = np.linalg.norm(descriptors, axis=1, keepdims=True)
        return places[order, :2].astype(np.float64), (descriptors / np.maximum(lengths, 1e-9))[order]

    return extract


def fundamental(a: Camera, b: Camera) -> np.ndarray:
    """F [3, 3] with x_b^T F x_a = 0 for the pixels (homogeneous) of two cameras."""
    between = b.world_to_camera @ np.linalg.inv(a.world_to_camera)
    x, y, z = between[:3, 3]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.linalg.inv(matrix(b)).T @ cross @ between[:3, :3] @ np.linalg.inv(matrix(a))


def matrix(camera: Camera) -> np.ndarray:
    """The intrinsic matrix [3, 3]."""
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])


def matches(a: Features, b: Features, within: float = ON_LINE) -> np.ndarray:
    """Pairs [M, 2] of features that are each other's best along the epipolar lines, and better than the next.

    within  pixels from these lines; inf: in the whole pictures, which is what a calibration is compared with; some of these are wrong
    """
    if not len(a.places) or not len(b.places):
        return np.zeros((0, 2), np.int64)
    likeness = a.descriptors @ b.descriptors.T
    if np.isfinite(within):
        lines = np.c_[a.places, np.ones(len(a.places))] @ fundamental(a.camera, b.camera).T
        lines /= np.maximum(np.linalg.norm(lines[:, :2], axis=1, keepdims=True), 1e-12)
        away = lines.astype(np.float32) @ np.c_[b.places, np.ones(len(b.places))].T.astype(np.float32)
        np.copyto(likeness, np.float32(-1), where=np.abs(away, out=away) >= within)
    best = likeness.argmax(1)
    rows = np.arange(len(best))
    top = likeness[rows, best]
    mutual = top == likeness.max(0)[best]
    likeness[rows, best] = -1
    # A second orientation of the same feature is no rival.
    rival = likeness.argmax(1)
    same = np.linalg.norm(b.places[rival] - b.places[best], axis=1) < 0.5
    likeness[rows[same], rival[same]] = -1
    distance, next_distance = (np.sqrt(np.maximum(2 - 2 * value, 0)) for value in (top, likeness.max(1)))
    good = np.flatnonzero(mutual & (top > ALIKE) & (distance < RATIO * next_distance))
    good = good[np.sort(np.unique(best[good], return_index=True)[1])]  # of equal ones, the first
    return np.stack([good, best[good]], 1)


def alone(each: Features, apart: float = APART) -> np.ndarray:
    """Distances [F] of descriptors from the most similar one that lies `apart` pixels or more away in the same picture."""
    likeness = each.descriptors @ each.descriptors.T
    near = np.ones(likeness.shape, bool)
    for column in each.places.astype(np.float32).T:
        near &= np.abs(column[:, None] - column) < apart
    likeness[near] = -1
    return np.sqrt(np.maximum(2 - 2 * likeness.max(1, initial=-1), 0))


def distinct(rows: np.ndarray, a: Features, b: Features, alone_a: np.ndarray, alone_b: np.ndarray) -> np.ndarray:
    """Of matches [M, 2], those of features that no other one in their own picture looks like: alone() of both pictures."""
    one, other = rows.T
    apart = np.sqrt(np.maximum(2 - 2 * np.einsum("mk,mk->m", a.descriptors[one], b.descriptors[other]), 0))
    alone = np.minimum(alone_a[one], alone_b[other])
    return rows[(alone > ALONE) & (apart < DISTINCT * alone)]


def neighbours(cameras: Iterable[Camera], count: int = NEIGHBOURS) -> list[tuple[int, int]]:
    """Pairs of cameras that may show the same: each with the `count` that stand and look most alike.

    Features of cameras that look in directions far apart look different: what matches there does so by chance.
    """
    poses = np.array([camera.world_to_camera for camera in cameras])
    centres = -np.einsum("nij,ni->nj", poses[:, :3, :3], poses[:, :3, 3])
    apart = np.linalg.norm(centres[:, None] - centres, axis=-1)
    turned = np.arccos(np.clip(poses[:, 2, :3] @ poses[:, 2, :3].T, -1, 1))
    unlike = np.where(turned < np.radians(MOST_ANGLE), apart / max(apart.max(), 1e-12) + turned, np.inf)
    np.fill_diagonal(unlike, np.inf)
    pairs = {(min(i, j), max(i, j)) for i in range(len(poses)) for j in np.argsort(unlike[i], kind="stable")[:count].tolist()
             if np.isfinite(unlike[i, j])}
    return sorted(pairs)


def tracks(features: list[Features], within: float = ON_LINE, count: int | None = None) -> list[Track]:
    """Groups of features that show the same point.

    within  see matches();  count: each picture is compared with so many neighbours; None: with all
    """
    near = neighbours([f.camera for f in features], len(features) if count is None else count)
    pairs = [((i, p), (j, q)) for i, j in near for p, q in matches(features[i], features[j], within).tolist()]
    found = []
    for group in groups.joined(sorted({feature for pair in pairs for feature in pair}), pairs):
        often = Counter(picture for picture, _ in group)
        once = [entry for entry in group if often[entry[0]] == 1]
        if len(once) >= 2:
            found.append(once)
    return found


def triangulated(features: list[Features], least_views: int, given: list[Track] | None = None) -> tuple[np.ndarray, list[Track]]:
    """Points [P, 3] of the given tracks, or else of tracks(), and what remains of each track: pictures that the point lies before, within
    ON_LINE of the features, at a wide enough angle."""
    pycolmap = pycolmap_module()
    poses = np.array([f.camera.world_to_camera[:3] for f in features])
    lenses = np.array([matrix(f.camera) for f in features])
    centres = np.array([f.camera.centre for f in features])
    rays = [np.c_[f.places, np.ones(len(f.places))] @ np.linalg.inv(lens).T for f, lens in zip(features, lenses)]
    rays = [each / np.linalg.norm(each, axis=1, keepdims=True) for each in rays]
    points, seen = [], []
    for track in tracks(features, count=NEIGHBOURS) if given is None else given:
        entries = np.array(track)
        toward, places = (np.array([each[k][n] for k, n in track]) for each in (rays, [f.places for f in features]))
        while len(entries) >= least_views:
            pictures = entries[:, 0]
            point = pycolmap.triangulate_multi_view_point(list(poses[pictures]), toward)
            if point is None:
                break
            point = np.ravel(point)
            local = poses[pictures] @ [*point, 1.0]
            image = np.einsum("nij,nj->ni", lenses[pictures], local)
            with np.errstate(divide="ignore", invalid="ignore"):
                errors = np.where(local[:, 2] > 0, np.linalg.norm(image[:, :2] / image[:, 2:] - places, axis=1), np.inf)
            if errors.max() < ON_LINE:
                if widest_angle(centres[pictures] - point) > LEAST_ANGLE:
                    points.append(point)
                    seen.append(list(map(tuple, entries.tolist())))
                break
            better = errors < errors.max()
            entries, toward, places = entries[better], toward[better], places[better]
    return np.array(points).reshape(-1, 3), seen


def reprojection(features: Features, number: int, pose: np.ndarray, point: np.ndarray) -> float:
    """Pixels between a feature and the image of a point; inf behind the camera."""
    x, y, z = pose[:, :3] @ point + pose[:, 3]
    if z <= 0:
        return np.inf
    camera = features.camera
    return float(np.hypot(*(np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy]) - features.places[number])))


def widest_angle(rays: np.ndarray) -> float:
    """The largest angle between any two of the rays [n, 3], in degrees."""
    unit = rays / np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
    return float(np.degrees(np.arccos(np.clip((unit @ unit.T).min(), -1, 1))))

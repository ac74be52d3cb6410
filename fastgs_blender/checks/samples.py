# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples the pictures that a check measures: a few moments of each camera, decoded once, scaled down and kept in memory."""
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..cameras.camera import Camera
from ..captures.capture import Capture, Shot, by_view
from ..captures.pixels import decoding, undistortion
from ..captures.pixels.plain import background
from ..captures.pixels.probe import facts
from ..captures.pixels.store import LOOKS
from ..training.core.targets import WHOLE, small_camera, smaller
from ..training.initial.dense import spread
from ..util.errors import FastGSError
from . import blur
from .matching import Matches, matched
from .reprojection import Judged, judged

SIDE = 1024
"""Pixels of the longer side to which pictures are scaled down after their sharpness was measured."""
MOMENTS, MOST_VIEWS, MOST_PIXELS = 5, 40, 200_000_000
"""Moments of each camera, cameras (more are spread evenly), and pixels in all that are kept."""
THUMBNAIL = 320


@dataclass(frozen=True, eq=False)
class Sample:
    """One sampled picture.

    rgb      [h, w, 3] uint8, display sRGB, with its longer side at most SIDE
    camera   of that size; None in a capture without poses
    valid    [h, w] bool, False where the lens has no picture, or the picture is cut out; None: it counts everywhere
    shrunk   by how much the picture was shrunk
    blur     Gaussian blur in pixels of the picture as it is trained on, NaN where it has no texture
    """

    shot: Shot
    rgb: np.ndarray
    camera: Camera | None
    valid: np.ndarray | None
    shrunk: int
    blur: float


@dataclass(eq=False)
class Inspection:
    """A capture and its sampled pictures; checks ask it for pictures and matches.

    progress(stage, share) is called while something takes long, share in 0..1
    scaled        whether a scale of the pictures was asked for, which a draft keeps then
    samples       by view, ordered by time
    plain         whether they show a plain background, which training cuts out (captures/pixels/plain.py)
    """

    capture: Capture
    progress: Callable[[str, float], None] = lambda stage, share: None
    scaled: bool = False
    samples: dict[str, list[Sample]] = field(default_factory=dict)
    unreadable: list[str] = field(default_factory=list)
    plain: bool = False

    @property
    def views(self) -> list[str]:
        """The names of the sampled cameras."""
        return list(self.samples)

    @property
    def training(self) -> list[str]:
        """The sampled cameras that are used for training."""
        kept = set(self.capture.held_out_views)
        return [view for view in self.samples if view not in kept]

    @cached_property
    def matches(self) -> Matches:
        """Features that pictures have in common; raises FastGSError where pycolmap is not installed."""
        return matched(self.samples, self.capture.posed, lambda share: self.progress("comparing pictures", share))

    @cached_property
    def judged(self) -> Judged:
        """The cameras whose calibration is wrong, measured by matches()."""
        return judged(self.matches, self.views)

    @property
    def misplaced(self) -> list[str]:
        """The cameras whose pose is surely wrong; none where nobody can tell."""
        try:
            return self.judged.wrong if self.capture.posed else []
        except FastGSError:  # without pycolmap
            return []

    @property
    def thumbnails(self) -> dict[str, np.ndarray]:
        """A small picture [h, w, 3] uint8 of each camera."""
        return {view: thumbnail(samples[len(samples) // 2].rgb) for view, samples in self.samples.items()}

    def words(self) -> str:
        """The number of sampled pictures, moments and cameras, in words."""
        pictures = sum(map(len, self.samples.values()))
        moments = max(map(len, self.samples.values()), default=0)
        some = f" of {len(self.capture.views)}" if len(self.samples) < len(self.capture.views) else ""
        return (f"Looked at: {pictures} pictures of the {len(self.capture)} there are, {moments} moments of {len(self.samples)}{some} "
                "cameras; what happens between them is not known.")


def thumbnail(rgb: np.ndarray) -> np.ndarray:
    """A picture with its longer side at most THUMBNAIL."""
    reduction = max(1, -(-max(rgb.shape[:2]) // THUMBNAIL))
    return (smaller(rgb, reduction) + 0.5).astype(np.uint8) if reduction > 1 else rgb


def sample(inspection: Inspection) -> None:
    """Decode the sampled pictures; those that cannot be decoded are listed in `unreadable`."""
    capture = inspection.capture
    shots, kept = by_view(capture.shots), set(capture.held_out_views)
    views = spread([view for view in shots if view not in kept], MOST_VIEWS)
    views = [view for view in shots if view in views or (view in kept and len(kept) <= MOST_VIEWS // 4)]
    try:
        height, width, _ = decoding.shape(capture.shots[0], capture.scale)
    except FastGSError:
        height, width = SIDE, SIDE
    pixels = height * width // reduction_of(height, width)**2
    moments = int(np.clip(MOST_PIXELS // max(pixels * len(views), 1), 2, MOMENTS))
    frames = spread(sorted({shot.frame for shot in capture.shots}), moments)
    chosen = [shot for view in views for shot in _near(shots[view], frames)]
    inspection.samples = {view: [] for view in views}
    for done, (shot, found) in enumerate(decoding.decode([replace(shot, mask=None) for shot in chosen], capture.scale), 1):
        inspection.progress("reading pictures", done / len(chosen))
        if isinstance(found, FastGSError):
            inspection.unreadable.append(str(found))
        else:
            inspection.samples[shot.view].append(_sample(shot, found))
    inspection.samples = {view: sorted(samples, key=lambda sample: sample.shot.frame)
                          for view, samples in inspection.samples.items() if samples}
    _cut_out(inspection)
    if not inspection.samples:
        raise FastGSError(f"{capture.path}: none of its pictures can be read: "
                          f"{inspection.unreadable[0] if inspection.unreadable else 'none is there.'}")


def reduction_of(height: int, width: int) -> int:
    """The whole factor by which a picture of that size is shrunk."""
    return max(1, -(-max(height, width) // SIDE))


def _cut_out(inspection: Inspection) -> None:
    """Samples before a plain background are valid where something stands before it."""
    samples = [sample for each in inspection.samples.values() for sample in each]
    some = spread([sample for sample in samples if not facts(sample.shot.image).alpha], LOOKS)
    found = background([sample.rgb / np.float32(255) for sample in some], [sample.valid for sample in some]) if some else None
    if found is None:
        return
    inspection.plain = True
    for view, each in inspection.samples.items():
        shown = [found.cut_out(sample.rgb / np.float32(255))[1] > WHOLE for sample in each]
        inspection.samples[view] = [replace(sample, valid=seen if sample.valid is None else seen & sample.valid)
                                    for sample, seen in zip(each, shown)]


def _near(shots: list[Shot], frames: list[int]) -> list[Shot]:
    """Of a view's shots, those nearest to the frames, each once."""
    return list({shot.frame: shot for frame in frames for shot in [min(shots, key=lambda shot: abs(shot.frame - frame))]}.values())


def _sample(shot: Shot, found: np.ndarray) -> Sample:
    rgb = found[..., :3] if found.dtype == np.uint8 else (found[..., :3] >> 8).astype(np.uint8)
    valid = undistortion.valid(shot)
    if found.shape[2] > 3:  # an alpha channel: the rest is no picture
        seen = found[..., 3] > np.iinfo(found.dtype).max // 2
        valid = seen if valid is None else valid & seen
    reduction = reduction_of(*rgb.shape[:2])
    small = (smaller(rgb, reduction) + 0.5).astype(np.uint8) if reduction > 1 else np.ascontiguousarray(rgb)
    camera = None if shot.camera is None else small_camera(shot.camera, reduction)
    inside = None if valid is None else smaller(valid.astype(np.float32), reduction) > 0.99
    return Sample(shot, small, camera, inside, reduction, blur.blur_of(rgb, valid))

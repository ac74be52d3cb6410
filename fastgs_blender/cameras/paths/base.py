# SPDX-License-Identifier: GPL-3.0-or-later
"""CameraPath: a camera for each frame of a shot, whatever program the path came from."""
import json
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...util.arguments import in_words
from ...util.errors import FastGSError, LossWarning
from ...util.outputs import replacing
from .. import poses
from ..camera import LARGEST_SIDE, Camera
from ..lens import Intrinsics, Lens, pinhole_for

MOST_FRAMES = 1_000_000
"""Frames of a path whose file holds each of them."""
MOST_INTERPOLATED = 43_200
"""Frames that are made from a file's keyframes: half an hour at 24 frames per second.  A file of a few bytes could ask for any number."""
SQUARE, CENTRED = 1e-5, 1e-3
"""Up to where pixels are square (share of a side) and a lens is not shifted (pixels): Blender's cameras are of single precision."""


@dataclass(frozen=True, eq=False)
class CameraPath:
    """A camera path; OpenCV axes, pixel centres at +0.5, as everywhere.

    cameras      one for each frame
    fps          frames per second, None where the file has none
    start_frame  what the file calls its first frame
    axes         of the world that the poses are in, as in GaussianModel
    keys         the numbers (from 0, fractions allowed) and cameras of the keyframes from which the file's program makes its frames;
                 empty where the file holds frames only
    names        of the cameras, where these are no frames of one that moves; else empty
    """

    cameras: Sequence[Camera]
    fps: float | None = None
    start_frame: int = 1
    axes: str = "RDF"
    keys: Sequence[tuple[float, Camera]] = ()
    names: Sequence[str] = ()

    def __post_init__(self) -> None:
        if not 1 <= len(self.cameras) <= MOST_FRAMES:
            raise FastGSError(f"a camera path has from 1 to {MOST_FRAMES} frames, not {len(self.cameras)}.")
        if len(self.names) not in (0, len(self.cameras)):
            raise FastGSError(f"a camera path of {len(self.cameras)} cameras has as many names, not {len(self.names)}.")

    def __len__(self) -> int:
        return len(self.cameras)


@dataclass(frozen=True)
class Picture:
    """The picture's size in pixels and the frame rate, for files that state none."""

    width: int = 1920
    height: int = 1080
    fps: float = 24.0

    def __post_init__(self) -> None:
        if not (1 <= self.width <= LARGEST_SIDE and 1 <= self.height <= LARGEST_SIDE and np.isfinite(self.fps) and self.fps > 0):
            raise FastGSError(f"a camera path needs a picture of at least 1 x 1 pixel and a positive frame rate, not {in_words(self)}.")


def camera_to_world(camera: Camera) -> np.ndarray:
    """[4, 4] in OpenCV axes."""
    return poses.inverse(camera.world_to_camera)


def opengl_to_world(camera: Camera) -> np.ndarray:
    """Camera-to-world [4, 4] of a camera that looks along -z with y up."""
    return camera_to_world(camera) @ poses.OPENGL


def symmetric(width: int, height: int, focal: float, pose: np.ndarray) -> Camera:
    """A camera with square pixels and its principal point in the middle."""
    return Camera(width, height, focal, focal, width / 2, height / 2, pose)


def focal_of(degrees: object, side: float, where: str) -> float:
    """Focal length in pixels of an angle of view over `side` pixels."""
    angle = poses.number(degrees, f"{where}: its field of view", 0.01, 179.9)
    return side / 2 / np.tan(np.radians(angle) / 2)


def degrees_of(focal: float, side: float) -> float:
    """Angle of view in degrees over `side` pixels."""
    return float(np.degrees(2 * np.arctan(side / 2 / focal)))


def check_length(file: Path, frames: float) -> None:
    """Raises FastGSError for more frames than are made from keyframes."""
    if not frames <= MOST_INTERPOLATED:
        raise FastGSError(f"{file}: its keyframes make a path of {frames:.6g} frames, which is too long: at most {MOST_INTERPOLATED} "
                          "are made from keyframes; shorten the path, or lower its frame rate.")


def check_frames(file: Path, entries: Sequence) -> None:
    """Raises FastGSError for a file with more frames than a path may have."""
    if len(entries) > MOST_FRAMES:
        raise FastGSError(f"{file}: it has {len(entries)} frames, and a camera path has at most {MOST_FRAMES}.")


def named(entries: list[dict], path: CameraPath) -> list[dict]:
    """The entries of a file's cameras with their names, where the path has some; programs ignore what they do not know."""
    return [{**entry, "name": name} for entry, name in zip(entries, path.names, strict=True)] if path.names else entries


def names_of(entries: Sequence, key: str = "name") -> tuple[str, ...]:
    """What named() added; nothing where not all entries have a name."""
    names = tuple(entry[key] for entry in entries if isinstance(entry, dict) and isinstance(entry.get(key), str))
    return names if len(names) == len(entries) else ()


def frame_names(path: CameraPath) -> list[str]:
    """The frames' numbers with as many digits each, so that names sort as the frames go; from 0 where the first is below it."""
    first = max(path.start_frame, 0)
    digits = max(5, len(str(first + len(path) - 1)))
    return [f"{first + i:0{digits}}" for i in range(len(path))]


def pinholes(views: Sequence[tuple[Lens, Intrinsics, np.ndarray]], kind: str) -> list[Camera]:
    """Cameras of lenses, intrinsics and poses (world-to-camera); a LossWarning says that distortion is left out."""
    if not all(lens.is_pinhole for lens, *_ in views):
        warnings.warn(f"{kind}: the distortion of its lenses is left out; these cameras are pinholes.", LossWarning, stacklevel=4)
    return [pinhole_for(Lens(), intrinsics, pose) for _, intrinsics, pose in views]


def warn_of_rate(path: CameraPath, kind: str) -> None:
    """LossWarning for what formats without times cannot hold."""
    if path.fps and not path.names and len(path) > 1:
        warnings.warn(f"{kind} holds no frame rate; it is left out ({path.fps:.6g} frames a second).", LossWarning, stacklevel=3)


def warn_of_losses(path: CameraPath, kind: str) -> None:
    """LossWarning for what formats without intrinsics cannot hold."""
    off = max(max(abs(c.cx - c.width / 2), abs(c.cy - c.height / 2)) for c in path.cameras)
    if off > CENTRED:
        warnings.warn(f"{kind} holds no shift of the lens; it is left out ({off:.3g} pixels).", LossWarning, stacklevel=3)
    if max(abs(c.fx / c.fy - 1) for c in path.cameras) > SQUARE:
        warnings.warn(f"{kind} holds no pixels that are not square; the vertical focal length is written.", LossWarning, stacklevel=3)
    if len({(c.width, c.height) for c in path.cameras}) > 1:
        warnings.warn(f"{kind} has one size for all frames; the first is written.", LossWarning, stacklevel=3)


def write_json(file: str | Path, values: object, indent: int | None = None) -> None:
    """A JSON file, written aside and renamed."""
    text = json.dumps(values, indent=indent, allow_nan=False)
    with replacing([Path(file)]) as (part,):
        part.write_text(text + "\n", encoding="utf-8")

# SPDX-License-Identifier: GPL-3.0-or-later
"""Source: the file of one picture, its frame where that is a video, and the lens it was taken with."""
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..cameras.lens import Intrinsics, Lens
from ..util.errors import FastGSError
from ..util.reading import open_file


def beginning(file: Path, endings: Sequence[str], count: int = 4096) -> bytes:
    """The first bytes of a file with one of these endings; none of another one, or where there is no such file."""
    if file.suffix.lower() not in endings or not file.is_file():
        return b""
    with open_file(file) as stream:
        return stream.read(count)


def files_at(path: Path, wanted: Callable[[Path], object], inside: str = "*/*") -> list[Path]:
    """The wanted files: the path itself, or those in that folder or, if there are none, those in folders in it."""
    if not path.is_dir():
        return [path] if wanted(path) else []
    return [file for file in sorted(path.iterdir()) if wanted(file)] or [file for file in sorted(path.glob(inside)) if wanted(file)]


def only(path: Path, files: Sequence[Path], what: str) -> Path:
    """The one file; raises FastGSError where there are others."""
    if len(files) != 1:
        raise FastGSError(f"{path}: there are {len(files)} {what} in it; give the file to be used instead.")
    return files[0]


PICTURES = (".png", ".jpg", ".jpeg", ".exr")
VIDEOS = (".mp4", ".mov", ".m4v", ".mkv", ".avi", ".webm", ".mpg", ".mpeg", ".mts", ".ts")
COLOURS = ("auto", "srgb", "linear")


@dataclass(frozen=True)
class Source:
    """One picture as its file holds it, and the lens it was taken with.

    path        a picture or a video
    frame       number of the frame in the video, in the order in which they are shown, from 0; None: a picture
    lens        distortion to be undone
    intrinsics  of the file's full size, with the lens; None: unknown (a capture without poses)
    colour      what the numbers mean: display sRGB, scene-linear, or auto (EXR is linear, all else sRGB)
    gain        factor on the display values, for cameras whose exposure differs
    """

    path: Path
    frame: int | None = None
    lens: Lens = field(default_factory=Lens)
    intrinsics: Intrinsics | None = None
    colour: str = "auto"
    gain: float = 1.0

    def __str__(self) -> str:
        return f"{self.path}" if self.frame is None else f"{self.path}, frame {self.frame}"

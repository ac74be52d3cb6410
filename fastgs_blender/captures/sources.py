# SPDX-License-Identifier: GPL-3.0-or-later
"""Source: the file of one picture, its frame where that is a video, and the lens it was taken with."""
from dataclasses import dataclass, field
from pathlib import Path

from ..cameras.lens import Intrinsics, Lens

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

    def __str__(self):
        return f"{self.path}" if self.frame is None else f"{self.path}, frame {self.frame}"

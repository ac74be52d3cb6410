# SPDX-License-Identifier: GPL-3.0-or-later
"""Where pixels come from: a picture file, or one frame of a video.  Nothing is decoded here."""
from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..cameras.lens import Intrinsics, Lens
from ..util.errors import FastGSError

PICTURES = (".png", ".jpg", ".jpeg", ".exr")
VIDEOS = (".mp4", ".mov", ".m4v", ".mkv", ".avi", ".webm", ".mpg", ".mpeg", ".mts", ".ts")
COLOURS = ("auto", "srgb", "linear")


@dataclass(frozen=True)
class Source:
    """The pixels of one picture as its file holds them, and the lens they were taken with.

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


def numbered_pictures(folder: Path) -> dict[int, Path]:
    """Picture files of a folder by the last number in their names; those without one are passed over.

    Raises FastGSError where two have the same number.
    """
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        numbers = re.findall(r"\d+", path.stem)
        if path.suffix.lower() not in PICTURES or path.name.startswith(".") or not numbers:
            continue
        number = int(numbers[-1])
        if number in found:
            raise FastGSError(f"{folder}: {found[number].name} and {path.name} both are picture {number}; leave one of them.")
        found[number] = path
    return found


def frame_range(numbered: Iterable[dict[int, Path]], where: Path) -> tuple[int, int]:
    """First number and count of frames of a rig, from its cameras' numbered_pictures(); (0, 0) where there are none.

    Raises FastGSError where nearly all would be missing, as with numbers that count something else.
    """
    numbered = [found for found in numbered if found]
    if not numbered:
        return 0, 0
    start = min(map(min, numbered))
    count = max(map(max, numbered)) - start + 1
    if count > 1000 + 10 * max(map(len, numbered)):
        raise FastGSError(f"{where}: the pictures' numbers go from {start} to {start + count - 1} with most of them missing; number the "
                          "frames of all cameras alike.")
    return start, count


def video_frames(path: Path, problems: list[str], **settings) -> tuple[Sequence[Source], float | None]:
    """One Source per frame of a video, and its frames per second; settings are the Source's others.

    For a video that cannot be read: none, None, and a sentence more in problems.
    """
    from .pixels.video import index

    try:
        found = index(path)
    except FastGSError as error:
        problems.append(str(error))
        return (), None
    return [Source(path, i, **settings) for i in range(found.count)], found.fps

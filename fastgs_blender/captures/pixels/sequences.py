# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds sequences of pictures on disk: the numbered files of a folder, the frames of a video."""
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from ...util.errors import FastGSError
from ..sources import PICTURES, VIDEOS, Source
from .video import index

CHAPTER = re.compile(r"(?:GOPR|(G[A-Z])(\d\d))(\d{4})")
"""Names of a GoPro's files: chapter and number of a film, GX020010; its older ones begin with GOPR0010 and go on with GP010010."""
CARDS = ("DCIM", "PRIVATE", "M4ROOT")
"""Folders in which cameras keep their films on a memory card."""
MOST_DIGITS = 18
"""Of a picture's number: more would not fit 64 bits."""


class Unreadable(str):
    """A clause about a film that cannot be read.  Its frames are missing pictures, of which a few may be (rigs.py)."""

    __slots__ = ()


def numbered_pictures(folder: Path) -> dict[int, Path]:
    """Picture files of a folder by the last number in their names; files without a number are left out.

    Raises FastGSError where two have the same number.
    """
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        numbers = re.findall(r"\d+", path.stem)
        if path.suffix.lower() not in PICTURES or path.name.startswith(".") or not numbers:
            continue
        number = int(numbers[-1][-MOST_DIGITS:])
        if number in found:
            raise FastGSError(f"{folder}: {found[number].name} and {path.name} both are picture {number}; leave one of them.")
        found[number] = path
    return found


def holds_pictures(folder: Path) -> bool:
    """Whether a folder holds pictures with numbers."""
    return any(p.suffix.lower() in PICTURES and any(c.isdigit() for c in p.stem) for p in folder.iterdir())


def videos_in(folder: Path) -> list[Path]:
    """The videos that lie in a folder."""
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in VIDEOS and p.is_file() and not p.name.startswith("."))


def film_called(folder: Path, name: str) -> Path | None:
    """The video of that name in a folder, with whichever ending, which cameras write in capital letters."""
    return next((p for ending in VIDEOS for p in (folder / f"{name}{ending}", folder / f"{name}{ending.upper()}") if p.is_file()), None)


def films_in(folder: Path) -> list[Path]:
    """The videos in a camera's folder or, where it is a copied memory card (DCIM/100GOPRO), in that; first chapters only."""
    videos = videos_in(folder) or [p for card in CARDS for place in sorted((folder / card).glob("**/")) for p in videos_in(place)]
    return [video for video in videos if _chapters(video)[0][1] == video]


def _chapters(video: Path) -> list[tuple[int, Path]]:
    """The files of a film by the chapters' numbers, in order; a film that no GoPro wrote is one file."""
    own = CHAPTER.fullmatch(video.stem.upper())
    if own is None:
        return [(0, video)]
    each = ((CHAPTER.fullmatch(p.stem.upper()), p) for p in videos_in(video.parent))
    return sorted((int(name[2] or 0), p) for name, p in each if name and (name[1] or "GP", name[3]) == (own[1] or "GP", own[3]))


def film_of(place: Path) -> Path:
    """The film at a place: the video in a folder (one picture beside it is its thumbnail), or its first chapter, else the place itself.

    Raises FastGSError where the folder holds several videos and no sequence of pictures.
    """
    if place.is_file() or len(numbered_pictures(place)) > 1:
        return place
    videos = films_in(place)
    if len(videos) > 1:
        raise FastGSError(f"{place}: it holds {len(videos)} videos, {videos[0].name} and {videos[1].name} among them; join the parts of a "
                          "film, or leave one video in a camera's folder.")
    return videos[0] if videos else place


def frame_range(numbered: Iterable[dict[int, Path]], where: Path) -> tuple[int, int]:
    """First number and count of frames of a rig, from its cameras' numbered_pictures(); (0, 0) where there are none.

    Raises FastGSError where most pictures between the first and the last number are missing.
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


def numbered_sources(numbered: dict[int, Path], where: Path, **settings: Any) -> list[Source | None]:
    """One Source per number from the lowest to the highest, None where there is no picture; settings are the Source's others.

    Raises FastGSError as frame_range() does.
    """
    start, count = frame_range([numbered], where)
    return [Source(numbered[n], **settings) if n in numbered else None for n in range(start, start + count)]


def video_frames(path: Path, faults: list[str], **settings: Any) -> tuple[Sequence[Source], float | None]:
    """One Source per frame of a video and its further chapters, and its frames per second; settings are the Source's others.

    For a video that cannot be read: no sources and None, and a sentence is added to faults.
    """
    try:
        chapters = _chapters(path)
        missing = [n for n in range(min(1, chapters[0][0]), chapters[-1][0]) if n not in dict(chapters)]
        if missing:
            raise FastGSError(f"{chapters[-1][1]}: the chapter {missing[0]} of this film is not there; copy it beside this one, or remove "
                              "the chapters behind the gap.")
    except FastGSError as error:
        faults.append(str(error))
        return (), None
    try:
        found = [(chapter, index(chapter)) for _, chapter in chapters]
    except FastGSError as error:
        faults.append(Unreadable(error))
        return (), None
    return [Source(chapter, i, **settings) for chapter, known in found for i in range(known.count)], found[0][1].fps

# SPDX-License-Identifier: GPL-3.0-or-later
"""Groups the pictures of a transforms.json, which is only a list of pictures, into cameras, and finds the time of each."""
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...util.errors import FastGSError
from ..sources import PICTURES, VIDEOS, Source

FPS = 30.0


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture as the file lists it: its split ("train", "val", "test" or ""), its stated path, pose (world-to-camera) and time.

    source is None where the file is not there.
    """

    split: str
    stated: str
    source: Source | None
    mask: Source | None
    pose: np.ndarray
    time: float | None


def views_of(pictures: Sequence[Picture]) -> list[str]:
    """The name of each picture's view.

    A rig stands still: pictures of one pose at different times are one camera.  Else folders, or names without their last number, tell
    cameras apart; else all pictures of a split are one moving camera; and where two of those show the same time, each is a view.
    """
    timed = any(picture.time is not None for picture in pictures)
    moments = [picture.time if timed else number(picture.stated) for picture in pictures]
    poses = [(picture.split, picture.pose.round(6).tobytes()) for picture in pictures]
    places = [stem(picture.stated).split("/") for picture in pictures]
    names = ([_without_number(parts) for parts in places], ["/".join(parts[:-1]) for parts in places], [parts[-1] for parts in places])
    if 2 <= len(set(poses)) <= len(poses) / 2 and _one_at_a_time(poses, moments):
        return _named(poses, names)
    by_name = [(picture.split, name) for picture, name in zip(pictures, names[0])]
    apart = len({name for _, name in by_name}) > len({picture.split for picture in pictures})
    if apart and _one_at_a_time(by_name, moments) and len(set(moments)) < len(moments):
        return _named(by_name, names)
    splits = [picture.split or "camera" for picture in pictures]
    if timed and _one_at_a_time(splits, moments):
        return splits
    each = short(["/".join(parts) for parts in places])
    counts = Counter(each)
    return [name if counts[name] == 1 else f"{name}-{i}" for i, name in enumerate(each)]


def times_of(pictures: Sequence[Picture], views: Sequence[str]) -> tuple[list[int], Sequence[float | None], float, list[str]]:
    """Frame and t (None: frame / frames) of each picture, frames per second, remarks."""
    stated = [picture.time for picture in pictures if picture.time is not None]
    if len(stated) < len(pictures):
        if stated:
            untimed = next(picture.stated for picture in pictures if picture.time is None)
            raise FastGSError(f"{untimed}: this picture has no time, others have one; give all or none.")
        return _untimed(pictures, views)
    distinct = sorted(set(stated))
    frames = np.searchsorted(distinct, stated).tolist()
    if distinct[0] >= 0 and distinct[-1] <= 1:
        return frames, stated, FPS, []
    gaps = np.diff(distinct)
    even = len(gaps) > 0 and gaps.max() - gaps.min() < 0.02 * gaps.mean()
    fps = float(1 / gaps.mean()) if even and gaps.mean() < 1 else FPS
    note = f"times go from {distinct[0]:g} to {distinct[-1]:g}; they are taken as the frames of a clip"
    if even:
        return frames, [None] * len(frames), fps, [note]
    span = (distinct[-1] - distinct[0]) * len(distinct) / max(1, len(distinct) - 1)
    return frames, [(time - distinct[0]) / (span or 1) for time in stated], fps, [note]


def number(stated: str) -> int:
    """The last number in a picture's name, 0 where there is none."""
    numbers = re.findall(r"\d+", stem(stated).rpartition("/")[2])
    return int(numbers[-1][-9:]) if numbers else 0


def _untimed(pictures: Sequence[Picture], views: Sequence[str]) -> tuple[list[int], Sequence[None], float, list[str]]:
    if len(set(views)) == len(views):
        return [0] * len(pictures), [None] * len(pictures), FPS, ["it states no times: all pictures show one moment"]
    numbers = [number(picture.stated) for picture in pictures]
    frames = np.searchsorted(sorted(set(numbers)), numbers).tolist()
    return frames, [None] * len(numbers), FPS, ["it states no times: frames are told by the pictures' numbers"]


def _one_at_a_time(keys: Sequence, moments: Sequence) -> bool:
    """Whether no key has two pictures of one moment."""
    return len(set(zip(keys, moments))) == len(moments)


def _named(keys: Sequence, names: Sequence[Sequence[str]]) -> list[str]:
    """Names for groups of pictures with the same key: the first kind of names that is the same within a group and differs between them."""
    groups = list(dict.fromkeys(keys))
    for candidate in names:
        pairs = set(zip(keys, candidate))
        if len(pairs) == len(groups) == len(set(candidate)) and all(candidate):
            return short(candidate)
    return [f"cam{groups.index(key):02}" for key in keys]


def stem(stated: str) -> str:
    """The path without ending and leading dots."""
    path = re.sub(rf"({'|'.join(map(re.escape, (*PICTURES, *VIDEOS)))})$", "", stated.replace("\\", "/"), flags=re.IGNORECASE)
    return "/".join(part for part in path.split("/") if part not in ("", "."))


def _without_number(parts: list[str]) -> str:
    """images/cam00_0001 -> images/cam00; cam00/0001 -> cam00"""
    last = re.sub(r"[_\-. ]?[a-zA-Z]*\d+$", "", parts[-1])
    return "/".join([*parts[:-1], *([last] if last else [])])


def short(names: Sequence[str]) -> list[str]:
    """The names without the folders in front and behind that all of them share."""
    parts = [name.split("/") for name in names]
    while all(len(p) > 1 for p in parts) and len({p[0] for p in parts}) == 1:
        parts = [p[1:] for p in parts]
    while all(len(p) > 1 for p in parts) and len({p[-1] for p in parts}) == 1:
        parts = [p[:-1] for p in parts]
    return ["/".join(p) for p in parts]

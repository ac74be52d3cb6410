# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks a capture's files before training: are they of one size, and do the films run together?  rigs.py left damaged ones out."""
from collections import Counter
from pathlib import Path

from ...cameras.opencv import UNTURN, turned
from ...util.errors import FastGSError
from ..capture import Capture, Shot, by_view
from ..rigs import ranges
from .probe import facts

MOST = 12
"""Problems that one sentence lists."""


def check(capture: Capture) -> None:
    """Raises FastGSError with the list of problems(), if there are any."""
    found = problems(capture)
    if found:
        raise FastGSError(sentence(capture.path, found))


def sentence(path: Path, found: list[str]) -> str:
    """All problems in one sentence that names the capture."""
    clauses = [text.rstrip(".").replace(f"{path}/", "").replace(f"{path}\\", "") for text in found]
    more = [f"and {len(clauses) - MOST} more"] if len(clauses) > MOST else []
    head = "there is a problem" if len(clauses) == 1 else f"there are {len(clauses)} problems"
    return f"{path}: {head} with this capture: {'; '.join(clauses[:MOST] + more)}."


def problems(capture: Capture) -> list[str]:
    """The problems of a capture, a clause each, in the layout's order of views; files' headers are read, pixels are not decoded."""
    found = list(capture.faults)
    sizes: dict[str, Counter] = {}
    for view, shots in by_view(capture.shots).items():
        found += _view_problems(view, shots, sizes.setdefault(view, Counter()), capture)
    if not capture.posed and len(capture.views) < 2:
        found.append("there is only one camera, and poses cannot be found from one")
    return found


def _view_problems(view: str, shots: list[Shot], sizes: Counter, capture: Capture) -> list[str]:
    wrong: dict = {}
    masks: dict = {}
    start = capture.clip.start_frame
    for shot in shots:
        own = facts(shot.image)
        size = own.width, own.height
        sizes[size] += 1
        expected = shot.image.intrinsics
        if expected is not None and size != (expected.width, expected.height):
            wrong.setdefault((size, (expected.width, expected.height)), []).append(shot.frame + start)
        mask = None if shot.mask is None else facts(shot.mask)
        if mask is not None and (mask.width, mask.height) != size:
            masks.setdefault(((mask.width, mask.height), size), []).append(shot.frame + start)
    found = [f"{view} has pictures of {_text(size)} pixels where its calibration is for {_text(want)} (frames {ranges(frames)})"
             f"{f': {UNTURN}' if turned(size, want) else ''}" for (size, want), frames in wrong.items()]
    found += [f"{view} has masks of {_text(size)} pixels for pictures of {_text(want)} (frames {ranges(frames)})"
              for (size, want), frames in masks.items()]
    still = len({id(shot.camera) for shot in shots}) == 1
    if still and len(sizes) > 1 and not wrong:
        found.append(f"{view} has pictures of different sizes: {', '.join(_text(size) for size in sizes)}")
    masked = sum(shot.mask is not None for shot in shots)
    if masked not in {0, len(shots)}:
        bare = [shot.frame + start for shot in shots if shot.mask is None]
        found.append(f"{view} has masks for some of its frames only, not for {ranges(bare)}")
    return found


def _text(size: tuple[int, int]) -> str:
    return f"{size[0]} x {size[1]}"

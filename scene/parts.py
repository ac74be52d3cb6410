# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts: which Gaussians of its file a splat object shows, holds erased, and has selected.

An object stores each of these as a text, packed over all Gaussians of the file.  What it shows of the file becomes a model of its own, once
for each part, and whatever draws, writes or measures the object takes that model as if it were the file's.
"""
import threading
from functools import lru_cache
from weakref import WeakKeyDictionary

import numpy as np

from ..fastgs_blender.model.gaussians import GaussianModel
from ..fastgs_blender.model.sequence import Source
from ..fastgs_blender.rendering.masks import pack_mask, unpack_mask
from ..fastgs_blender.util.errors import FastGSError

OTHER = ("its part was chosen of {:,} Gaussians, and the file now holds {:,}; reload the file where it was, or choose Show "
         "Whole File.")
SEQUENCE = "its part belongs to a model, and the file is now a sequence; choose Show Whole File."

_made: WeakKeyDictionary[GaussianModel, dict[str, GaussianModel]] = WeakKeyDictionary()
_lock = threading.Lock()


def count_of(text: str) -> int | None:
    """How many Gaussians the file had of which a text tells; None: an empty text tells of any."""
    number = text.partition(" ")[0]
    return int(number) if number.isdigit() else None


def trouble(source: Source, text: str) -> str | None:
    """Why a source has no such part, as a sentence; None where it has."""
    if not text:
        return None
    if not isinstance(source, GaussianModel):
        return SEQUENCE
    count = count_of(text)
    return None if count == len(source) else OTHER.format(count or 0, len(source))


def part_of(source: Source, text: str) -> Source:
    """The Gaussians of a part as a model, always the same one; "" is the source itself.  Any thread may call it.  Raises FastGSError."""
    if not text:
        return source
    if reason := trouble(source, text):
        raise FastGSError(reason)
    with _lock:
        known = _made.setdefault(source, {})
        if text not in known:
            known[text] = source.take(rows(text))
        return known[text]


def forget_all_but(texts: set[str]) -> None:
    """Free the models of all other parts."""
    with _lock:
        for known in _made.values():
            for text in known.keys() - texts:
                del known[text]


def rows(part: str) -> np.ndarray:
    """Which Gaussians of its file a part has: [M] ascending."""
    return np.flatnonzero(unpack_mask(part, count_of(part) or 0))


@lru_cache(maxsize=64)
def within(part: str, mask: str) -> str:
    """A mask of the file's Gaussians as one of those of a part; one of another file masks nothing."""
    if not (part and mask):
        return mask
    if count_of(mask) != count_of(part):
        return ""
    return pack_mask(unpack_mask(mask, count_of(part))[rows(part)])


@lru_cache(maxsize=64)
def union(*masks: str) -> str:
    """The mask of what any of some masks of one file has."""
    masks = tuple(mask for mask in masks if mask)
    if len(masks) < 2:
        return masks[0] if masks else ""
    count = count_of(masks[0]) or 0
    return pack_mask(np.any([unpack_mask(mask, count) for mask in masks], 0))


@lru_cache(maxsize=64)
def all_but(mask: str) -> str:
    """The mask of all that a mask has not; of no mask it is none."""
    return pack_mask(~unpack_mask(mask, count_of(mask) or 0)) if mask else ""

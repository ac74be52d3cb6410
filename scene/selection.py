# SPDX-License-Identifier: GPL-3.0-or-later
"""Selects, erases and restores Gaussians of a splat object, and writes files of what is left of it.

The object holds the masks, so that undo and .blend files have them.
"""
from dataclasses import replace
from pathlib import Path

import numpy as np

from .. import fastgs_blender as fg
from ..fastgs_blender.rendering.crops import cropped
from ..fastgs_blender.rendering.filters import hidden
from ..fastgs_blender.rendering.masks import pack_mask, unpack_mask
from ..fastgs_blender.selecting.light import Light
from ..fastgs_blender.selecting.shapes import Ball, Shape, seen_surface, seen_under, touched, under
from . import objects, parts, snapshot, updates

PICKED = "selection", "wanted", "refused", "unsure"
"""Masks of what is selected, of what was drawn over, where Grow to the Thing begins, and of what it was not sure of; other ways to select
forget all but the first."""


def bits(obj, name: str) -> np.ndarray:
    """One of an object's masks ("mask", "selection", "wanted", "refused", "unsure") or its "part": [N] bool of its file's Gaussians."""
    count, text = len(objects.load_one_model(obj, "selected")), getattr(obj.fastgs, name)
    return np.ones(count, bool) if name == "part" and not text else unpack_mask(text, count)


def put(obj, **masks: np.ndarray) -> None:
    """Give an object masks [N] bool, by their names."""
    objects.watch(objects.abspath(obj))
    _set(obj, {name: pack_mask(mask) for name, mask in masks.items()})


def clear(obj) -> None:
    """Select nothing of an object, and forget the strokes."""
    _set(obj, dict.fromkeys(PICKED, ""))


def _set(obj, texts: dict[str, str]) -> None:
    """Set packed masks of an object that are others than it has."""
    for name, text in texts.items():
        if text != getattr(obj.fastgs, name):
            setattr(obj.fastgs, name, text)
            if name in PICKED:
                updates.picked(obj)


def own(obj) -> np.ndarray:
    """Which Gaussians of its file an object has and were not erased: [N] bool."""
    return bits(obj, "part") & ~bits(obj, "mask")


def shown(obj) -> np.ndarray:
    """The same, but for what the object's filters hide."""
    found, filters = own(obj), snapshot.filters_of(obj)
    if filters:
        found[np.flatnonzero(bits(obj, "part"))[hidden(objects.source_of(obj), filters)]] = False
    return found


def drawn(obj, found: np.ndarray, how: str, meant: np.ndarray | None = None) -> bool:
    """Take what was drawn over [N] into the selection: 'SET', 'ADD' or 'SUBTRACT'.  Returns whether anything has changed.

    meant  [N] what Grow to the Thing takes for the stroke; None: the same
    """
    meant = found if meant is None else meant
    before = tuple(getattr(obj.fastgs, name) for name in PICKED)
    put(obj, unsure=bits(obj, "unsure") & ~(found | meant) & (how != 'SET'))
    if how == 'SET':
        put(obj, selection=found, wanted=meant, refused=np.zeros_like(found))
    elif how == 'ADD':
        put(obj, selection=bits(obj, "selection") | found, wanted=bits(obj, "wanted") | meant, refused=bits(obj, "refused") & ~meant)
    else:
        put(obj, selection=bits(obj, "selection") & ~found, wanted=bits(obj, "wanted") & ~meant, refused=bits(obj, "refused") | meant)
    return before != tuple(getattr(obj.fastgs, name) for name in PICKED)


def select(obj, found: np.ndarray, how: str = 'SET') -> int:
    """Select Gaussians [N] of an object otherwise than by strokes: 'SET', 'ADD', 'SUBTRACT' or 'AND'.  Returns how many are selected."""
    before = bits(obj, "selection")
    after = own(obj) & {'SET': found, 'ADD': before | found, 'SUBTRACT': before & ~found, 'AND': before & found}[how]
    clear(obj)
    put(obj, selection=after)
    return int(after.sum())


def erase(obj, found: np.ndarray, hide: bool = True) -> int:
    """Hide Gaussians [N] of an object, or show them again; what is hidden is not selected.  Returns how many have changed."""
    before = bits(obj, "mask")
    after = before | found if hide else before & ~found
    count = int(np.count_nonzero(after != before))
    if count:
        put(obj, mask=after, **{name: bits(obj, name) & ~after for name in PICKED if getattr(obj.fastgs, name)})
    return count


class Sight:
    """What a camera sees of a scene's splats on its frame, and which of them lie under what is drawn in its picture."""

    _last: tuple = (None, {})
    """State of the last view that was asked, and what is known of it: strokes follow each other in one view."""

    def __init__(self, depsgraph, camera: fg.Camera):
        self.camera, self.shown = camera, snapshot.take(depsgraph, rendered=False)
        self.pairs, _ = self.shown.pairs()

    @classmethod
    def forget(cls) -> None:
        """Free what is known of the last view."""
        cls._last = (None, {})

    def _once(self, what: str, make):
        """What make() gives for all splats that are shown, kept while the view stays."""
        c = self.camera
        state = self.shown.state, objects.reloads(), (c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.near, c.far, c.orthographic,
                                                      c.world_to_camera.tobytes())
        if Sight._last[0] != state:
            Sight._last = state, {}
        if what not in Sight._last[1]:
            Sight._last[1][what] = make([instance for _, instance in self.pairs], c)
        return Sight._last[1][what]

    def ball(self, pixel: tuple[float, float], radius: float) -> Ball | None:
        """A ball around what is seen at a pixel, which looks so many pixels large; None where nothing is seen."""
        return Ball.on(self._once("surface", seen_surface), self.camera, pixel, radius)

    def under(self, obj, shape: Shape, through: bool = True, erased: bool = False) -> np.ndarray:
        """Which Gaussians of an object's file it shows under a shape: [N] bool; `erased`: those that were erased, too.

        through  however deep they lie, and not only those that are seen
        """
        viewed = [instance.viewed(self.camera) for _, instance in self.pairs]
        if erased:
            viewed = [replace(instance, settings=replace(instance.settings, mask="")) if item.name == obj.name else instance
                      for (item, _), instance in zip(self.pairs, viewed, strict=True)]
        if not through:
            return self._of(obj, seen_under(viewed, self.camera, shape, None if erased else self._once("light", Light)))
        return self._of(obj, [under(instance, self.camera, shape) if item.name == obj.name else None
                              for (item, _), instance in zip(self.pairs, viewed, strict=True)])

    def touched(self, obj, shape: Shape) -> np.ndarray:
        """Which Gaussians of an object's file make what is seen in a shape, wherever their centres are: [N] bool."""
        viewed = [instance.viewed(self.camera) for _, instance in self.pairs]
        return self._of(obj, touched(viewed, self.camera, shape, self._once("light", Light)))

    def _of(self, obj, found: list) -> np.ndarray:
        """What was found among the Gaussians of each instance, of an object's as those of its file: [N] bool."""
        out = np.zeros(len(objects.load_one_model(obj, "selected")), bool)
        own = parts.rows(obj.fastgs.part) if obj.fastgs.part else slice(None)
        for (item, _), bits in zip(self.pairs, found, strict=True):
            if item.name == obj.name:
                out[own] |= bits
        return out


def hides_anything(obj) -> bool:
    """Whether an object leaves anything of its file out."""
    settings = obj.fastgs
    return bool(settings.part or settings.mask or any(item.use and item.object for item in settings.crops)
                or any(item.use for item in settings.filters))


def write_left(obj, depsgraph, target: str) -> tuple[int, int]:
    """Write what an object's part, mask, filters and crops leave of its file as the file `target`; returns (how many, of how many).

    Raises FastGSError where nothing is left or the file cannot be written, and refuses the file that the object shows.
    """
    source = objects.abspath(obj)
    if Path(target).resolve() == Path(source).resolve():
        raise fg.FastGSError(f"{target}: this is the file that the object shows; choose another name for what is left of it.")
    whole = objects.load_one_model(obj, "written as one file")
    model, settings = objects.source_of(obj), snapshot.settings_of(obj.evaluated_get(depsgraph), depsgraph)
    gone = hidden(model, settings.filters, settings.mask)
    left = cropped(model.take(~gone) if len(gone) else model, settings.crops)
    if not len(left):
        raise fg.FastGSError("the object shows nothing of the model; nothing was written.")
    fg.save(left, target)
    return len(left), len(whole)

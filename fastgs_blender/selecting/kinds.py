# SPDX-License-Identifier: GPL-3.0-or-later
"""The kinds of Gaussians that filters begin with and that are selected by one click: one table for both."""
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..model.framing import inside_backdrop, without_backdrop
from ..model.gaussians import GaussianModel
from ..model.sequence import Source
from ..rendering.filters import Filter, values
from ..util.errors import FastGSError
from .moving import moving, parted

MOST = 1e6
"""The upper end of a range that has none."""
GROWN = ("MOVING", "STATIC")
"""The kinds that are selected by whole things, which takes seconds."""

OF_SUBJECT = ("FLOATERS", "LARGE")
"""The kinds that are selected without the backdrop: a sky's Gaussians lie far apart and are the largest of all."""


class Kind(NamedTuple):
    """A kind of Gaussians: its name, what they are (it goes on behind "Select", "Hide" or "Show only"), and for a model the Filter that
    finds them; keep is set where a filter shows them alone."""

    label: str
    meaning: str
    filter: Callable[[Source], Filter]


def _large(source: Source) -> Filter:
    model = _of_values(source)
    return Filter("SIZE", float(np.percentile(values(model, "SIZE"), 99)) if len(model) else 1.0, MOST)


def _moving(source: Source) -> Filter:
    return Filter("SPEED", _fast(_of_values(source)), MOST, keep=True)


def _still(source: Source) -> Filter:
    return Filter("SPEED", 0.0, _fast(_of_values(source)), keep=True)


def _fast(model: GaussianModel) -> float:
    return parted(model, values(model, "SPEED"))


def _short(source: Source) -> Filter:
    return Filter("LIFETIME", 0.0, 0.1 * _of_values(source).clip.duration)


def _hardly_filmed(source: Source) -> Filter:
    if not source.surroundings.cameras:
        raise FastGSError("the file knows no cameras of its capture; store them with fastgs annotate.")
    return Filter("CAMERAS", 0.0, 2.0)


def _of_values(source: Source) -> GaussianModel:
    if not isinstance(source, GaussianModel):
        raise FastGSError("of a sequence this filter knows no values to begin with; add another one and choose its kind and range.")
    return source


KINDS: dict[str, Kind] = {
    "FLOATERS": Kind("Floaters", "Gaussians that have hardly any others around them", lambda source: Filter("NEIGHBOURS", 0.0, 2.0)),
    "LARGE": Kind("Large", "the hundredth of the Gaussians that is largest", _large),
    "FAINT": Kind("Faint", "Gaussians of an opacity of less than a tenth", lambda source: Filter("OPACITY", 0.0, 0.1)),
    "MOVING": Kind("Moving", "what moves", _moving),
    "STATIC": Kind("Still", "what does not move", _still),
    "SHORT": Kind("Short-Lived", "what is seen for less than a tenth of the clip", _short),
    "COLOUR": Kind("By Colour", "what has nearly a colour, such as that of a screen", lambda source: Filter("COLOUR", 0.0, 0.2)),
    "CAMERAS": Kind("Hardly Filmed", "what fewer than three cameras of the capture have in their pictures", _hardly_filmed),
}
"""In the order of menus."""


def chosen(model: GaussianModel, kind: str, colour: tuple[float, float, float] | None = None) -> np.ndarray:
    """Which Gaussians of a model are of a kind of KINDS: [N] bool.  colour: sRGB, of "COLOUR".  Raises FastGSError.

    What moves are whole things (moving.py); OF_SUBJECT is never the backdrop.
    """
    if kind not in KINDS:
        raise FastGSError(f"the kind {kind!r} of Gaussians is unknown; there are {', '.join(KINDS)}.")
    if kind in GROWN:
        return moving(model) if kind == "MOVING" else ~moving(model)
    found = KINDS[kind].filter(without_backdrop(model) if kind in OF_SUBJECT else model)
    bits = (found if colour is None else replace(found, colour=colour)).holds(model)
    if kind in OF_SUBJECT:
        bits &= np.isin(np.arange(len(model)), inside_backdrop(model))
    return bits

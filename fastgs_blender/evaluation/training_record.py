# SPDX-License-Identifier: GPL-3.0-or-later
"""What a model was trained on, as its file records it: evaluation must not call a picture held out that the model has seen."""
from __future__ import annotations

import json
from dataclasses import dataclass

from ..util.reading import parse_json

KEY = "trained_on"
"""The entry of a model's provenance, JSON: {"views": [names], "scale": factor on the pictures' size}."""


@dataclass(frozen=True)
class TrainingRecord:
    """The views that a model was trained on, and the scale of their pictures.  Its frames are those of the model's own clip."""

    views: frozenset[str]
    scale: float

    def saw(self, view: str, frame: float, frame_count: int) -> bool:
        """Whether the picture of a view at a frame of the model's clip (counted from 0, fractions lie between frames) was trained on."""
        return view in self.views and abs(frame - round(frame)) < 1e-6 and -0.5 < frame < frame_count - 0.5


def record(capture) -> dict[str, str]:
    """The provenance entry of a model that is trained on a capture."""
    views = list(dict.fromkeys(shot.view for shot in capture.training))
    return {KEY: json.dumps({"views": views, "scale": capture.scale})}


def recorded(model) -> TrainingRecord | None:
    """The record in a model's provenance; None where there is none that can be understood."""
    try:
        values = parse_json(model.provenance[KEY])
        views, scale = values["views"], float(values["scale"])
    except (KeyError, TypeError, ValueError):
        return None
    usable = isinstance(views, list) and all(isinstance(name, str) for name in views) and 0 < scale <= 1
    return TrainingRecord(frozenset(views), scale) if usable else None

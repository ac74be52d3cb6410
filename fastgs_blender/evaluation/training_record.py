# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads from a model's file which views it was trained on, so that evaluation never calls a training view held out."""
import json
from dataclasses import dataclass

from ..captures.capture import Capture
from ..model.gaussians import GaussianModel
from ..model.sequence import Source
from ..util.reading import parse_json

KEY = "trained_on"
"""The entry of a model's provenance, JSON: {"views": [names], "scale": factor on the pictures' size, "whole": see TrainingRecord}."""


@dataclass(frozen=True)
class TrainingRecord:
    """The views that a model was trained on, the scale of their pictures, and whether it shows a plain background that they have
    (captures/pixels/plain.py).  Its frames are those of the model's own clip."""

    views: frozenset[str]
    scale: float
    whole: bool = False

    def saw(self, view: str, frame: float, frame_count: int) -> bool:
        """Whether the picture of a view at a frame of the model's clip (counted from 0, fractions lie between frames) was trained on."""
        return view in self.views and abs(frame - round(frame)) < 1e-6 and -0.5 < frame < frame_count - 0.5


CORRECTIONS = "corrections"
"""The entry of a model's provenance that says what was taken out of its training pictures, JSON: "clocks" {view: frames}, "exposures"
{view: {"gain": [3], "bias": [3], "fade": [3]}}, "cameras" {view: what was changed before training, as captures/refined.py takes it} and
"poses" {view: [3], a rotation vector in degrees in the camera's axes, by which it was turned while training}, each only where cameras
differed; "fade" only where an exposure changed over the clip."""


def corrections_entry(facts: dict) -> dict[str, str]:
    """The provenance entry of a model trained from cameras that differed (camera_response.py, camera_turns.py); none where they did not."""
    return {CORRECTIONS: json.dumps(facts)} if facts else {}


MOST = 1e6
"""The largest number that an entry may hold."""


def corrections(model: Source) -> dict:
    """What was taken out of the training pictures of a model; empty where nothing was, or the model does not say it understandably."""
    try:
        facts = parse_json(model.provenance[CORRECTIONS])
        exposures = facts.get("exposures", {}).values()
        numbers = [*facts.get("clocks", {}).values(), *(value for each in exposures for values in _rows(each) for value in values)]
        turns = facts.get("poses", {}).values()
        changes = facts.get("cameras", {}).values()
        vectors = [*turns, *(change[name] for change in changes for name in ("turn", "shift"))]
        numbers += [value for vector in vectors for value in vector]
        factors = [change["focal"] for change in changes]
        shapes = [len(values) for values in (*(row for each in exposures for row in _rows(each)), *vectors)]
    except (KeyError, TypeError, AttributeError, ValueError):
        return {}
    usable = all(type(value) in (int, float) and abs(value) <= MOST for value in numbers + factors) and set(shapes) <= {3}
    usable = usable and all(value >= 1 / MOST for value in factors)
    return facts if usable else {}


def _rows(exposure: dict) -> list:
    """The lists of numbers of one camera's exposure."""
    return [exposure["gain"], exposure["bias"], exposure.get("fade", [0.0] * 3)]


def _most(channels: list[float]) -> float:
    return max(abs(value - 1) for value in channels)


def _exposure(channels: list[float]) -> str:
    """How bright a camera shows a grey, against the others, and the channel that differs from that, if one does."""
    middle = sum(channels) / 3
    name, value = max(zip(("red", "green", "blue"), channels), key=lambda item: abs(item[1] - middle))
    return f"{middle:.2f}" + (f" ({name} {value:.2f})" if abs(value - middle) >= 0.02 else "")


def sentence(found: dict) -> str:
    """What corrections() gave, for people."""
    parts = []
    if clocks := found.get("clocks"):
        late = sorted(clocks.items(), key=lambda item: -abs(item[1]))
        parts.append("clocks differ, in frames: " + ", ".join(f"{view} {value:+.2f}" for view, value in late[:6]))
    if exposures := found.get("exposures"):
        grey = {view: [2 * (0.5 * g + b) for g, b in zip(each["gain"], each["bias"])] for view, each in exposures.items()}
        changed = sorted((view for view in grey if _most(grey[view]) >= 0.005), key=lambda view: -_most(grey[view])) or list(grey)
        parts.append("exposures differ, and were evened: " + ", ".join(f"{view} {_exposure(grey[view])}" for view in changed[:6]))
        if changing := [view for view, each in exposures.items() if "fade" in each]:
            parts.append(f"exposures change over the clip, and were evened: {', '.join(changing)}")
    if changes := found.get("cameras"):
        parts.append(f"the cameras of {len(changes)} views were refined before training")
    if turns := found.get("poses"):
        sizes = sorted(((sum(value**2 for value in turn) ** 0.5, view) for view, turn in turns.items()), reverse=True)
        parts.append("poses were refined while training, by degrees: " + ", ".join(f"{view} {size:.2f}" for size, view in sizes[:6]))
    return "; ".join(parts)


def record(capture: Capture, whole: bool) -> dict[str, str]:
    """The provenance entry of a model that is trained on a capture; whole: see TrainingRecord."""
    return {KEY: json.dumps({"views": capture.training_views, "scale": capture.scale, **({"whole": True} if whole else {})})}


def recorded(model: GaussianModel) -> TrainingRecord | None:
    """The record in a model's provenance; None where there is none that can be understood."""
    try:
        values = parse_json(model.provenance[KEY])
        views, scale = values["views"], float(values["scale"])
    except (KeyError, TypeError, ValueError):
        return None
    usable = isinstance(views, list) and all(isinstance(name, str) for name in views) and 0 < scale <= 1
    return TrainingRecord(frozenset(views), scale, values.get("whole") is True) if usable else None

# SPDX-License-Identifier: GPL-3.0-or-later
"""Predicts which views of the finished model will be poor, and why: too few cameras, too far apart, or too near to each other."""
import numpy as np

from . import drawing
from .coverage import ENOUGH
from .report import Section, listed
from .samples import Inspection
from .space import Space, space_of

FEW = 7
"""Training cameras below which a capture has few."""
APART, FAR = 20.0, 35.0
"""Degrees between a view and the nearest training camera above which the view becomes softer, and above which it becomes poor."""
MUCH = 0.25
"""Share of what few cameras film that may be filmed by a single one before this is reported as poor."""
NARROW = 8.0
"""Degrees between the outermost cameras below which depth is uncertain."""
MOVING = 2
"""Number of different poses above which a camera counts as moving."""


def run(inspection: Inspection) -> Section:
    """Measure the angles between cameras, seen from what they film, and predict the quality of views between and beside them."""
    section = Section("View Extrapolation", "How far each view is from the nearest training camera, in degrees seen from what it films: "
                      f"up to {APART:.0f} a model holds, beyond {FAR:.0f} it has to guess.")
    capture = inspection.capture
    if not capture.posed or not inspection.training:
        section.summary = "Without poses nothing can be said about views between the cameras yet."
        return section
    poses = {shot.camera.world_to_camera.tobytes() for shot in capture.training if shot.camera is not None}
    if len(poses) > MOVING * len(inspection.training):
        section.summary = "The cameras move; views along their way will be good, others were not judged."
        return section
    space = space_of(inspection)
    count = len(capture.training_views)
    if count < 2:
        section.add("wrong", "There is one training camera: nothing says how far away anything is.", "Film with more cameras, or hold "
                                                                                                     "out fewer.")
        return section
    nearest = {view: space.nearest(view) for view in inspection.views}
    for view in capture.held_out_views:
        if view in nearest:
            _held_out(section, space, view, nearest[view], count)
    if count < FEW:
        _few(section, space, inspection.training)
    angles = np.array([[0.0 if a == b else space.angle(a, b) for b in inspection.training] for a in inspection.training])
    widest = float(angles.max())
    if widest < NARROW:
        section.add("poor", f"All cameras stand within {widest:.1f} degrees, seen from the scene: depth is uncertain, and views beside "
                            "them will be distorted.", "Spread the cameras; 20 degrees from one to the next are "
                                  "fine.", (), ("baseline", round(widest, 2), "degrees"))
    if count >= FEW:
        _gaps(section, inspection.training, np.minimum(angles, angles.T))
    shown = {view: angle for view, (_, angle) in nearest.items()}
    grades = {view: "wrong" if angle > FAR else "poor" if angle > APART else "" for view, angle in shown.items()}
    section.pictures.append(drawing.bars("Degrees from each camera to the nearest training camera.", shown, "degrees", grades,
                                         (APART, f"{APART:.0f}"), "{:.0f}"))
    section.columns = {"Nearest camera": {view: f"{name}, {angle:.0f} degrees" for view, (name, angle) in nearest.items()}}
    section.measures |= {"training_cameras": count, "nearest_degrees": {view: round(angle, 2) for view, angle in shown.items()},
                         "widest_degrees": round(widest, 2)}
    return section


def _held_out(section: Section, space: Space, view: str, nearest: tuple[str, float], count: int) -> None:
    other, angle = nearest
    seen = space.counts(view)
    few = float((seen < ENOUGH).mean())
    if angle <= APART and few < 0.5:
        return
    grade = "poor" if angle > FAR or few >= 0.5 or count < FEW else "note"
    section.add(grade, f"The held-out view {view} will be poor: it stands {angle:.0f} degrees from the nearest training camera, {other}, "
                f"and {few:.0%} of its picture is seen by fewer than {ENOUGH} of the {count} training cameras, "
                f"{float((seen < 1).mean()):.0%} by none. Surfaces that face it were filmed at a slant or not at all.", "No setting "
                f"changes that: film from directions at most {APART:.0f} degrees apart. Judge this model from between its training "
                "cameras.", [view], ("angle", round(angle, 2), "degrees"))


def _gaps(section: Section, training: list[str], angles: np.ndarray) -> None:
    """Tell of groups of cameras that stand more than FAR degrees apart, by the angles [views, views] between all of them."""
    group = np.arange(len(training))
    for a, b in np.argwhere(angles <= FAR):
        group[group == group[b]] = group[a]
    groups = sorted(([view for view, own in zip(training, group) if own == one] for one in np.unique(group)), key=len, reverse=True)
    if len(groups) < 2:
        return
    gap = max(float(angles[np.ix_(group == one, group != one)].min()) for one in np.unique(group))
    beside = [view for views in groups[1:] for view in views]
    if len(beside) == len(groups) - 1:
        sentence = (f"{listed(beside)} {'stands' if len(beside) == 1 else 'stand'} more than {FAR:.0f} degrees from the nearest other "
                    "camera: between them the model has to guess.")
    else:
        some = "; ".join(listed(views, 3) for views in groups[:4]) + ("; ..." if len(groups) > 4 else "")
        sentence = f"The cameras stand in {len(groups)} groups, {gap:.0f} degrees apart: between these the model has to guess ({some})."
    section.add("poor", sentence, "Add cameras in between, or keep the final camera near the filmed directions.", beside,
                ("gap", round(gap, 1), "degrees"))


def _few(section: Section, space: Space, training: list[str]) -> None:
    apart = {view: space.apart(view) for view in training}
    alone = {view: float((angles > APART).mean()) for view, angles in apart.items()}
    share, worst = float(np.mean(list(alone.values()))), max(alone, key=lambda view: alone[view])
    section.measures["alone"] = {view: round(value, 4) for view, value in alone.items()}
    section.add("poor" if share > MUCH or len(training) < ENOUGH + 1 else "note",
                f"{len(training)} training cameras are few: {share:.0%} of what they film ({alone[worst]:.0%} of the picture of {worst}) "
                f"is filmed by no second camera within {APART:.0f} degrees. From a few degrees beside the camera on, these parts will be "
                "soft, or float and break up, however long it is trained. Views of the cameras themselves look good and tell nothing.",
                f"Add cameras; with these, put one in every {APART:.0f} degrees around what matters, seen from there, and keep the final "
                "camera near them.", (), ("share filmed by one camera", round(share, 3), ""))

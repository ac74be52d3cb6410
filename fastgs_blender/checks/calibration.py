# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks the poses and lenses of a calibration, by features that pictures of several cameras have in common."""
from collections.abc import Collection
from itertools import combinations
from operator import itemgetter

import numpy as np

from ..captures.pixels import undistortion
from ..captures.pixels.store import FrameStore
from ..training.core.targets import small_camera, smaller
from ..training.initial import features
from ..training.initial.bumped import pose_by_points
from ..training.initial.calibrate import calibrated
from ..util.documentation import page
from ..util.errors import FastGSError
from . import drawing
from .focal import common_factor
from .matching import CLOSE, Matches
from .report import Section, listed, rounded
from .reprojection import OFF, offsets, surely_off
from .samples import Inspection, Sample

FAR_OFF = 3.0
"""Error, in pixels of the sampled pictures, above which the calibration of the whole rig is reported; of one camera: reprojection.OFF."""
LEAST_POINTS = 12
BORDER, RISE = 0.7, 1.5
"""The border of a picture begins at this share of half its diagonal; pixels by which errors there may exceed those inside."""
RING, BEGINS, QUARTER = 0.5, 0.1, 4
"""Where errors of a lens begin to be seen, and the share of those at the border that they have between here and there; least number of
features at the border for a quarter of the picture to count."""
EMPTY = 0.15
"""Largest share of a picture that may be empty after undistortion."""
ODD_FOCAL, ODD_CENTRE = 0.05, 0.15
SAME, ALIKE, SIDE = 1e-6, 0.8, 48
"""Difference of two poses that are equal, in units of the scene; correlation of pictures that are taken from one place, at SIDE pixels."""


def run(inspection: Inspection) -> Section:
    """Measure errors of matches against the calibration; find the wrong cameras and the angle by which each seems turned."""
    section = Section("Calibration", "How many pixels matches between two pictures miss the lines on which the calibration puts them: "
                                     "under 1 is good. They were found without the calibration.")
    if not inspection.capture.posed:
        section.summary = "The capture does not say where its cameras are; training finds them from its pictures first, as was tried here."
        _unknown_places(section, inspection)
        return section
    _lenses(section, inspection)
    _same_places(section, inspection)
    matches = inspection.matches
    if not matches.pairs:
        pairs = f"none of {matches.tried} pairs" if matches.tried else "none of the pairs"
        section.add("note", f"The calibration cannot be judged: {pairs} of pictures has enough in common, as with cameras that are far "
                            "apart, a scene without texture or one that repeats itself.", "Train a draft, and look at the held-out views.")
        return section
    scale = {view: samples[0].shrunk for view, samples in inspection.samples.items()}
    zoomed = _focal_lengths(section, matches)  # then errors of single cameras tell nothing
    bad, error = [] if zoomed else inspection.judged.wrong, inspection.judged.misses
    usual = float(np.median([error[view] for view in inspection.views if view not in bad and np.isfinite(error[view])] or [np.nan]))
    for view in bad:
        _tell(section, inspection, matches, view, error[view] * scale[view], bad)
    unsure = [] if zoomed else inspection.judged.unsure
    if unsure:
        section.add("note", f"Unsure: many features of {listed(unsure)} are far from where the other cameras put them. But they are few, "
                    "or others fit: floors and walls that repeat themselves look like that.",
                    "Trust the calibration if its own report is good. Else put things with patterns of their own into the scene, and look "
                    "again.", unsure)
    rest = [] if zoomed else [view for view, miss in error.items() if miss > OFF and view not in (*bad, *unsure)]
    if not bad and np.isfinite(usual) and usual > OFF and len(rest) > len(unsure):  # otherwise they may be wrong matches
        section.add("wrong" if usual > FAR_OFF else "poor", f"Features are off by {usual * max(scale.values()):.1f} pixels with all "
                    "cameras: the calibration as a whole does not fit the pictures.", "Calibrate again; check that the pictures are "
                    "neither cropped, turned nor stabilised, and that lens correction in the cameras was the same as when they were "
                    "calibrated.", (), ("reprojection error", round(usual, 3), "pixels"))
    elif rest:
        most = max(error[view] * scale[view] for view in rest)
        section.add("poor", f"Features of {listed(rest)} are up to {most:.1f} pixels from where the other cameras put them. Which cameras "
                    "are calibrated wrongly cannot be told.", "Calibrate again. Training corrects small errors (--poses auto).",
                    rest, ("reprojection error", round(most, 3), "pixels"))
    _borders(section, inspection, matches, bad)
    unknown = [view for view in inspection.views if not np.isfinite(error[view])]
    if unknown:
        section.add("note", f"{listed(unknown)} {'has' if len(unknown) == 1 else 'have'} too little in common with the other cameras for "
                    "the calibration to be judged there.", "Look at the coverage; cameras 20 degrees apart have more in common.", unknown)
    xyz = matches.good_points(bad)
    grades = dict.fromkeys(bad, "wrong")
    shown = {view: value * scale[view] for view, value in error.items()}
    section.pictures.append(drawing.bars("Distance of features from where the other cameras put them, the median of each camera.",
                                         shown, "px", grades))
    section.columns = {"Calibration": {view: f"{value:.1f} px" if np.isfinite(value) else "?" for view, value in shown.items()}}
    section.measures |= {"reprojection_pixels": {view: rounded(value) for view, value in shown.items()}, "median_pixels": rounded(usual),
                         "pairs": len(matches.pairs), "pairs_tried": matches.tried, "points": len(xyz), "wrong_cameras": bad}
    return section


def _focal_lengths(section: Section, matches: Matches) -> bool:
    """Tell by how much the focal lengths of all cameras are wrong alike; returns whether they are."""
    factor = common_factor(matches)
    if factor is None:
        return False
    by, way = abs(1 - 1 / factor), "short" if factor > 1 else "long"
    section.add("wrong", f"The focal lengths of all cameras seem {by:.0%} too {way}: matches fit best with {factor:.3f} of what the "
                "calibration says.", "Calibrate with pictures that were taken from the films, as many cameras crop what they film. Then "
                "check again: single cameras were not judged.", (), ("focal length", round(factor, 4), ""))
    return True


def _unknown_places(section: Section, inspection: Inspection) -> None:
    """Find the cameras as training does before its first step, and tell whether it would."""
    features.pycolmap_module()
    ways = ("Photograph the place from between the cameras for COLMAP, or film a calibration board: "
            f"{page('captures')}, three ways to poses.")
    try:
        cameras, _, frame = calibrated(inspection.capture, FrameStore(inspection.capture),
                                       lambda done, of: inspection.progress("comparing pictures", done / of))
    except FastGSError as error:
        section.add("wrong", f"It does not say where its cameras are, and training would stop without a model: {error}", ways)
        return
    lost = [view for view in inspection.capture.views if view not in cameras]
    if lost:
        section.add("poor", f"Only {len(cameras)} of {len(inspection.capture.views)} cameras can be found from the pictures of frame "
                            f"{frame}; training would leave out {listed(lost)}.", ways, lost)
    else:
        section.add("note", f"All {len(cameras)} cameras can be found from the pictures of frame {frame}.",
                    "Nothing is to be done; their unit of length is arbitrary.")


def turned_by(matches: Matches, view: str, bad: Collection[str]) -> tuple[float, float] | None:
    """The rotation in degrees and the distance between a camera's pose and its calibration, from points that correct cameras see too, as
    training finds it."""
    _, places, xyz = offsets(matches, view, [other for other in bad if other != view])
    if len(xyz) < LEAST_POINTS:
        return None
    camera = next(each.camera for (_, name), each in matches.features.items() if name == view)
    pose, given = pose_by_points(places, xyz, camera), camera.world_to_camera
    if pose is None:
        return None
    turn = pose[:3, :3] @ given[:3, :3].T
    moved = np.linalg.norm(-pose[:3, :3].T @ pose[:3, 3] + given[:3, :3].T @ given[:3, 3])
    return float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))), float(moved)


def _tell(section: Section, inspection: Inspection, matches: Matches, view: str, error: float, bad: Collection[str]) -> None:
    found = turned_by(matches, view, bad)
    by = "it was bumped, zoomed or calibrated wrongly"
    if found is not None:
        moved = f" and moved by {found[1]:.2g} of the world's units" if found[1] > 0.02 * inspection.capture.extent else ""
        by = f"it seems turned by {found[0]:.1f} degrees{moved} against its calibration, as by a bump"
        section.measures.setdefault("turned_degrees", {})[view] = round(found[0], 3)
    section.add("wrong", f"What {view} shows is {error:.1f} pixels from where the other cameras put it: {by}.", f"Calibrate {view} again. "
                "Training turns it to where the others say (--poses auto), if their pictures have enough in common; else leave it out.",
                [view], ("reprojection error", round(error, 3), "pixels"))


def _borders(section: Section, inspection: Inspection, matches: Matches, bad: Collection[str]) -> None:
    """Whether errors are larger near the borders, which means that the calibration's lens model is wrong."""
    found: dict[str, dict] = {view: {} for view in inspection.views}
    for pair in matches.pairs:
        if pair.a in bad or pair.b in bad or np.median(pair.distance) > OFF:  # where nothing fits, the border tells nothing
            continue
        for k, view in enumerate((pair.a, pair.b)):
            camera, places = matches.features[pair.moment, view].camera, matches.features[pair.moment, view].places[pair.rows[:, k]]
            middle = np.array([camera.width, camera.height]) / 2
            radius = np.linalg.norm(places - middle, axis=1) / np.linalg.norm(middle)
            for place, corner, far, error in zip(places // CLOSE, places > middle, radius, pair.distance):
                found[view][(pair.b, pair.a)[k], *place] = error, far, corner @ (1, 2)  # what stands still is one place at all moments
    rises = {view: rise for view, each in found.items() if each and (rise := _rise(np.array(list(each.values())))) is not None}
    if certain := {view: rise for view, (rise, sure) in rises.items() if sure}:
        view, most = max(certain.items(), key=itemgetter(1))
        section.add("poor", f"Near the borders of {listed(certain)}, matches miss by {most:.1f} pixels ({view}) more than in the middle: "
                    "the lens is not what the calibration says.", "Calibrate with a board that reaches into the corners, with more "
                    "coefficients of distortion or as a fisheye.", certain, ("rise at the border", round(most, 3), "pixels"))
    section.measures["border_rise_pixels"] = {view: round(value, 4) for view, (value, _) in rises.items()}


def _rise(features: np.ndarray) -> tuple[float, bool] | None:
    """By how many pixels errors are larger beyond BORDER than inside, and whether the lens is surely the reason; None of too few.

    features  [M, 3]: errors, radii as a share of half the diagonal, and numbers of the picture's quarters
    Wrong matches lie in one quarter, and their errors begin at once.  Those of a lens are in all quarters, and grow towards the border.
    """
    errors, radius, quarter = features.T
    near, far = errors[radius <= BORDER], errors[radius > BORDER]
    if min(len(near), len(far)) < LEAST_POINTS:
        return None
    rise, least = float(np.median(far) - np.median(near)), float(np.median(near)) + RISE
    quarters = [each for k in range(4) if len(each := errors[(radius > BORDER) & (quarter == k)]) >= QUARTER]
    inner, ring = errors[radius <= RING], errors[(radius > RING) & (radius <= BORDER)]
    begins = len(inner) and len(ring) and np.median(ring) - np.median(inner) > BEGINS * rise
    return rise, bool(surely_off(far, least) and begins and len(quarters) > 1 and min(map(np.median, quarters)) > least)


def _lenses(section: Section, inspection: Inspection) -> None:
    squeezed, shifted, empty = {}, {}, {}
    for view, (sample, *_) in inspection.samples.items():
        given = sample.shot.image.intrinsics
        if given is None:
            continue
        if abs(given.fx / given.fy - 1) > ODD_FOCAL:
            squeezed[view] = f"{given.fx:.0f} and {given.fy:.0f} pixels"
        off = max(abs(given.cx / given.width - 0.5), abs(given.cy / given.height - 0.5))
        if off > ODD_CENTRE:
            shifted[view] = off
        inside = None if sample.shot.image.lens.is_pinhole else undistortion.valid(sample.shot)  # sample.valid knows transparency too
        share = 0.0 if inside is None else float(1 - inside.mean())
        if share > EMPTY:
            empty[view] = share
    unusual = "That is right for cropped or squeezed pictures only; else calibrate again."
    if squeezed:
        view, lengths = next(iter(squeezed.items()))
        section.add("note", f"The calibration of {listed(squeezed)} is unusual: the focal lengths of {view} are {lengths}.", unusual,
                    squeezed)
    if shifted:
        view, off = max(shifted.items(), key=itemgetter(1))
        section.add("note", f"The calibration of {listed(shifted)} is unusual: the optical axis of {view} is {off:.0%} of the picture off "
                    "its middle.", unusual, shifted)
    if empty:
        view, share = max(empty.items(), key=itemgetter(1))
        section.add("note", f"Undoing the distortion of {listed(empty)} leaves {share:.0%} of the picture of {view} empty.",
                    "Such borders do not count in training; check the coefficients of distortion if that is a surprise.", empty,
                    ("empty share", round(share, 3), ""))


def _same_places(section: Section, inspection: Inspection) -> None:
    """Cameras that have one pose and show different things."""
    groups: list[dict[str, Sample]] = []
    for view, (sample, *_) in inspection.samples.items():
        own = next((group for group in groups if _same_pose(sample, next(iter(group.values())), inspection.capture.extent)), None)
        if own is None:
            groups.append(own := {})
        own[view] = sample
    for group in groups:
        if any(_alike(a, b) < ALIKE for a, b in combinations(group.values(), 2)):
            section.add("wrong", f"The calibration is wrong: {listed(group)} have the same pose, and their pictures show different things.",
                        "Calibrate them again, or correct the poses that were copied; or leave all but one of them out.", list(group))


def _same_pose(a: Sample, b: Sample, extent: float) -> bool:
    assert a.camera is not None and b.camera is not None
    apart = np.abs(a.camera.world_to_camera - b.camera.world_to_camera) / [1, 1, 1, extent]
    return a.shot.frame == b.shot.frame and apart.max() < SAME


def _alike(a: Sample, b: Sample) -> float:
    """The correlation of two small grey pictures, where a camera with the first one's pose sees both."""
    small = [max(1, max(sample.rgb.shape[:2]) // SIDE) for sample in (a, b)]
    one, two = (smaller(sample.rgb.mean(2), step) for sample, step in zip((a, b), small))
    first, second = (small_camera(sample.camera, step) for sample, step in zip((a, b), small) if sample.camera is not None)
    y, x = np.mgrid[:one.shape[0], :one.shape[1]] + 0.5
    u = np.floor((x - first.cx) / first.fx * second.fx + second.cx).astype(int)
    v = np.floor((y - first.cy) / first.fy * second.fy + second.cy).astype(int)
    inside = (u >= 0) & (u < two.shape[1]) & (v >= 0) & (v < two.shape[0])
    values = np.stack([one[inside], two[v[inside], u[inside]]])
    return float(np.corrcoef(values)[0, 1]) if inside.sum() > SIDE and values.std(1).min() > 1 else 1.0

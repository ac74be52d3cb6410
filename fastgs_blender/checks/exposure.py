# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks exposure: differences of brightness and white balance between cameras, dark and burnt-out pictures, changes of light over time."""
from collections.abc import Iterable
from contextlib import suppress

import numpy as np

from ..captures.evidence import differs
from ..captures.gains import gains_of
from ..util.errors import FastGSError
from . import drawing
from .matching import Matches
from .report import Section, listed
from .samples import Inspection, Sample

UNEVEN, UNEVEN_WHOLE, TINT = 0.1, 0.35, 0.1
"""Share by which a camera may be brighter than others: by what they see in common, by whole pictures; and its channels by each other."""
DARK, BURNT, BURNT_SHARE = 0.1, 0.985, 0.05
"""Median brightness below which a picture is dark; brightness of burnt pixels, and their share that is told."""
CHANGES, COMMON = 0.06, 0.6
"""Share by which a camera's still parts may change over time, and of the cameras that must change for the light to be the reason."""
REACH = 4
"""Pixels around a feature whose mean colour is compared."""
GAMMA = 2.2


def run(inspection: Inspection) -> Section:
    """Brightness and tint of each camera against the others, its darkness and burnt parts, and its changes over time."""
    section = Section("Exposure", "How bright each camera is against the others, by the colours of features that they see in common; where "
                      "too few are, by the means of whole pictures.")
    gains, by_pictures = brightness(inspection)
    even = {view: float(np.exp(np.mean(gain[0]))) for view, gain in gains.items()}
    _uneven(section, even, gains, by_pictures)
    _dark(section, inspection)
    _changing(section, inspection)
    told = {view: "poor" for finding in section.findings for view in finding.views}
    section.pictures.insert(0, drawing.bars("Brightness of each camera; 1 is the median of all.", even, "", told, (1.0, "1"), "x {:.2f}"))
    section.columns = {"Brightness": {view: f"x {value:.2f}" + (" (unsure)" if view in by_pictures else f" ± {gains[view][1].mean():.2f}")
                                      for view, value in even.items()}}
    section.measures |= {"brightness": {view: round(value, 4) for view, value in even.items()}, "by_whole_pictures": sorted(by_pictures),
                         "channels": {view: [round(float(v), 4) for v in np.exp(gain[0])] for view, gain in gains.items()},
                         "uncertainty": {view: round(float(gain[1].mean()), 4) for view, gain in gains.items() if view not in by_pictures}}
    return section


def brightness(inspection: Inspection) -> tuple[dict[str, np.ndarray], set[str]]:
    """Logarithm of each camera's channels against the median camera, and its standard deviation [2, 3]; and the cameras of which matched
    features tell nothing, so that theirs are of whole pictures."""
    means = {view: np.log(np.maximum(np.median([_mean(sample) for sample in samples], 0), 1e-3))
             for view, samples in inspection.samples.items()}
    middle = np.median(list(means.values()), 0)
    gains = {view: np.stack([value - middle, np.zeros(3)]) for view, value in means.items()}
    with suppress(FastGSError):  # without pycolmap
        views = inspection.views
        gains |= {view: gain for view, gain in zip(views, gains_of(shared_colours(inspection.matches, views))) if gain[1].all()}
    return gains, {view for view, gain in gains.items() if not gain[1].all()}


def shared_colours(matches: Matches, views: list[str]) -> np.ndarray:
    """Colours [P, V, 3] of matched features, NaN where a view does not show one."""
    tracks = matches.all_tracks()
    table = np.full((len(tracks), len(views), 3), np.nan)
    seen: dict[tuple[int, str], list[tuple[int, int]]] = {}
    for k, (moment, rows) in enumerate(tracks):
        for view, row in rows.items():
            seen.setdefault((moment, view), []).append((k, row))
    for (moment, view), pairs in seen.items():
        at, rows = np.array(pairs).T
        table[at, views.index(view)] = _colours(matches, moment, view, rows)
    return table


def _colours(matches: Matches, moment: int, view: str, rows: np.ndarray) -> np.ndarray:
    """Mean colours [M, 3] 0..1 around features."""
    places, image = matches.features[moment, view].places[rows], matches.samples[moment, view].rgb
    x, y = (np.clip(places[:, k].astype(int), REACH, max(image.shape[1 - k] - 1 - REACH, REACH)) for k in (0, 1))
    around = np.arange(-REACH, REACH + 1)
    rows_, columns = (np.minimum(v, n - 1) for v, n in ((y[:, None, None] + around[:, None], image.shape[0]),
                                                        (x[:, None, None] + around, image.shape[1])))
    return image[rows_, columns].astype(np.float32).mean((1, 2)) / 255


def _mean(sample: Sample) -> np.ndarray:
    rgb = sample.rgb if sample.valid is None else sample.rgb[sample.valid]
    return rgb.reshape(-1, 3).mean(0) / 255


def _uneven(section: Section, even: dict[str, float], gains: dict[str, np.ndarray], by_pictures: set[str]) -> None:
    advice = "Set exposure, gain and white balance by hand, the same on all cameras."
    off = {view: value for view, value in even.items()
           if (max(value, 1 / value) - 1 > UNEVEN_WHOLE if view in by_pictures else
               differs(np.log(value), gains[view][1].mean(), np.log1p(UNEVEN)))}
    words = {view: f"{view} is {abs(np.log2(value) * GAMMA):.1f} stops {'brighter' if value > 1 else 'darker'} (its colours have "
                   f"{value:.2f} times the values)" for view, value in off.items()}
    for views, severity, how in (
            ([view for view in off if view not in by_pictures], "poor", "By what they see in common, "),
            ([view for view in off if view in by_pictures], "note", "Unsure: by whole pictures, which may show other things, ")):
        if views:
            section.add(severity, f"{how}{listed([words[view] for view in views])} than the others: surfaces change their colour from view "
                        "to view.", advice, views, ("brightness", _farthest(even[v] for v in views), "times"))
    tints = {}
    for view, gain in gains.items():
        tint = np.exp(gain[0] - gain[0].mean())
        channel = int(np.abs(tint - 1).argmax())
        if view not in by_pictures and differs(np.log(tint[channel]), gain[1, channel], np.log1p(TINT)):
            tints[view] = f"{view} ({('red', 'green', 'blue')[channel]} x {tint[channel]:.2f})", float(tint[channel])
    if tints:
        section.add("poor", f"{listed([words for words, _ in tints.values()])} {'has' if len(tints) == 1 else 'have'} another white "
                            "balance than the others.", advice, tints, ("tint", _farthest(t for _, t in tints.values()), "times"))


def _farthest(gains: Iterable[float]) -> float:
    return round(float(max(gains, key=lambda gain: abs(float(np.log(gain))))), 3)


def _dark(section: Section, inspection: Inspection) -> None:
    dark, burnt = {}, {}
    for view, samples in inspection.samples.items():
        shown = [sample.rgb[... if sample.valid is None or not sample.valid.any() else sample.valid].reshape(-1, 3) for sample in samples]
        dark[view] = float(np.median([np.median(rgb.mean(1)) / 255 for rgb in shown]))
        burnt[view] = float(np.mean([(rgb.min(1) >= 255 * BURNT).mean() for rgb in shown]))
    if gloomy := [view for view, value in dark.items() if value < DARK]:
        section.add("poor", f"{listed(gloomy)} {'is' if len(gloomy) == 1 else 'are'} dark: half of the picture is below "
                    f"{max(dark[v] for v in gloomy):.0%} of white, where noise and compression hide details.", "Add light rather than "
                    "gain; a black background is no fault.", gloomy, ("median brightness", round(min(dark[v] for v in gloomy), 3), ""))
    if flat := [view for view, value in burnt.items() if value > BURNT_SHARE]:
        section.add("poor" if len(flat) < len(burnt) else "note", f"{listed(flat)} {'is' if len(flat) == 1 else 'are'} burnt out in "
                    f"{max(burnt[v] for v in flat):.0%} of the picture: nothing is known of what is there.", "Lower the exposure when "
                    "filming; a white background is no fault.", flat, ("burnt share", round(max(burnt[v] for v in flat), 3), ""))
    if inspection.plain:
        section.add("note", "All cameras film their subject before a plain background, which training cuts out.",
                    "To keep the background, train with --masks off.")
    section.measures |= {"median_brightness": {v: round(x, 4) for v, x in dark.items()},
                         "burnt_share": {v: round(x, 4) for v, x in burnt.items()}}


def _changing(section: Section, inspection: Inspection) -> None:
    """Brightness over time of what stands still: the median over the pixels of each picture's ratio to the median picture."""
    curves = {}
    for view, samples in inspection.samples.items():
        shapes = {sample.rgb.shape for sample in samples}
        moved = len({None if sample.camera is None else sample.camera.world_to_camera.tobytes() for sample in samples}) > 1
        if len(samples) < 3 or len(shapes) > 1 or moved:
            continue
        stack = np.array([sample.rgb[::4, ::4].mean(2) for sample in samples]) + 4.0
        curves[view] = np.median(stack / np.median(stack, 0), axis=(1, 2))
    change = {view: float(np.ptp(curve)) for view, curve in curves.items()}
    moving = [view for view, value in change.items() if value > CHANGES]
    if moving and len(moving) >= COMMON * len(change):
        section.add("poor", f"The light changes: what stands still becomes up to {max(change.values()):.0%} brighter or darker in "
                            f"{listed(moving)}.",
                    "Light the scene with lamps that neither move nor flicker (at 50 or 60 Hz film with a shutter of 1/50 or 1/60 s), or "
                    "with no sun between clouds.", moving, ("change of brightness", round(max(change.values()), 3), ""))
    elif moving:
        section.add("poor", f"{listed(moving)} {'changes its' if len(moving) == 1 else 'change their'} exposure while filming, by up to "
                            f"{max(change[v] for v in moving):.0%}.", "Turn automatic "
                    "exposure and gain off.", moving, ("change of brightness", round(max(change[v] for v in moving), 3), ""))
    if curves:
        section.measures["change_of_brightness"] = {view: round(value, 4) for view, value in change.items()}
        if max(change.values()) > CHANGES / 2:
            section.pictures.append(drawing.curves("Brightness of what stands still, over the moments that were looked at.", curves,
                                                   "moments", "brightness"))

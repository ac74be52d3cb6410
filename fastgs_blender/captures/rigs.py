# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes a Capture of the rig, or of the single pictures, that a layout found, with the options applied."""
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..cameras.camera import Camera
from ..cameras.lens import pinhole_for
from ..model.gaussians import Clip
from ..util.errors import FastGSError, printable
from .capture import Capture, Options, Points, Shot
from .film_times import evened
from .pixels.probe import facts
from .pixels.sequences import Unreadable
from .pixels.video import index
from .rig_camera import RigCamera
from .sources import Source

MOST_SHOTS = 1_000_000
"""Pictures of a capture: 46 cameras that film for six minutes."""
MOST_TOLD = 6
"""Missing and damaged pictures that a sentence names."""
MOST_LOST = 1 / 3
"""Share of a capture's pictures that may be missing or damaged.  So many are left out; with more, the capture is refused."""
LEAST_COMMON = 0.5
"""Share of the longest film that all films must have in common; where they have less, the capture is refused."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A picture as a layout describes it, before scale, clocks and selection; frame counts from 0, t is None where the layout states no
    times; late is by how many frames it was taken later than its frame."""

    view: str
    frame: int
    image: Source
    world_to_camera: np.ndarray | None
    mask: Source | None = None
    t: float | None = None
    late: float = 0.0


def from_rig(path: Path, layout: str, cameras: Sequence[RigCamera], options: Options, *, faults: Sequence[str] = (),
             **settings: Any) -> Capture:
    """The capture of a rig: all cameras film frame after frame together.  settings as from_entries() has them.

    Films may begin and end at different times: the frames that all of them have are the clip, and a note says so.  A camera that has no
    picture at all shortens nothing.
    """
    cameras, settings["fps"], uneven = evened(cameras, settings.get("fps", 30.0))
    count = settings.pop("frame_count", None) or _longest(cameras)
    if count < 1 and faults:
        raise FastGSError(faults[0])
    check_count(path, count, len(cameras))
    chosen, remarks, apart = _shared(cameras, options, _chosen(count, options.frames, path), settings.get("start_frame", 0))
    if remarks:
        options = replace(options, frames=slice(chosen.start, chosen.stop, chosen.step))
    entries, gaps = [], []
    for camera in cameras:
        late = _late(camera, options)
        for frame in (moment - late for moment in chosen if 0 <= moment - late < count):
            image = camera.pictures[frame] if frame < len(camera.pictures) else None
            if image is None:
                gaps.append((camera.name, frame))
                continue
            pose = camera.pose if camera.pose is None or np.ndim(camera.pose) == 2 else camera.pose[frame]
            mask, late_by = camera.masks[frame] if frame < len(camera.masks) else None, camera.late[frame] if camera.late else 0.0
            entries.append(Entry(camera.name, frame, image, pose, mask, late=late_by))
    notes = [*settings.pop("notes", ()), *uneven, *remarks]
    return from_entries(path, layout, entries, options, frame_count=count, gaps=gaps, notes=notes, faults=[*faults, *apart], **settings)


def chosen_frames(cameras: Sequence[RigCamera], options: Options, path: Path) -> Sequence[int]:
    """The frames of a rig that are used, counted from 0: those that the options choose and all films have."""
    cameras = evened(cameras, 30.0)[0]
    return _shared(cameras, options, _chosen(_longest(cameras), options.frames, path))[0]


def _longest(cameras: Sequence[RigCamera]) -> int:
    return max((len(camera.pictures) for camera in cameras), default=0)


def _late(camera: RigCamera, options: Options) -> int:
    return _whole(options.offsets.get(printable(camera.name), 0.0))


def _shared(cameras: Sequence[RigCamera], options: Options, chosen: range, start_frame: int = 0) -> tuple[range, list[str], list[str]]:
    """Those of the chosen moments that all films have, and a note where some have not; with too few, all of them and a fault."""
    begins, ends = {}, {}
    for camera in cameras:
        there = [frame for frame, picture in enumerate(camera.pictures) if picture is not None]
        if there:
            begins[camera.name], ends[camera.name] = there[0] + _late(camera, options), there[-1] + _late(camera, options)
    first, last = max(begins.values(), default=chosen[0]), min(ends.values(), default=chosen[-1])
    shared = [i for i, moment in enumerate(chosen) if first <= moment <= last]
    if len(shared) == len(chosen):
        return chosen, [], []
    reasons = [f"{view} begins with {begin + start_frame}" for view, begin in begins.items() if begin == first > chosen[0]]
    reasons += [f"{view} ends with {end + start_frame}" for view, end in ends.items() if end == last < chosen[-1]]
    reason = "; ".join(reasons[:4]) + ("; ..." if len(reasons) > 4 else "")
    if len(shared) < LEAST_COMMON * len(chosen):
        fault = (f"all its cameras have {len(shared)} of {len(chosen)} frames in common, which is less than half ({reason}); leave out the "
                 "camera that filmed another part")
        return chosen, [], [fault]
    kept = chosen[shared[0]:shared[-1] + 1]
    return kept, [f"the frames {kept[0] + start_frame}-{kept[-1] + start_frame} are used, which all cameras have: {reason}"], []


def lone_sentence(found: Sequence[str], lost: Sequence[str]) -> list[str]:
    """A clause where only one camera of a rig has a film: a scene that moves cannot be learnt from it."""
    if len(found) != 1 or not lost:
        return []
    some = ", ".join(lost[:6]) + (" ..." if len(lost) > 6 else "")
    sentence = (f"only {found[0]} of its {1 + len(lost)} cameras has a film, and there is none of {some}; call each film, or the folder "
                "that it lies in, like its camera")
    return [sentence]


def from_entries(
        path: Path, layout: str, entries: Sequence[Entry], options: Options, *, frame_count: int, fps: float = 30.0, start_frame: int = 0,
        held_out: Sequence[str] = (), scale: float = 1.0, focal: float | None = None, axes: str = "RDF", points: Points | None = None,
        mask_means: str = "foreground", gaps: Sequence[tuple[str, int]] = (), notes: Sequence[str] = (), faults: Sequence[str] = (),
        model: Path | None = None) -> Capture:
    """The capture of these pictures, with the options applied; held_out, scale and focal (see pinhole_for) are the layout's defaults.

    gaps    (view, frame) of pictures that are not there: these, and damaged ones, are left out with a note, or are a fault (MOST_LOST)
    """
    check_count(path, frame_count)
    check_count(path, max(len(entries), 1))
    scale = scale if options.scale is None else options.scale
    if not (np.isfinite(scale) and 0 < scale <= 1):
        raise FastGSError(f"the scale of a capture's pictures must be above 0 and at most 1, not {scale:g}.")
    chosen = _chosen(frame_count, options.frames, path)
    step = chosen[1] - chosen[0] if len(chosen) > 1 else 1
    place = {frame: i for i, frame in enumerate(chosen)}
    entries = [replace(entry, view=printable(entry.view)) for entry in entries]  # for messages, and for Blender
    entries, remarks = _by_the_clocks(entries, options.offsets)
    notes = [*notes, *remarks]
    if options.scale is None and scale < 1:
        notes.append(f"pictures are used at {scale:.0%} of their size, as in published work; a scale of 1 keeps all their pixels")
    if options.frames is not None and frame_count < (options.frames.stop or 0):
        notes.append(f"the part asked for goes on behind the capture's last frame, {frame_count - 1}, and ends there")
    notes += _film_notes(entries)
    entries, lost = _readable([entry for entry in entries if entry.frame in place])
    gaps = [(view, frame) for view, frame in gaps if frame + _whole(options.offsets.get(printable(view), 0.0)) in place]
    faults = [*faults]
    if lost or gaps:
        missing, of = len(lost) + len(gaps), len(entries) + len(lost) + len(gaps)
        films = [str(fault).rstrip(".") for fault in faults if gaps and isinstance(fault, Unreadable)]
        faults = [fault for fault in faults if not films or not isinstance(fault, Unreadable)]
        clauses = [*films, *(gap_sentences(gaps, start_frame) if frame_count > 1 else _names(gaps)), *lost]
        text = "; ".join(clauses[:MOST_TOLD]) + (f"; and {len(clauses) - MOST_TOLD} more" if len(clauses) > MOST_TOLD else "")
        text = text.replace(f"{path}{os.sep}", "")
        if missing > MOST_LOST * of:
            faults.append(f"{missing} of its {of} pictures are missing or damaged, which is more than a third: {text}")
        else:
            notes.append(f"left out: {missing} of {of} pictures, missing or damaged: {text}")
    if not entries:
        reason = f": {faults[0]}" if faults else ""
        raise FastGSError(f"{path}: there are no pictures of the frames {chosen[0]} to {chosen[-1]} in this capture{reason.rstrip('.')}.")
    kept = _held_out(path, entries, map(printable, held_out), options.held_out)
    times = _times(entries, chosen, options.frames is not None)
    cameras: dict = {}
    shots = []
    for entry, t in zip(entries, times):
        camera = None
        if entry.world_to_camera is not None:
            camera = _camera(entry, scale, focal, cameras)
        frame, offset = place[entry.frame], options.offsets.get(entry.view, 0.0)
        t = frame / len(chosen) if t is None else t
        t += (offset - _whole(offset) + entry.late) / (step * len(chosen))
        shots.append(Shot(entry.view, frame, camera, entry.image, entry.mask, entry.view in kept, t))
    order = {view: i for i, view in enumerate(dict.fromkeys(shot.view for shot in shots))}
    shots.sort(key=lambda shot: (shot.frame, order[shot.view]))
    clip = Clip(len(chosen), fps / step, start_frame + chosen[0])
    return Capture(Path(path), layout, shots, clip, axes, scale, points, mask_means, [*map(printable, notes)], [*map(printable, faults)],
                   model, (chosen[0] / frame_count, len(chosen) * step / frame_count))


def _readable(entries: Sequence[Entry]) -> tuple[list[Entry], list[str]]:
    """The entries whose pictures and masks are whole, and a clause for each other one; headers and ends of files are looked at."""
    whole, damaged = [], []
    for entry in entries:
        try:
            for source in (entry.image, entry.mask):
                if source is not None and source.frame is None:
                    facts(source)
            whole.append(entry)
        except FastGSError as error:
            damaged.append(str(error).rstrip("."))
    return whole, damaged


def _film_notes(entries: Sequence[Entry]) -> list[str]:
    """Remarks where films of some cameras are HDR and those of others are not, for their colours differ more than exposures do; and where
    films with poses are turned, for the poses must be those of the turned pictures."""
    wide: dict[bool, list[str]] = {True: [], False: []}
    turned = []
    for path, (view, pose) in {entry.image.path: (entry.view, entry.world_to_camera) for entry in entries
                               if entry.image.frame is not None}.items():
        with suppress(FastGSError):  # told with the frames
            wide[index(path).wide].append(view)
            turned += [view] if index(path).turns and pose is not None else []
    notes = []
    if all(wide.values()):
        notes.append(f"the films of {', '.join(wide[True][:6])} are HDR and those of the other cameras are not, so their colours do not "
                     "fit; export them as SDR")
    if turned:
        some = ", ".join(turned[:6]) + (" ..." if len(turned) > 6 else "")
        notes.append(f"the films of {some} are marked as turned and are read upright, as players show them; their calibration must be of "
                     "upright pictures")
    return notes


def _names(gaps: Sequence[tuple[str, int]], most: int = 4) -> list[str]:
    """A clause for views of one moment that are not there."""
    names = [view for view, _ in gaps]
    return [f"there is no {', '.join(names[:most])}{' ...' if len(names) > most else ''}"] if names else []


def _whole(offset: float) -> int:
    """The nearest whole number of frames."""
    return math.floor(offset + 0.5)


def _by_the_clocks(entries: Sequence[Entry], offsets: Mapping[str, float]) -> tuple[list[Entry], list[str]]:
    """The entries at the frames whose moments they are nearest to, and remarks on clocks that differ."""
    names = {entry.view for entry in entries}
    beside = {name: offset for name, offset in offsets.items() if name in names and offset}
    if not beside:
        return list(entries), []
    moments = {entry.frame: entry.t for entry in entries}
    moved = []
    for entry in entries:
        frame = entry.frame + _whole(beside.get(entry.view, 0.0))
        if frame == entry.frame:
            moved.append(entry)
        elif frame in moments:
            moved.append(replace(entry, frame=frame, t=moments[frame]))
    listed = ", ".join(f"{name} {offset:+.3g}" for name, offset in beside.items())
    return moved, [f"clocks differ, in frames: {listed}"]


def check_count(path: Path, frames: int, cameras: int = 1) -> None:
    """Raises FastGSError for a capture without frames, or with more pictures than can be listed."""
    if frames < 1:
        raise FastGSError(f"{path}: there are no frames in this capture.")
    if frames * max(cameras, 1) > MOST_SHOTS:
        raise FastGSError(f"{path}: {frames} frames of {cameras} cameras are more than the {MOST_SHOTS} pictures that are read; check the "
                          "count of frames.")


def _times(entries: Sequence[Entry], chosen: range, is_part: bool) -> list[float | None]:
    """The times that the layout states, None where frames tell them; a part of the clip becomes a clip of its own, from t = 0."""
    stated = [entry.t for entry in entries if entry.t is not None]
    if not stated or not is_part:
        return [entry.t for entry in entries]
    low, span = min(stated), (max(stated) - min(stated)) * len(chosen) / max(1, len(chosen) - 1)
    return [None if entry.t is None else (entry.t - low) / span if span else 0.0 for entry in entries]


def gap_sentences(gaps: Sequence[tuple[str, int]], start_frame: int = 0) -> list[str]:
    """One clause per view for pictures that are not there; gaps are (view, frame from 0)."""
    missing: dict[str, list[int]] = {}
    for view, frame in gaps:
        missing.setdefault(view, []).append(frame + start_frame)
    return [f"{view} lacks {'the frame' if len(frames) == 1 else f'{len(frames)} frames:'} {ranges(frames)}"
            for view, frames in missing.items()]


def ranges(numbers: Sequence[int], most: int = 6) -> str:
    """Whole numbers as text, with runs of them as ranges: "1-3, 7, 9-12"."""
    parts: list[list[int]] = []
    for number in sorted(numbers):
        if parts and number == parts[-1][1] + 1:
            parts[-1][1] = number
        else:
            parts.append([number, number])
    text = [f"{a}" if a == b else f"{a}-{b}" for a, b in parts[:most]]
    return ", ".join(text + (["..."] if len(parts) > most else []))


def _chosen(count: int, frames: slice | None, path: Path) -> range:
    chosen = range(count)[frames] if frames is not None else range(count)
    if frames is not None and chosen.step < 1:
        raise FastGSError(f"{path}: the frames of a capture are taken forwards, not in steps of {chosen.step}.")
    if not len(chosen):
        raise FastGSError(f"{path}: none of its {count} frames lies in the part asked for; frames count from 0.")
    return chosen


def _held_out(path: Path, entries: Sequence[Entry], default: Iterable[str], asked: Sequence[str] | None) -> set[str]:
    names = {entry.view for entry in entries}
    unknown = [] if asked is None else [name for name in asked if name not in names]
    if unknown:
        known = ", ".join(list(dict.fromkeys(entry.view for entry in entries))[:12]) + (", ..." if len(names) > 12 else "")
        raise FastGSError(f"{path}: there is no view {unknown[0]!r} to hold out; the views are {known}.")
    kept = set(default if asked is None else asked) & names
    if kept == names and asked is not None:
        raise FastGSError(f"{path}: all {len(names)} views are held out, so that nothing is left to train on; hold out fewer.")
    return set() if kept == names else kept


def _camera(entry: Entry, scale: float, focal: float | None, known: dict) -> Camera:
    """The pinhole of an entry; one object for all frames of a camera that stands still."""
    image = entry.image
    assert image.intrinsics is not None
    pose = np.asarray(entry.world_to_camera, np.float64)
    lens_key = image.lens, image.intrinsics
    key = *lens_key, pose.tobytes()
    if key not in known:
        if lens_key not in known:
            with np.errstate(all="ignore"):  # coefficients of any size; a Camera's numbers are finite
                known[lens_key] = pinhole_for(image.lens, image.intrinsics, np.eye(4), scale, focal)
        known[key] = replace(known[lens_key], world_to_camera=pose, window=None)
    return known[key]

# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes a Capture of the rig, or of the single pictures, that a layout found, with the options applied."""
from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..cameras.camera import Camera
from ..cameras.lens import pinhole_for
from ..model.gaussians import Clip
from ..util.errors import FastGSError, printable
from .capture import Capture, Options, Points, Shot
from .sources import Source

MOST_SHOTS = 1_000_000
"""Pictures of a capture: 46 cameras that film for six minutes."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A picture as a layout describes it, before scale, clocks and selection; frame counts from 0, t is None where the layout states no
    times."""

    view: str
    frame: int
    image: Source
    world_to_camera: np.ndarray | None
    mask: Source | None = None
    t: float | None = None


@dataclass(frozen=True, eq=False)
class RigCamera:
    """A camera that a layout found.

    pictures  one Source per frame, None where it is missing; a rig whose cameras have different numbers of them is unsynchronised
    pose      world-to-camera [4, 4], or one per frame [F, 4, 4], or None
    masks     as pictures, or empty
    """

    name: str
    pictures: Sequence[Source | None]
    pose: np.ndarray | None
    masks: Sequence[Source | None] = ()


def from_rig(path, layout: str, cameras: Sequence[RigCamera], options: Options, *, faults: Sequence[str] = (), **settings) -> Capture:
    """The capture of a rig: all cameras film frame after frame together.  settings as from_entries() has them."""
    count = settings.pop("frame_count", None) or max((len(camera.pictures) for camera in cameras), default=0)
    if count < 1 and faults:
        raise FastGSError(faults[0])
    check_count(path, count, len(cameras))
    chosen = _chosen(count, options.frames, path)
    entries, gaps = [], []
    for camera in cameras:
        late = _whole(options.offsets.get(_name(camera.name), 0.0))
        for frame in (moment - late for moment in chosen):
            if late and not 0 <= frame < count:  # it began later, or ended earlier, than the clip
                continue
            image = camera.pictures[frame] if frame < len(camera.pictures) else None
            if image is None:
                gaps.append((camera.name, frame))
                continue
            pose = camera.pose if camera.pose is None or np.ndim(camera.pose) == 2 else camera.pose[frame]
            entries.append(Entry(camera.name, frame, image, pose, camera.masks[frame] if frame < len(camera.masks) else None))
    faults = [*faults, *gap_sentences(gaps, settings.get("start_frame", 0))]
    return from_entries(path, layout, entries, options, frame_count=count, faults=faults, **settings)


def lone_sentence(found: Sequence[str], lost: Sequence[str]) -> list[str]:
    """A clause where only one camera of a rig has a film: a scene that moves cannot be learnt from it."""
    if len(found) != 1 or not lost:
        return []
    some = ", ".join(lost[:6]) + (" ..." if len(lost) > 6 else "")
    sentence = (f"only {found[0]} of its {1 + len(lost)} cameras has a film, and there is none of {some}; call each film, or the folder "
                "that it lies in, like its camera")
    return [sentence]


def chosen_frames(cameras: Sequence[RigCamera], options: Options, path) -> Sequence[int]:
    """The frames of a rig that the options choose, counted from 0."""
    return _chosen(max((len(camera.pictures) for camera in cameras), default=0), options.frames, path)


def from_entries(
        path, layout: str, entries: Sequence[Entry], options: Options, *, frame_count: int, fps: float = 30.0, start_frame: int = 0,
        held_out: Sequence[str] = (), scale: float = 1.0, focal: float | None = None, axes: str = "RDF", points: Points | None = None,
        mask_means: str = "foreground", notes: Sequence[str] = (), faults: Sequence[str] = (), model: Path | None = None) -> Capture:
    """The capture of these pictures, with the options applied; held_out, scale and focal (see pinhole_for) are the layout's defaults."""
    check_count(path, frame_count)
    check_count(path, len(entries))
    scale = scale if options.scale is None else options.scale
    if not (np.isfinite(scale) and 0 < scale <= 1):
        raise FastGSError(f"the scale of a capture's pictures must be above 0 and at most 1, not {scale:g}.")
    chosen = _chosen(frame_count, options.frames, path)
    step = chosen[1] - chosen[0] if len(chosen) > 1 else 1
    place = {frame: i for i, frame in enumerate(chosen)}
    entries = [replace(entry, view=_name(entry.view)) for entry in entries]  # for messages, and for Blender
    entries, remarks = _by_the_clocks(entries, options.offsets)
    notes = [*notes, *remarks]
    if options.scale is None and scale < 1:
        notes.append(f"pictures are used at {scale:.0%} of their size, as in published work; a scale of 1 keeps all their pixels")
    if options.frames is not None and frame_count < (options.frames.stop or 0):
        notes.append(f"the part asked for goes on behind the capture's last frame, {frame_count - 1}, and ends there")
    entries = [entry for entry in entries if entry.frame in place]
    if not entries:
        reason = f": {faults[0]}" if faults else ""
        raise FastGSError(f"{path}: there are no pictures of the frames {chosen[0]} to {chosen[-1]} in this capture{reason.rstrip('.')}.")
    kept = _held_out(path, entries, map(_name, held_out), options.held_out)
    times = _times(entries, chosen, options.frames is not None)
    cameras: dict = {}
    shots = []
    for entry, t in zip(entries, times):
        camera = None
        if entry.world_to_camera is not None:
            camera = _camera(entry, scale, focal, cameras)
        frame, offset = place[entry.frame], options.offsets.get(entry.view, 0.0)
        t = frame / len(chosen) if t is None else t
        t += (offset - _whole(offset)) / (step * len(chosen))
        shots.append(Shot(entry.view, frame, camera, entry.image, entry.mask, entry.view in kept, t))
    order = {view: i for i, view in enumerate(dict.fromkeys(shot.view for shot in shots))}
    shots.sort(key=lambda shot: (shot.frame, order[shot.view]))
    clip = Clip(len(chosen), fps / step, start_frame + chosen[0])
    return Capture(Path(path), layout, shots, clip, axes, scale, points, mask_means, [*map(printable, notes)], [*map(printable, faults)],
                   model, (chosen[0] / frame_count, len(chosen) * step / frame_count))


def _name(view: str) -> str:
    """A view's name as it is shown, and asked for: printable, on one line."""
    return printable(view)


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
    return moved, [f"clocks differ, by sync.json, in frames: {listed}"]


def check_count(path, frames: int, cameras: int = 1) -> None:
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


def _chosen(count: int, frames: slice | None, path) -> range:
    chosen = range(count)[frames] if frames is not None else range(count)
    if frames is not None and chosen.step < 1:
        raise FastGSError(f"{path}: the frames of a capture are taken forwards, not in steps of {chosen.step}.")
    if not len(chosen):
        raise FastGSError(f"{path}: none of its {count} frames lies in the part asked for; frames count from 0.")
    return chosen


def _held_out(path, entries, default, asked) -> set[str]:
    names = {entry.view for entry in entries}
    unknown = [] if asked is None else [name for name in asked if name not in names]
    if unknown:
        known = ", ".join(list(dict.fromkeys(entry.view for entry in entries))[:12]) + (", ..." if len(names) > 12 else "")
        raise FastGSError(f"{path}: there is no view {unknown[0]!r} to hold out; the views are {known}.")
    kept = set(default if asked is None else asked) & names
    if kept == names and asked is not None:
        raise FastGSError(f"{path}: all {len(names)} views are held out, so that nothing is left to train on; hold out fewer.")
    return set() if kept == names else kept


def _camera(entry: Entry, scale, focal, known: dict) -> Camera:
    """The pinhole of an entry; one object for all frames of a camera that stands still."""
    image = entry.image
    pose = np.asarray(entry.world_to_camera, np.float64)
    lens_key = image.lens, image.intrinsics
    key = *lens_key, pose.tobytes()
    if key not in known:
        if lens_key not in known:
            with np.errstate(all="ignore"):  # coefficients of any size; a Camera's numbers are finite
                known[lens_key] = pinhole_for(image.lens, image.intrinsics, np.eye(4), scale, focal)
        known[key] = replace(known[lens_key], world_to_camera=pose, window=None)
    return known[key]

# SPDX-License-Identifier: GPL-3.0-or-later
"""Facts about splat objects as text for panels; opens no file twice, so that redraws stay quick."""
from contextlib import suppress
from pathlib import Path

import bpy

from ..fastgs_blender.formats.sequences import stored_bytes
from ..fastgs_blender.util.errors import FastGSError
from ..scene import objects, snapshot, time
from ..scene.cameras import subjects


def known(obj: bpy.types.Object) -> bool:
    """Whether the object's file has been read since the object was created."""
    return obj.fastgs.frame_count > 0


def object_facts(obj: bpy.types.Object) -> list[tuple[str, str]]:
    """(label, value) pairs about an object's file."""
    settings = obj.fastgs
    clip = objects.clip_of(obj)
    rows = [("Gaussians", f"{settings.gaussian_count:,}")]
    if clip.free:
        rows.append(("Frames", f"{clip.frame_count:,} at the scene's rate"))
    elif clip.frame_count > 1:
        rows.append(("Frames", f"{clip.frame_count:,} at {number(clip.fps)} fps ({clip.duration:.2f} s)"))
    else:
        rows.append(("Frames", "a still"))
    path = Path(objects.abspath(obj))
    with suppress(OSError, FastGSError):  # a missing file is reported as an error elsewhere
        rows += [("File Size", size(stored_bytes(path)))] if not path.is_dir() else []
    return rows


def sides(obj: bpy.types.Object, scene: bpy.types.Scene) -> list[str]:
    """Width, depth and height of an object's subject in the scene's unit of length; none where they are not known."""
    size, units = subjects.size_of(obj), scene.unit_settings
    return [bpy.utils.units.to_string(units.system, 'LENGTH', side * units.scale_length, precision=3) for side in size] if any(size) else []


def extent(obj: bpy.types.Object, scene: bpy.types.Scene) -> list[tuple[str, str]]:
    """The same in one line, as a (label, value) pair."""
    words = sides(obj, scene)
    return [("Size", " x ".join(words))] if words else []


def shown_now(obj: bpy.types.Object, scene: bpy.types.Scene) -> str:
    """The capture's frame that is shown at the scene's current frame."""
    clip = objects.clip_of(obj)
    frame, rate = snapshot.clock(scene)
    try:
        at = time.clip_frame(frame, rate, snapshot.retime_of(obj, frame), clip)
    except FastGSError:  # the engine says which number is none
        at = None
    return "Nothing" if at is None else f"Frame {number(at)} (of 0 to {clip.frame_count - 1})"


def scene_facts(scene: bpy.types.Scene) -> list[tuple[str, str]]:
    """(label, value) pairs about all splats of a scene."""
    splats = [obj for obj in scene.objects if objects.is_splat(obj)]
    total = sum(obj.fastgs.gaussian_count for obj in splats)
    return [("Objects", f"{len(splats):,}"), ("Gaussians", f"{total:,}"), ("Memory", size(objects.loaded_bytes()))]


def number(value: float) -> str:
    """A number with at most two digits after the point, without trailing zeros."""
    return f"{value:.2f}".rstrip("0").rstrip(".")


def size(count: int) -> str:
    """A number of bytes as text, as Blender's statistics write it."""
    step = min((count.bit_length() - 1) // 10, 3) if count else 0
    return f"{count / 1024**step:.{1 if step else 0}f} {('B', 'KiB', 'MiB', 'GiB')[step]}"

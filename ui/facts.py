# SPDX-License-Identifier: GPL-3.0-or-later
"""Facts about splat objects as plain text for panels.  Cheap enough for a redraw: no file is opened."""
from __future__ import annotations

import textwrap
from contextlib import suppress
from pathlib import Path

import bpy

from ..fastgs_blender.model.gaussians import Clip
from ..scene import objects, snapshot, time


def known(obj: bpy.types.Object) -> bool:
    """Whether the object's file has been read since the object came to be."""
    return obj.fastgs.frame_count > 0 and obj.fastgs.fps > 0


def object_facts(obj: bpy.types.Object) -> list[tuple[str, str]]:
    """(what, value) pairs about an object's file."""
    settings = obj.fastgs
    clip = Clip(settings.frame_count, settings.fps)
    rows = [("Gaussians", f"{settings.gaussian_count:,}")]
    if clip.frame_count > 1:
        rows.append(("Frames", f"{clip.frame_count:,} at {number(clip.fps)} fps ({clip.duration:.2f} s)"))
    else:
        rows.append(("Frames", "a still"))
    with suppress(OSError):  # a missing file is told as an error
        rows.append(("File Size", size(Path(objects.abspath(obj)).stat().st_size)))
    return rows


def shown_now(obj: bpy.types.Object, scene: bpy.types.Scene) -> str:
    """Which of the capture's frames the scene's current frame shows."""
    clip = Clip(obj.fastgs.frame_count, obj.fastgs.fps)
    rate = scene.render.fps / scene.render.fps_base
    at = time.clip_frame(scene.frame_current_final, rate, snapshot.retime_of(obj), clip)
    return "Nothing" if at is None else f"Frame {number(at)} (of 0 to {clip.frame_count - 1})"


def scene_facts(scene: bpy.types.Scene) -> list[tuple[str, str]]:
    """(what, value) pairs about all that a scene holds of splats."""
    splats = [obj for obj in scene.objects if objects.is_splat(obj)]
    total = sum(obj.fastgs.gaussian_count for obj in splats)
    return [("Splat Objects", f"{len(splats):,}"), ("Gaussians", f"{total:,}"), ("In Memory", size(objects.loaded_bytes()))]


def number(value: float) -> str:
    """At most two digits after the point, none that say nothing."""
    return f"{value:.2f}".rstrip("0").rstrip(".")


def size(count: int) -> str:
    """Bytes in words, as Blender's statistics write them."""
    step = min((count.bit_length() - 1) // 10, 3) if count else 0
    return f"{count / 1024**step:.{1 if step else 0}f} {('B', 'KiB', 'MiB', 'GiB')[step]}"


def lines(text: str, width: float, scale: float) -> list[str]:
    """A sentence cut into lines for a region of that many pixels, at an interface scale: Blender's labels do not wrap."""
    return textwrap.wrap(text[:1].upper() + text[1:], max(int((width / scale - 60) / 6.5), 20))

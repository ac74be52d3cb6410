# SPDX-License-Identifier: GPL-3.0-or-later
"""Computes when an object's clip plays in its scene, and adds the clip's sound."""
from dataclasses import dataclass
from pathlib import Path

from ..fastgs_blender.util.errors import FastGSError
from . import objects, speeds
from .frame_range import clip_length
from .snapshot import clock


@dataclass(frozen=True)
class Played:
    """The frames of the scene on which a clip itself plays: start <= frame < end."""

    start: float
    end: float


def played(obj, scene) -> Played:
    """The frames on which an object's clip plays, from the object's start frame, speed and offset."""
    clip, (_, fps) = objects.clip_of(obj), clock(scene)
    length = clip_length(obj, 1.0 if clip.free else clip.fps / fps)
    return Played(obj.fastgs.start_frame, obj.fastgs.start_frame + length)


def add_sound(scene, obj, path: Path):
    """A sound strip for a file whose sound begins with the capture's first frame; it starts, ends and runs with the object's clip.

    Returns the strip.  Raises FastGSError where the file cannot be read as sound, and for clips that play backwards.
    """
    settings, clip = obj.fastgs, objects.clip_of(obj)
    if settings.speed <= 0 or settings.use_capture_frame or speeds.speed_of(obj) is not None:
        raise FastGSError("sound plays forwards, at one speed: give the clip a positive speed without keys, and let its time follow the "
                          "scene's frame.")
    if not path.is_file():
        raise FastGSError(f"{path}: the file cannot be found; choose a film or a sound file.")
    editor = scene.sequence_editor_create() or scene.sequence_editor
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences  # before Blender 4.4
    at, fps = played(obj, scene), clock(scene)[1]
    channel = max((strip.channel for strip in strips), default=0) + 1
    try:
        strip = strips.new_sound(obj.name, str(path), channel, round(at.start))
    except RuntimeError as error:
        raise FastGSError(f"{path}: Blender cannot read it as sound ({error}); choose a film or a sound file.") from error
    if not strip.frame_duration:
        strips.remove(strip)
        raise FastGSError(f"{path}: there is no sound in it; choose a film or a sound file.")
    skipped = settings.trim_start + settings.offset
    skipped_scene = 0.0 if not skipped else skipped * (1.0 if clip.free else fps / clip.fps)
    if hasattr(strip, "pitch"):
        strip.pitch = settings.speed
    strip.frame_start = at.start - skipped_scene / settings.speed
    strip.frame_final_start = round(at.start)
    strip.frame_final_end = min(strip.frame_final_end, max(round(at.end), round(at.start) + 1))
    return strip

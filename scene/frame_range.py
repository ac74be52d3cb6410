# SPDX-License-Identifier: GPL-3.0-or-later
"""Sets a scene's frame, and its frame range and frame rate from a capture."""
from collections.abc import Iterator
from contextlib import contextmanager
from math import ceil, floor

import bpy

from . import speeds


def frame_rate(fps: float) -> tuple[int, float]:
    """(fps, fps_base) of RenderSettings for any frame rate: Blender shows fps / fps_base frames per second."""
    whole = min(max(round(fps), 1), 32767)
    return whole, whole / fps


def go_to(scene: bpy.types.Scene, frame: float) -> None:
    """Set the scene to a frame, whole or not."""
    whole = floor(frame)
    scene.frame_set(whole, subframe=frame - whole)


@contextmanager
def frame_kept(scene: bpy.types.Scene) -> Iterator[None]:
    """Restore the scene's frame after the block, also after an error."""
    frame, subframe = scene.frame_current, scene.frame_subframe
    try:
        yield
    finally:
        scene.frame_set(frame, subframe=subframe)


def fit_scene(scene: bpy.types.Scene, obj: bpy.types.Object) -> None:
    """Give the scene the frame rate of the object's capture, and a range in which its clip plays once; a still changes nothing."""
    settings = obj.fastgs
    if settings.frame_count < 2:
        return
    if settings.fps:  # a sequence without a rate of its own follows the scene's
        scene.render.fps, scene.render.fps_base = frame_rate(settings.fps)
    scene.frame_start = max(round(settings.start_frame), 0)
    scene.frame_end = scene.frame_start + max(ceil(clip_length(obj)), 1) - 1


def clip_length(obj: bpy.types.Object, rate: float = 1.0) -> float:
    """How many frames of the scene an object's clip plays from its start frame on; one that never ends counts as played at speed 1.

    rate  how many frames of the clip pass in one of the scene at speed 1
    """
    settings, speed = obj.fastgs, speeds.speed_of(obj)
    backwards = settings.speed < 0 if speed is None else speed.backwards(settings.start_frame)
    frames = max(settings.frame_count - settings.trim_start - settings.trim_end, 1.0)
    frames = (frames + settings.offset if backwards else frames - settings.offset) / rate
    if speed is None:
        return frames / abs(settings.speed or 1.0)
    end = speeds.end_of(speed, settings.start_frame, frames)
    return frames if end is None else end - settings.start_frame

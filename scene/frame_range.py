# SPDX-License-Identifier: GPL-3.0-or-later
"""Sets a scene's frame range and frame rate from a capture."""
from __future__ import annotations

from math import ceil

import bpy


def frame_rate(fps: float) -> tuple[int, float]:
    """(fps, fps_base) of RenderSettings for any frame rate: Blender shows fps / fps_base frames per second."""
    whole = min(max(round(fps), 1), 32767)
    return whole, whole / fps


def fit_scene(scene: bpy.types.Scene, obj: bpy.types.Object) -> None:
    """Give the scene the frame rate of the object's capture, and a range in which its clip plays once; a still changes nothing."""
    settings = obj.fastgs
    if settings.frame_count < 2:
        return
    if settings.fps:  # a sequence without a rate of its own follows the scene's
        scene.render.fps, scene.render.fps_base = frame_rate(settings.fps)
    speed = settings.speed or 1.0
    frames = (settings.frame_count - settings.offset) if speed > 0 else (settings.frame_count + settings.offset)
    start = max(round(settings.start_frame), 0)
    scene.frame_start = start
    scene.frame_end = start + max(ceil(frames / abs(speed)), 1) - 1

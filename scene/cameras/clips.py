# SPDX-License-Identifier: GPL-3.0-or-later
"""The clip that a capture's cameras filmed, as the cameras in the scene remember it, and the scene's own rate and range beside it."""
from dataclasses import dataclass

import bpy

from ..frame_range import frame_rate
from .placing import use_render_size
from .subjects import capture_cameras


@dataclass(frozen=True)
class Filmed:
    """A capture's clip in the scene: the scene frame of its first picture, its frames, its rate, and one of its cameras."""

    start: int
    frames: int
    fps: float
    camera: bpy.types.Object

    @property
    def end(self) -> int:
        """Scene frame of the last picture, where the scene has the capture's rate."""
        return self.start + self.frames - 1


def remember(data: bpy.types.Camera, start: int, clip) -> None:
    """Store the capture's clip on one of its cameras."""
    data.fastgs.clip_start, data.fastgs.clip_frames, data.fastgs.clip_fps = start, clip.frame_count, clip.fps


def filmed(context) -> Filmed | None:
    """The clip of the active camera's capture, else of the scene's first one; None where no camera knows any."""
    every = capture_cameras(context.scene)
    first = [context.object] if context.object in every else []
    for camera in first + every:
        known = camera.data.fastgs
        if known.clip_frames > 1:
            return Filmed(known.clip_start, known.clip_frames, known.clip_fps, camera)
    return None


def difference(scene: bpy.types.Scene, clip: Filmed) -> str:
    """One sentence on how the scene's rate and range differ from a capture's; "" where they do not."""
    rate = scene.render.fps / scene.render.fps_base
    if abs(rate / clip.fps - 1) <= 1e-3 and (scene.frame_start, scene.frame_end) == (clip.start, clip.end):
        return ""
    return (f"the capture has {clip.fps:.4g} frames a second on frames {clip.start} to {clip.end}; the scene has {rate:.4g} on "
            f"{scene.frame_start} to {scene.frame_end}.")


def fit(scene: bpy.types.Scene, clip: Filmed) -> None:
    """Give the scene the capture's rate, range and picture size, and the camera to look through."""
    scene.render.fps, scene.render.fps_base = frame_rate(clip.fps)
    scene.frame_start, scene.frame_end = clip.start, clip.end
    use_render_size(scene, clip.camera)

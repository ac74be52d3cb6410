# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps a frame of the scene to a frame of a capture, for each object's retiming.  Nothing is ever rounded to a whole frame."""
from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Retime:
    """How an object plays its clip.

    start_frame  scene frame on which the clip begins
    speed        playback speed; negative begins at the clip's last frame and plays backwards
    offset       frames of the capture that are skipped at the beginning
    before       'HIDE', 'HOLD', 'LOOP' or 'PING_PONG': what shows before the clip's first frame
    after        the same after its last
    hold         whether a sequence shows the nearer frame between two, instead of what lies between them
    """

    start_frame: float = 1.0
    speed: float = 1.0
    offset: float = 0.0
    before: str = 'HOLD'
    after: str = 'HOLD'
    hold: bool = False


def clip_frame(scene_frame: float, scene_fps: float, retime: Retime, clip) -> float | None:
    """The clip's frame (0 .. frame_count, fractions are sub-frames) to show on a scene frame; None: nothing shows.

    Time runs in seconds, so a clip keeps its speed whatever the scene's frame rate.  With n frames:

        f = speed * (scene_frame - start_frame) * clip.fps / scene_fps + offset      (+ n - 1 where speed < 0)

    A clip without a frame rate of its own has the scene's.

    Between 0 and n - 1 f itself shows.  Outside 'HOLD' shows the nearest of these two, 'LOOP' f mod n, 'PING_PONG' turns
    around at 0 and n - 1 (period 2 (n - 1)), and 'HIDE' shows f for 0 <= f < n only: the last frame lasts as long as any other.
    """
    n = clip.frame_count
    rate = scene_fps if clip.free else clip.fps
    f = retime.speed * (scene_frame - retime.start_frame) * rate / scene_fps + retime.offset
    if retime.speed < 0:
        f += n - 1
    # Blender stores single precision: a speed of 0.7 is a little less, and the first frame must not fall before itself
    slack = 1e-6 * max(1.0, abs(f))
    if -slack <= f <= n - 1 + slack:
        return min(max(f, 0.0), n - 1.0)
    mode = retime.before if f < 0 else retime.after
    if mode == 'HOLD':
        return 0.0 if f < 0 else n - 1.0
    if mode == 'LOOP':
        f %= n
        return f if f < n - slack else 0.0
    if mode == 'PING_PONG':
        last = n - 1.0
        return last - abs(f % (2 * last) - last) if last else 0.0
    return f if 0 <= f < n - slack else None

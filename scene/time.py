# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps a frame of the scene to a frame of a capture, for each object's retiming.  Nothing is ever rounded to a whole frame."""
import math
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from ..fastgs_blender.util.errors import FastGSError

MOST_ECHOES = 32


class Run(NamedTuple):
    """How far a clip whose speed changes has run by a frame of the scene.

    frames     the integral of the speed from the clip's start frame on, in frames of the scene
    backwards  whether the speed is negative first: then the clip begins at its last frame
    """

    frames: float
    backwards: bool


OUTSIDE = (
    ('HIDE', "Hide", "Show nothing", 0),
    ('HOLD', "Hold", "Keep showing the nearest frame of the clip", 1),
    ('LOOP', "Loop", "Start over", 2),
    ('PING_PONG', "Ping-Pong", "Play back and forth", 3),
)


def _shown(default: Any, name: str, description: str, **options: Any) -> Any:
    """A member of Retime that is a property of objects: its default, name, tooltip and options in Blender."""
    return field(default=default, metadata={"name": name, "description": description, **options})


@dataclass(frozen=True)
class Retime:
    """How an object plays its clip; properties.py makes properties of most of it.

    run            where the speed changes over time, how far the clip has run by the scene's frame; None: the speed is always the same
    hold           whether a sequence shows the nearer frame between two, instead of what lies between them
    capture_frame  the capture's frame to show, whatever the scene's frame, speed and offset are; None: these decide
    """

    start_frame: float = _shown(1.0, "Start Frame", "Scene frame on which the clip begins")
    speed: float = _shown(1.0, "Speed", "Playback speed; negative plays from the last frame backwards", soft_min=-4.0, soft_max=4.0)
    run: Run | None = None
    offset: float = _shown(0.0, "Time Shift", "By how many frames of the capture playback runs ahead: at 10 the clip begins with its frame "
                           "10. Nothing is cut off, as it is by trimming")
    before: str = _shown('HOLD', "Before", "What to show before the clip's first frame", items=OUTSIDE)
    after: str = _shown('HOLD', "After", "What to show after the clip's last frame", items=OUTSIDE)
    hold: bool = False
    trim_start: float = _shown(0.0, "Trim Start", "Frames to cut off the beginning of the capture: the clip starts after them", min=0.0)
    trim_end: float = _shown(0.0, "Trim End", "Frames to cut off the end of the capture", min=0.0)
    capture_frame: float | None = None
    fade: float = _shown(0.0, "Loop Fade", "Frames at the seam of a loop over which its end and its beginning are shown together; at most "
                         "half of the clip", min=0.0, soft_max=50.0)
    echoes: int = _shown(0, "Echoes", "How many earlier moments of the capture are shown besides the current one, each as much to draw as "
                         "the object itself", min=0, max=MOST_ECHOES, soft_max=8)
    echo_spacing: float = _shown(5.0, "Echo Spacing", "Frames of the capture between two echoes; negative shows later moments",
                                 soft_min=0.1, soft_max=30.0)
    echo_fade: float = _shown(0.5, "Echo Fade", "Opacity of an echo as a share of that of the one before", min=0.0, max=1.0,
                              subtype='FACTOR')

    def range(self, clip) -> tuple[float, float]:
        """The first and the last frame of the capture that trimming leaves."""
        first = min(max(self.trim_start, 0.0), clip.frame_count - 1.0)
        return first, max(clip.frame_count - 1.0 - max(self.trim_end, 0.0), first)


def clip_frame(scene_frame: float, scene_fps: float, retime: Retime, clip) -> float | None:
    """The clip's frame (0 .. frame_count, fractions are sub-frames) that shows most on a scene frame; None: nothing shows."""
    frames = shown_frames(scene_frame, scene_fps, replace(retime, echoes=0), clip)
    return max(frames, key=lambda shown: shown[1])[0] if frames else None


def shown_frames(scene_frame: float, scene_fps: float, retime: Retime, clip) -> list[tuple[float, float]]:
    """The clip's frames (0 .. frame_count, fractions are sub-frames) to show on a scene frame, each with the opacity that it has.

    Time runs in seconds, so a clip keeps its speed whatever the scene's frame rate.  With n frames left by trimming:

        f = speed * (scene_frame - start_frame) * clip.fps / scene_fps + offset      (+ n - 1 where speed < 0)

    counts from the first of them.  Where the speed is animated, its integral stands for speed * (scene_frame - start_frame), and it
    counts from the last frame where the speed is negative first.  A clip without a frame rate of its own has the scene's.

    Between 0 and n - 1 f itself shows.  Outside 'HOLD' shows the nearest of these two, 'LOOP' f mod n, 'PING_PONG' turns
    around at 0 and n - 1 (period 2 (n - 1)), and 'HIDE' shows f for 0 <= f < n only: the last frame lasts as long as any other.
    A loop that fades over c frames has the period n - c; its first c frames come in while the last c go.
    Echoes end where the clip does, unless it loops or turns around.  Raises FastGSError where a number of the object is none.
    """
    for name, value in vars(retime).items():
        if isinstance(value, float) and not math.isfinite(value):
            raise FastGSError(f"its {name.replace('_', ' ')} is {value:g}; type a number, or delete its keys and drivers.")
    first, last = retime.range(clip)
    rate = scene_fps if clip.free else clip.fps
    if retime.capture_frame is None:
        run = retime.run or Run(retime.speed * (scene_frame - retime.start_frame), retime.speed < 0)
        f = run.frames * rate / scene_fps + retime.offset
        if run.backwards:
            f += last - first
    else:
        f = retime.capture_frame - first
    step = retime.echo_spacing if retime.speed >= 0 else -retime.echo_spacing
    shown = []
    for number in range(min(max(retime.echoes, 0), MOST_ECHOES) + 1):
        for frame, share in _within(f - number * step, last - first + 1, retime, number > 0):
            if share > 0:
                shown.append((first + frame, share * retime.echo_fade**number))
    return [(frame, share) for frame, share in shown if share > 0]


def _within(f: float, n: float, retime: Retime, echo: bool) -> list[tuple[float, float]]:
    """The frames of a clip of n frames to show at its frame f, with their opacities."""
    # Blender stores single precision: a speed of 0.7 is a little less, and the first frame must not fall before itself
    slack = 1e-6 * max(1.0, abs(f))
    fade = min(max(retime.fade, 0.0), n / 2)
    if fade and 'LOOP' in (retime.before, retime.after):
        period = n - fade
        turn = math.floor((f + slack) / period)
        at = max(f - turn * period, 0.0)
        comes_from_the_loop = retime.after == 'LOOP' if turn > 0 else retime.before == 'LOOP'
        if comes_from_the_loop and at < fade:
            return [(at, at / fade), (min(at + period, n - 1.0), 1 - at / fade)]
        if comes_from_the_loop and turn:
            return [(at, 1.0)]
    if -slack <= f <= n - 1 + slack:
        return [(min(max(f, 0.0), n - 1.0), 1.0)]
    mode = retime.before if f < 0 else retime.after
    if mode == 'HOLD':
        return [] if echo else [(0.0 if f < 0 else n - 1.0, 1.0)]
    if mode == 'LOOP':
        f %= n
        return [(f if f < n - slack else 0.0, 1.0)]
    if mode == 'PING_PONG':
        last = n - 1.0
        return [(last - abs(f % (2 * last) - last) if last else 0.0, 1.0)]
    return [(f, 1.0)] if 0 <= f < n - slack else []

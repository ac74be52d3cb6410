# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluates a property that NLA strips animate at any frame, as Blender's stack of tracks does."""
import math
from collections.abc import Iterator

import bpy

from .cameras.keys import curve_in, curve_of

MIXES = {'REPLACE': lambda below, value, usual: value, 'COMBINE': lambda below, value, usual: below + value - usual,
         'ADD': lambda below, value, usual: below + value, 'SUBTRACT': lambda below, value, usual: below - value,
         'MULTIPLY': lambda below, value, usual: below * value}
"""What a strip of full influence makes of the value below it; `usual` is the property's default."""


class Strips:
    """The strips that animate a property of a datablock, and the action above them.  False where none does.

    known  whether their value is known at all frames: not with transitions, meta strips, modifiers of strips, or in tweak mode
    """

    def __init__(self, owner: bpy.types.ID, path: str, usual: float):
        animation, self._usual = owner.animation_data, usual
        tracks = [] if animation is None or not animation.use_nla else animation.nla_tracks
        solo = [track for track in tracks if track.is_solo]
        self._tracks = [[(strip, _curve(strip, path)) for strip in track.strips] for track in solo or tracks if solo or not track.mute]
        self._top = None if animation is None or solo or animation.use_tweak_mode else curve_of(owner, path)
        self._animation = animation
        strips = [pair for track in self._tracks for pair in track]
        self.known = not strips or not (animation.use_tweak_mode or any(
            strip.type != 'CLIP' or any(not modifier.mute for modifier in strip.modifiers) for strip, _ in strips))
        self._acts = any(curve is not None or strip.type != 'CLIP' for strip, curve in strips)

    def __bool__(self) -> bool:
        whole = self._top is not None and self._animation.action_blend_type == 'REPLACE' and self._animation.action_influence == 1
        return self._acts and not whole

    def at(self, frame: float) -> float:
        """The property's value on a frame."""
        value = self._usual
        for track in self._tracks:
            strip, curve, time = _shown(track, frame)
            if curve is not None and not strip.mute:
                share = max(_influence(strip, time), 0.0)
                value += share * (MIXES[strip.blend_type](value, curve.evaluate(_action_time(strip, time)), self._usual) - value)
        if self._top is not None:
            mixed = MIXES[self._animation.action_blend_type](value, self._top.evaluate(frame), self._usual)
            value += self._animation.action_influence * (mixed - value)
        return value

    def cuts(self) -> Iterator[float]:
        """Frames on which the value, or its slope, may jump."""
        for strip, curve in (pair for track in self._tracks for pair in track):
            start, end = strip.frame_start, strip.frame_end
            yield from (start, start + strip.blend_in, end - strip.blend_out, end)
            first, last = strip.action_frame_start, strip.action_frame_end
            for key in curve.keyframe_points if curve is not None else ():
                along = (last - key.co.x if strip.use_reverse else key.co.x - first) * strip.scale
                yield from (start + along + turn * _length(strip) for turn in range(math.ceil(strip.repeat)))
        yield from (key.co.x for key in (self._top.keyframe_points if self._top is not None else ()))


def _curve(strip, path: str) -> bpy.types.FCurve | None:
    return None if strip.action is None else curve_in(strip.action, getattr(strip, "action_slot", None), path)


def _shown(track: list, frame: float) -> tuple:
    """(strip, its curve, frame) of the strip that a track shows on a frame, within it or held; thrice None: none."""
    before = None, None
    for strip, curve in track:
        if frame < strip.frame_start:
            if before[0] is None and strip.extrapolation == 'HOLD':
                return strip, curve, strip.frame_start
            break
        if frame <= strip.frame_end:
            return strip, curve, frame
        before = strip, curve
    held = before[0] is not None and before[0].extrapolation != 'NOTHING'
    return (*before, before[0].frame_end) if held else (None, None, None)


def _influence(strip, frame: float) -> float:
    if strip.use_animated_influence:
        return strip.fcurves.find("influence").evaluate(frame)
    since, left = frame - strip.frame_start, strip.frame_end - frame
    if strip.blend_in and since <= strip.blend_in:
        return since / strip.blend_in
    return left / strip.blend_out if strip.blend_out and left <= strip.blend_out else 1.0


def _length(strip) -> float:
    """Frames that a strip's action takes once."""
    return ((strip.action_frame_end - strip.action_frame_start) or 1.0) * strip.scale


def _action_time(strip, frame: float) -> float:
    """The frame of its action that a strip shows."""
    if strip.use_animated_time:
        return strip.fcurves.find("strip_time").evaluate(frame)
    along = math.fmod(frame - strip.frame_start, _length(strip)) / strip.scale
    if frame == strip.frame_end and strip.repeat == int(strip.repeat):
        along = _length(strip) / strip.scale
    return strip.action_frame_end - along if strip.use_reverse else strip.action_frame_start + along

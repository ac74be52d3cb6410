# SPDX-License-Identifier: GPL-3.0-or-later
"""A Speed that NLA strips animate: on any frame it is what Blender says there, and the clip has run as far as these values sum up to."""
from __future__ import annotations

import bpy
import numpy as np
import pytest
from test_speeds import keyed, obj, shown  # noqa: F401 (obj is a fixture)

FRAMES = (-4.0, 2.0, 3.0, 5.5, 9.25, 14.0, 17.5, 22.0, 24.0, 26.5, 31.0, 44.5, 70.0)


def strip_of(obj, track, at, keys=((1, 2.0), (11, 0.5))):  # noqa: F811
    """A strip with a ramp of the speed, from a frame of the scene on."""
    keyed(obj, keys)
    animation = obj.animation_data
    action, slot = animation.action, getattr(animation, "action_slot", None)
    animation.action = None
    strip = track.strips.new("ramp", at, action)
    if slot is not None:
        strip.action_slot = slot
    obj.fastgs.speed = 7.0  # where nothing animates it now, Blender takes the default
    return strip


def plain(first, second, animation):
    pass


def scaled(first, second, animation):
    first.scale, first.repeat = 0.7, 2.5


def backwards(first, second, animation):
    first.use_reverse, first.repeat, first.extrapolation = True, 2.0, 'HOLD_FORWARD'


def blended(first, second, animation):
    first.blend_in, second.blend_out, second.blend_type = 4.0, 3.0, 'ADD'


def multiplied(first, second, animation):
    first.extrapolation, second.blend_type, second.extrapolation = 'NOTHING', 'MULTIPLY', 'NOTHING'


def subtracted(first, second, animation):
    first.use_animated_influence = True
    for frame, value in ((4, 0.25), (12, 1.0)):
        first.influence = value
        first.keyframe_insert("influence", frame=frame)
    second.blend_type = 'SUBTRACT'


def combined(first, second, animation):
    second.blend_type, second.extrapolation = 'COMBINE', 'HOLD_FORWARD'


def muted(first, second, animation):
    first.mute = True


def alone(first, second, animation):
    animation.nla_tracks[1].is_solo = True


def below_an_action(first, second, animation):
    keyed(animation.id_data, [(1, 0.5), (30, 3.0)])
    animation.action_blend_type, animation.action_influence = 'ADD', 0.5


CASES = [plain, scaled, backwards, blended, multiplied, subtracted, combined, muted, alone, below_an_action]


@pytest.mark.slow
@pytest.mark.parametrize("change", CASES, ids=lambda case: case.__name__)
def test_the_clip_has_run_as_far_as_the_strips_say(module, obj, scene, change):  # noqa: F811
    animation = obj.animation_data_create()
    first = strip_of(obj, animation.nla_tracks.new(), 4)
    second = strip_of(obj, animation.nla_tracks.new(), 20, ((1, 0.0), (6, 1.5)))
    change(first, second, obj.animation_data)
    obj.fastgs.offset = 150
    strips, speeds = module("scene.strips"), module("scene.speeds")
    found = strips.Strips(obj, speeds.PATH, speeds.USUAL)
    steps = np.arange(3, 40, 0.25) + 0.125
    told = {}
    for frame in (*FRAMES, *steps):
        scene.frame_set(int(np.floor(frame)), subframe=frame - np.floor(frame))
        told[frame] = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).fastgs.speed
        assert found.at(frame) == pytest.approx(told[frame], abs=1e-4), frame
    assert speeds.trouble(obj) == ""
    for frame in (40.0, 12.0):
        run = sum(told[step] for step in steps if step < frame) / 4
        assert shown(module, scene, obj, frame) == pytest.approx(150 + run, abs=0.3), frame


def test_an_action_above_all_strips_is_the_speed(module, obj, scene):  # noqa: F811
    strip_of(obj, obj.animation_data_create().nla_tracks.new(), 1)
    keyed(obj, [(3, 1.0), (13, 3.0)])
    assert shown(module, scene, obj, 13) == pytest.approx(20, abs=1e-3)


def test_strips_that_are_not_known_on_other_frames_are_told(module, obj, scene):  # noqa: F811
    """While a strip's action is edited, Blender evaluates others than the stack of tracks says."""
    speeds, animation = module("scene.speeds"), obj.animation_data_create()
    strip_of(obj, animation.nla_tracks.new(), 1).select = True
    animation.nla_tracks.active = animation.nla_tracks[0]
    animation.use_tweak_mode = True
    assert animation.use_tweak_mode and speeds.speed_of(obj) is None and "NLA" in speeds.trouble(obj)
    animation.use_tweak_mode = False
    assert speeds.speed_of(obj) is not None and not speeds.trouble(obj)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators on an object's clip: splitting it at the current frame, markers at its beginning and end, and its sound."""
from math import floor
from pathlib import Path

import bpy
from bpy.props import BoolProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ..fastgs_blender.util.errors import FastGSError
from ..scene import objects, snapshot
from ..scene.clips import add_sound, played
from ..scene.time import clip_frame
from .action import EDITABLE_SPLATS, Action, Need


class _OnClip(Action):
    needs = (EDITABLE_SPLATS, Need(lambda context: context.object.fastgs.frame_count > 1, "A still has no clip"))


class FASTGS_OT_split(_OnClip, bpy.types.Operator):
    """Cut the clip at the current frame: the object shows what comes before it, a new object what comes from it on"""

    bl_idname = "fastgs.split"
    bl_label = "Split"

    def act(self, context):
        obj, scene = context.object, context.scene
        settings, clip = obj.fastgs, objects.clip_of(obj)
        frame, fps = snapshot.clock(scene)
        retime, whole = snapshot.retime_of(obj, frame), played(obj, scene)
        try:
            at = clip_frame(frame, fps, retime, clip)
        except FastGSError:  # a number of the object is none
            at = None
        turned = retime.run is not None and retime.run.backwards != (settings.speed < 0)
        if settings.use_capture_frame or turned or at is None or not whole.start < frame < whole.end:
            raise FastGSError("the clip cannot be split here: go to a frame within it on which it has not turned around, and let its time "
                              "follow the scene's frame")
        last = clip.frame_count - 1
        second = objects.duplicate(context, obj)
        if settings.speed > 0:
            settings.trim_end, second.fastgs.trim_start = last + 1 - at, at
            settings.after = second.fastgs.before = 'HIDE'
        else:  # what comes later lies before the clip's first frame
            settings.trim_start, second.fastgs.trim_end = floor(at) + 1, last - at
            settings.before = second.fastgs.after = 'HIDE'
        second.fastgs.start_frame, second.fastgs.offset = frame, 0.0


class FASTGS_OT_mark_clip(_OnClip, bpy.types.Operator):
    """Add timeline markers at the first and the last frame of the clip, or move those that this object has already"""

    bl_idname = "fastgs.mark_clip"
    bl_label = "Add Markers"

    def act(self, context):
        markers, at = context.scene.timeline_markers, played(context.object, context.scene)
        for what, frame in (("begins", at.start), ("ends", at.end - 1)):
            name = f"{context.object.name} {what}"
            marker = markers.get(name) or markers.new(name)
            marker.frame = round(frame)


class FASTGS_OT_add_sound(_OnClip, bpy.types.Operator, ImportHelper):
    """Add the sound of the capture, from a film or a sound file, to the sequencer, in step with the clip"""

    bl_idname = "fastgs.add_sound"
    bl_label = "Add Sound"

    filter_glob: StringProperty(default="*.wav;*.flac;*.ogg;*.mp3;*.m4a;*.aac;*.mp4;*.mov;*.mkv;*.webm;*.avi", options={'HIDDEN'})
    sync: BoolProperty(name="Sync to Audio", description="Let playback drop frames rather than leave the sound behind", default=True)

    def act(self, context):
        strip = add_sound(context.scene, context.object, Path(bpy.path.abspath(self.filepath)))
        if self.sync:
            context.scene.sync_mode = 'AUDIO_SYNC'
        return f"Sound on channel {strip.channel} of the sequencer, from frame {strip.frame_start:g}"

# SPDX-License-Identifier: GPL-3.0-or-later
"""What a frame shows: from an evaluated scene to the library's list of placed models."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import fastgs_blender as fg
from ..fastgs_blender.rendering.crops import Crop
from ..fastgs_blender.rendering.instances import Instance, ObjectSettings
from . import crops, objects
from .time import Retime, clip_frame


@dataclass(frozen=True, eq=False)
class Shown:
    """One appearance of a splat object: by itself, or as an instance."""

    name: str
    path: str
    placement: np.ndarray
    retime: Retime
    crops: tuple[Crop, ...] = ()


@dataclass(frozen=True, eq=False)
class Contents:
    """A scene's splats at one moment, copied out of the depsgraph: nothing here refers to Blender's data."""

    shown: list[Shown]
    frame: float
    fps: float

    def parts(self, load=objects.load_model) -> tuple[list[Instance], dict[str, str]]:
        """What to render, and {object's name: why its file cannot be loaded}; reads files where it must."""
        parts, failed = [], {}
        for item in self.shown:
            try:
                model = load(item.path)
            except fg.FastGSError as error:
                failed[item.name] = str(error)
                continue
            frame = clip_frame(self.frame, self.fps, item.retime, model.clip)
            if frame is not None:
                parts.append(Instance(model, item.placement, model.clip.t_of_frame(frame), ObjectSettings(item.crops)))
        return parts, failed


def contents(depsgraph, visible=lambda obj: True) -> Contents:
    """What the depsgraph's view layer shows of splats on its frame and sub-frame.

    visible(obj) may leave out more: it is asked about each object that shows splats, and about what instances come from.
    """
    scene = depsgraph.scene
    render = scene.render
    shown, seen = [], set()
    for instance in depsgraph.object_instances:
        obj = instance.object
        if not (instance.show_self and objects.is_splat(obj) and visible(instance.parent if instance.is_instance else obj)):
            continue
        placement = np.array(instance.matrix_world, np.float64)
        # an object whose geometry nodes make several kinds of geometry comes once for each kind, at the same place
        key = obj.original.as_pointer(), placement.tobytes()
        if key not in seen:
            seen.add(key)
            shown.append(Shown(obj.name, objects.abspath(obj), placement, retime_of(obj), crops.crops_of(obj, depsgraph)))
    # as Blender computes the time of its animation, time stretching included
    frame = (scene.frame_current + scene.frame_subframe) * render.frame_map_old / render.frame_map_new
    return Contents(shown, frame, render.fps / render.fps_base)


def retime_of(obj) -> Retime:
    """An evaluated object's place in time."""
    settings = obj.fastgs
    return Retime(settings.start_frame, settings.speed, settings.offset, settings.before, settings.after)

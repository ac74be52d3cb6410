# SPDX-License-Identifier: GPL-3.0-or-later
"""Takes a snapshot of the splat objects that an evaluated scene shows, and loads it as the library's model instances."""
from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field, fields, replace

import numpy as np

from .. import fastgs_blender as fg
from ..fastgs_blender.rendering.filters import Filter
from ..fastgs_blender.rendering.instances import LIMIT, LOOKS, Instance, ObjectSettings
from . import crops, devices, model_space, objects, parts, point_edits, speeds
from .light_linking import Links
from .time import Retime, shown_frames

SELECTED = ObjectSettings(saturation=0.05, exposure=0.7, gamma=1.2, tint=(1.9, 0.52, 0.04), mark=1)
REFUSED = ObjectSettings(saturation=0.05, exposure=0.5, gamma=1.2, tint=(0.1, 0.5, 2.0), mark=-1)
UNSURE = (ObjectSettings(saturation=0.05, exposure=0.7, gamma=1.2, tint=(0.75, 0.2, 2.1)),
          ObjectSettings(saturation=0.05, exposure=0.7, gamma=1.2, tint=(1.9, 0.22, 0.75)))
ERASED = ObjectSettings(saturation=0.05, exposure=0.8, gamma=1.2, tint=(1.8, 0.05, 0.12))
"""The looks, on top of an object's own, in which viewports show what is selected, refused, unsure (not selected; selected) or erased."""


@dataclass(frozen=True, eq=False)
class FileInstance:
    """A splat object where it stands, or an instance of one, whose model is still a file.

    name       of the object, for messages
    path       of its file, absolute
    placement  [4, 4] float64 from the model's space to the world
    retime     how the object plays its clip
    settings   how the object shows its model
    index      the object's number, its pass index
    place      what finds the instance again on another frame
    points     what modifiers have made of its points, with *Modifiers Change: Splats*
    part       which Gaussians of the file are the object's (parts.py); the settings' mask, and these three masks, are of its own:
    selection, refused, unsure  what of it is selected, was drawn over to be none of that, and may be either; viewports alone show them
    trouble    why it cannot be shown, whatever its file holds: a sentence, or ""
    """

    name: str
    path: str
    placement: np.ndarray
    retime: Retime
    settings: ObjectSettings = field(default_factory=ObjectSettings)
    index: int = 0
    place: Hashable = None
    points: point_edits.Carried | None = None
    part: str = ""
    selection: str = ""
    refused: str = ""
    unsure: str = ""
    trouble: str = ""

    @property
    def key(self) -> tuple[str, str]:
        """The identity of the object that it shows; instances of one object share it."""
        return self.name, self.path

    @property
    def state(self) -> tuple:
        """All of it as values that can be compared."""
        return (self.path, self.placement.tobytes(), self.retime, self.settings, self.points and self.points.number, self.part,
                self.trouble)


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A scene's splats at one moment, copied out of the depsgraph: nothing here refers to Blender's data.

    frame, fps  the scene's frame (fractions are sub-frames) and frame rate
    device      what renders the scene, see devices.wanted()
    """

    instances: list[FileInstance]
    frame: float
    fps: float
    device: str = "cpu"

    @property
    def state(self) -> tuple:
        """All of it as values that can be compared."""
        return self.frame, self.fps, tuple(item.state for item in self.instances)

    def tinted(self, erased: bool = False, alone: bool = False) -> Snapshot:
        """As viewports show it: what of an object is selected, refused or unsure has a colour, and with `erased` so has what was erased.

        With `alone` only what has such a colour is shown.  Each colour is an instance of the same model, with another look and all else
        masked: on the GPU the model stays as it is.
        """
        return replace(self, instances=[each for item in self.instances for each in _tinted(item, erased)[alone:]])

    def load(self, load_model=objects.load_model, read: bool = True) -> tuple[list[Instance], list[tuple[str, str]]]:
        """(the instances to render, [(object's name, why it is left out), ...]).  Reads the files that are not in memory.

        An object that shows nothing at this time is in neither list.  With read=False frames of sequences are not read: an object
        whose frame is not in memory is left out.
        """
        pairs, left_out = self.pairs(load_model, read)
        return [instance for _, instance in pairs], left_out

    def pairs(self, load_model=objects.load_model, read: bool = True) -> tuple[list[tuple[FileInstance, Instance]], list[tuple[str, str]]]:
        """load(), with what each instance was made from."""
        loaded, left_out = [], []
        for item in self.instances:
            try:
                loaded += [(item, instance) for instance in self._load(item, load_model, read)]
            except fg.FastGSError as error:
                left_out.append((item.name, str(error)))
        return loaded, left_out

    def _load(self, item: FileInstance, load_model, read: bool) -> list[Instance]:
        """The instance at each of the times at which its object shows it: more than one where a loop fades, or with echoes."""
        if item.trouble:
            raise fg.FastGSError(item.trouble)
        if not (np.abs(item.placement) <= LIMIT).all():  # neither are NaN
            raise fg.FastGSError(f"its transform holds numbers beyond {LIMIT:g} or that are no numbers; "
                                 "clear its location, rotation and scale, or those of its parents.")
        source = parts.part_of(load_model(item.path), item.part)
        made = []
        for number, (frame, share) in enumerate(shown_frames(self.frame, self.fps, item.retime, source.clip)):
            model, t = source.moment(source.clip.t_of_frame(frame), item.retime.hold, read)
            settings = item.settings if share == 1 else replace(item.settings, opacity=item.settings.opacity * share)
            shown, at = (model, t) if item.points is None else item.points.shown(model, t, read)
            made.append(Instance(shown, item.placement, at, settings, item.name, item.index, (item.place, number) if number else item.place,
                                 None if shown is model else model))
        return made


def _tinted(item: FileInstance, erased: bool) -> list[FileInstance]:
    """An object once for each of the colours in which its Gaussians are shown; the first has those of the model."""
    hidden = item.settings.mask
    made = [(parts.union(hidden, item.selection, item.refused, item.unsure), None)]
    made += [(parts.union(hidden, item.unsure, parts.all_but(mask)), look)
             for mask, look in ((item.selection, SELECTED), (item.refused, REFUSED)) if mask]
    if item.unsure:
        sure = parts.union(hidden, parts.all_but(item.unsure))
        made += [(parts.union(sure, item.selection), UNSURE[0])]
        made += [(parts.union(sure, parts.all_but(item.selection)), UNSURE[1])] * bool(item.selection)
    made += [(parts.all_but(hidden), ERASED)] * bool(erased and hidden)
    return [replace(item, settings=replace(item.settings if look is None else item.settings.under(look), mask=mask)) for mask, look in made]


def take(depsgraph, visible=lambda obj: True, rendered: bool = True, final: bool | None = None) -> Snapshot:
    """The splats that the depsgraph's view layer shows on its frame and sub-frame.

    visible(obj) may leave out more: it is asked about each object that shows splats, and about each object that makes instances.
    rendered      whether it is for a render, from which *Ray Visibility > Camera* leaves objects and what they instance out
    final         whether it is for a final picture, or a file, and not for a viewport; None: by the depsgraph
    """
    found, seen, links = [], set(), Links(depsgraph.scene)
    final = depsgraph.mode == 'RENDER' if final is None else final
    for instance in depsgraph.object_instances:
        obj = instance.object
        maker = instance.parent if instance.is_instance else obj
        if not (instance.show_self and objects.is_splat(obj) and visible(maker)):
            continue
        if rendered and (not (obj.visible_camera and maker.visible_camera)
                         or maker.original.indirect_only_get(view_layer=depsgraph.view_layer)):
            continue
        placement = model_space.placement(obj, instance.matrix_world)
        # an object whose geometry nodes make several kinds of geometry comes once for each kind, at the same place
        key = obj.original.as_pointer(), placement.tobytes()
        if key not in seen:
            seen.add(key)
            place = obj.name_full, *((instance.parent.name_full, *instance.persistent_id) if instance.is_instance else ())
            shown = instance_of(obj, depsgraph, placement, final, maker)
            linked = replace(shown.settings, unlit_by=links.unlit_by(obj, maker), clear_to=links.clear_to(obj, maker))
            found.append(replace(shown, place=place, settings=linked, **_picked(obj)))
    return Snapshot(found, *clock(depsgraph.scene), devices.wanted(depsgraph.scene))


def _picked(obj) -> dict[str, str]:
    """The masks of what is selected of an evaluated object: its original has them, because they are no reason to evaluate it again."""
    settings = obj.original.fastgs
    return {name: parts.within(settings.part, getattr(settings, name)) for name in ("selection", "refused", "unsure")}


def instance_of(obj, depsgraph, placement: np.ndarray, final: bool = False, maker=None) -> FileInstance:
    """An evaluated splat object where it stands; maker: the object that instances it, or itself.

    Numbers of the object with which nothing can be drawn are its trouble, and nobody else's.
    """
    settings, trouble = ObjectSettings(), ""
    try:
        settings = settings_of(obj, depsgraph, final)
        if maker is not None and maker != obj and not objects.is_splat(maker):
            settings = settings.under(looks_of(maker, final))
        settings = replace(settings, casts=obj.visible_shadow and (maker is None or maker.visible_shadow))
    except fg.FastGSError as error:
        trouble = str(error)
    return FileInstance(obj.name, objects.abspath(obj), placement, retime_of(obj, clock(depsgraph.scene)[0]), settings, obj.pass_index,
                        points=point_edits.carried_of(obj, depsgraph), part=obj.fastgs.part, trouble=trouble)


def clock(scene) -> tuple[float, float]:
    """(frame, frames per second) of a scene, as Blender computes the time of its animation, time stretching included."""
    render = scene.render
    frame = (scene.frame_current + scene.frame_subframe) * render.frame_map_old / render.frame_map_new
    return frame, render.fps / render.fps_base


def retime_of(obj, frame: float) -> Retime:
    """How an object, evaluated or not, plays its clip by a frame of the scene (clock())."""
    settings = obj.fastgs
    plain = {f.name: getattr(settings, f.name) for f in fields(Retime) if f.name not in ("run", "hold", "capture_frame")}
    return Retime(run=speeds.run_of(obj, frame), hold=settings.subframes == 'HOLD',
                  capture_frame=settings.capture_frame if settings.use_capture_frame else None, **plain)


def settings_of(obj, depsgraph, final: bool = False) -> ObjectSettings:
    """How an evaluated object shows its model, in final pictures or in viewports."""
    return replace(looks_of(obj, final), crops=crops.crops_of(obj, depsgraph), filters=filters_of(obj),
                   mask=parts.within(obj.fastgs.part, obj.fastgs.mask), backdrop=obj.fastgs.backdrop)


def filters_of(obj) -> tuple[Filter, ...]:
    """The filters of an object that are used."""
    return tuple(filter_of(item) for item in obj.fastgs.filters if item.use)


def filter_of(item) -> Filter:
    """A filter of an object as the library's."""
    return Filter(item.kind, item.low, item.high, item.mode == 'KEEP', item.colour)


def looks_of(obj, final: bool) -> ObjectSettings:
    """The looks of an evaluated object, each the property of the same name: of one that instances splats, too, on top of theirs."""
    looks = {name: getattr(obj.fastgs, name) for name in LOOKS}
    return ObjectSettings(**looks, antialias=obj.fastgs.antialias, density=obj.fastgs.density if final else obj.fastgs.viewport_density)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples the scene frame by frame as what a web page plays: splat objects as final frames show them, the camera, the world, the sound."""
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

from .. import fastgs_blender as fg
from ..fastgs_blender.formats.web import Sound, cannot_play, sound_of
from ..fastgs_blender.formats.web.long import stands_for
from ..fastgs_blender.formats.web.page import PageObject
from ..fastgs_blender.model.chapters import Chapters
from ..fastgs_blender.rendering.instances import Instance
from . import camera as cameras
from . import holdout, joins, lamps, objects, snapshot, unshown, world
from .cameras import framing, keys, subjects
from .colour import rec709_to_working

SOUNDS = (('MP3', 'MP3', ".mp3"), ('OGG', 'VORBIS', ".ogg"), ('WAV', 'PCM', ".wav"))
"""Containers and codecs of the sound, the one that every browser plays first; a Blender may lack some of them."""
VIEW = 1280, 720
"""Pixels of an opening view that no camera gives."""
STAYING = {"filters": "filters", "density": "density", "backdrop": "the backdrop", "antialias": "antialiasing"}
"""Properties of an object that a page takes from its first frame alone, and their names in a sentence."""
NEAR = 0.1
"""Blender's usual *Clip Start* in metres: nothing that a page shows lies nearer."""


class _LongClip:
    """A clip in chapters as frames are sampled: at all times one model, which stands for it and has no Gaussians."""

    def __init__(self, clip: Chapters) -> None:
        self.clip, self.stands = clip.clip, stands_for(clip)

    def moment(self, t: float, hold: bool = False, read: bool = True) -> tuple[fg.GaussianModel, float]:
        return self.stands, t


class Tracks:
    """The splat objects of a scene over its frames.

    paths  of long clips, by the models that stand for them
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self.paths: dict[fg.GaussianModel, str] = {}
        self._long: dict[str, _LongClip] = {}
        self.found: dict[tuple, list[Instance | None]] = {}

    def add(self, number: int, depsgraph, chosen) -> None:
        """Take what the scene shows on a frame, counted from 0.  Raises FastGSError where a page cannot play it."""
        shown = snapshot.take(depsgraph, chosen, final=True)
        as_filed = replace(shown, instances=[replace(item, points=None) for item in shown.instances])
        instances, left_out = as_filed.load(self._playable)
        if left_out:
            raise fg.FastGSError(f"{left_out[0][0]} cannot be exported: {left_out[0][1]}")
        for instance in instances:
            self.found.setdefault((instance.place, id(instance.source)), [None] * self.count)[number] = instance

    def objects(self) -> list[PageObject]:
        """What was found, as a page's objects; where an object is not shown, its opacity is 0."""
        made = []
        for track in self.found.values():
            shown = [instance for instance in track if instance is not None]
            filled, last = [], shown[0]
            for instance in track:
                last = instance or last
                filled.append(replace(last.settings, opacity=0.0) if instance is None else instance.settings)
            around = _filled(track, shown[0])
            made.append(PageObject(shown[0].source, [each.placement for each in around], [each.t for each in around], filled))
        return made

    def _playable(self, path: str) -> fg.GaussianModel | _LongClip:
        """What a file shows; raises FastGSError where a page cannot play it."""
        model = objects.load_model(path)
        if isinstance(model, Chapters):
            if path not in self._long:
                self._long[path] = _LongClip(model)
                self.paths[self._long[path].stands] = path
            return self._long[path]
        if not isinstance(model, fg.GaussianModel):
            raise fg.FastGSError("it shows a sequence, and a page plays models; make one of it with fastgs convert.")
        reason = cannot_play(model)
        if reason:
            raise fg.FastGSError(reason)
        return model


def _filled(track: list[Instance | None], first: Instance) -> list[Instance]:
    """A track whose gaps hold what was before them."""
    filled = []
    for instance in track:
        first = instance or first
        filled.append(first)
    return filled


def sampled(context, first: int, last: int, chosen, moving: bool) -> Iterator[tuple[int, int]]:
    """Goes through the frames of the scene, yields (done, whole), and returns (PageObjects, cameras, Tracks.paths).

    chosen  which objects, see snapshot.take();  moving: whether the cameras of all frames are asked for, or the first one's
    The scene is left on its frame.  Raises FastGSError.
    """
    scene, count = context.scene, last + 1 - first
    before = scene.frame_current, scene.frame_subframe
    tracks, eyes = Tracks(count), []
    try:
        for number in range(count):
            scene.frame_set(first + number)
            depsgraph = context.evaluated_depsgraph_get()
            tracks.add(number, depsgraph, chosen)
            if scene.camera is not None and (moving or not eyes):
                area = cameras.RenderArea.full(*_size(scene))
                eyes.append(cameras.camera_of(scene.camera.evaluated_get(depsgraph), area, depsgraph))
            yield number + 1, count
    finally:
        scene.frame_set(before[0], subframe=before[1])
    if not tracks.found:
        raise fg.FastGSError("no splats are shown on these frames; show some, or choose other frames.")
    return tracks.objects(), _changing(eyes) or [_view(context)], tracks.paths


def check(context, chosen) -> None:
    """Raises FastGSError where a page cannot play what the scene shows on its frame."""
    Tracks(1).add(0, context.evaluated_depsgraph_get(), chosen)


def _changing(eyes: list[fg.Camera]) -> list[fg.Camera]:
    """The cameras, or the first where all are the same."""
    def numbers(eye: fg.Camera) -> tuple:
        return eye.world_to_camera.tobytes(), eye.fx, eye.fy, eye.cx, eye.cy

    return eyes if len({numbers(eye) for eye in eyes}) > 1 else eyes[:1]


def _size(scene) -> tuple[int, int]:
    area = cameras.render_area(scene.render)
    return area.width, area.height


def _splats(context) -> list[bpy.types.Object]:
    return [obj for obj in context.view_layer.objects if objects.is_splat(obj) and not obj.hide_render]


def _view(context) -> fg.Camera:
    """A camera from where the splats are looked at best, for scenes without one."""
    width, height = VIEW
    focal = 1.2 * height
    look, _ = framing.look_at(_splats(context), height / 2 / focal)
    matrix = cameras.OPENCV @ np.linalg.inv(np.array(look.eye, np.float64))
    return fg.Camera(width, height, focal, focal, width / 2, height / 2, matrix)


def pivot_of(context, eye: fg.Camera) -> np.ndarray:
    """What the page's view turns around [3]: before the camera, as far away as the middle of the splats."""
    middle = np.array(subjects.middle_and_radius(_splats(context))[0])
    pose = np.linalg.inv(eye.world_to_camera)
    distance = (middle - pose[:3, 3]) @ pose[:3, 2]
    return pose[:3, 3] + distance * pose[:3, 2] if distance > 0 else middle


def background_of(context) -> np.ndarray:
    """What lies behind the splats [3], linear Rec.709: the world's colour, and black on transparent film."""
    colour, _ = world.background(context.scene, context.view_layer)
    return np.linalg.inv(rec709_to_working()) @ np.array(colour or world.BLACK, np.float64)


def has_sound(scene) -> bool:
    """Whether the scene plays sound: a strip of its sequencer, or a speaker."""
    editor = scene.sequence_editor
    strips = [] if editor is None else editor.strips_all if hasattr(editor, "strips_all") else editor.sequences_all
    return any(strip.type == 'SOUND' and not strip.mute for strip in strips) or any(
        obj.type == 'SPEAKER' and obj.data.sound and not obj.data.muted for obj in scene.objects)


def sound(scene, first: int) -> Sound:
    """What the scene sounds like, mixed by Blender; first: the frame with which the page begins.  Raises FastGSError."""
    start = (first - scene.frame_start) * scene.render.fps_base / scene.render.fps
    with tempfile.TemporaryDirectory(prefix="fastgs-") as folder:
        for container, codec, extension in SOUNDS:
            file = Path(folder) / f"sound{extension}"
            try:
                bpy.ops.sound.mixdown(filepath=str(file), container=container, codec=codec, bitrate=160, check_existing=False)
            except (RuntimeError, TypeError):  # this Blender cannot write it
                continue
            if file.is_file() and file.stat().st_size:
                return sound_of(file, start)
    raise fg.FastGSError("this Blender cannot mix the scene's sound down; switch off Sound, or mute the strips.")


def not_kept(context) -> list[str]:
    """Clauses on what final frames show, or how, and a page does not."""
    scene, layer = context.scene, context.view_layer
    view, render = scene.view_settings, scene.render
    transform = view.view_transform
    graded = view.look not in ("", "None") or view.exposure != 0 or view.gamma != 1 or view.use_curve_mapping
    holdouts = [obj.name for obj in layer.objects if not objects.is_splat(obj) and holdout.is_held_out(obj, layer)]
    fixed = [f"the animation of {name} of {obj.name}" for obj in _splats(context) for name in _animated(obj)]
    lens = scene.camera.data if scene.camera is not None and scene.camera.type == 'CAMERA' else None
    lit = [obj.name for obj in _splats(context) if lamps.takes_light(obj)]
    surfaces = [obj.name for obj in unshown.objects_left_out(scene, layer)]
    pointed = [obj.name for obj in _splats(context)
               if obj.fastgs.points == 'ALL' and any(modifier.show_render for modifier in obj.modifiers)]
    told = (
        (transform != 'Standard', f"the view transform {transform}; pages show Standard"),
        (graded, "the look, exposure, gamma and curves of the scene's colour management"),
        (world.background(scene, layer)[1] is not None, "the world's picture; its background colour stands for it"),
        (bool(lit), f"Scene Light on {_named(lit)}; pages show the captured light"),
        (bool(surfaces), f"meshes: {_named(surfaces)}"),
        (bool(holdouts), f"what hides splats: {_named(holdouts)}"),
        (bool(pointed), f"what modifiers do to the points of {_named(pointed)}"),
        (bool(fixed), f"{_named(fixed)}; the first frame stands for it"),
        (render.use_compositing and joins.tree_of(scene) is not None, "what the compositor does"),
        (bool(lens and round(lens.clip_start, 4) > NEAR), "the camera's Clip Start"),
        (bool(lens and lens.dof.use_dof), "depth of field"), (render.use_motion_blur, "motion blur"))
    return [text for true, text in told if true]


def _animated(obj) -> list[str]:
    """Of STAYING, what keyframes or drivers of an object change."""
    found = [*keys.curves(obj), *(obj.animation_data.drivers if obj.animation_data else ())]
    return [name for key, name in STAYING.items() if any(curve.data_path.startswith(f"fastgs.{key}") for curve in found)]


def _named(names: list[str]) -> str:
    more = len(names) - unshown.NAMED
    return ", ".join(names[:unshown.NAMED]) + (f" and {more} more" if more > 0 else "")

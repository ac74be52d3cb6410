# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders final frames: F12, animations and the command line."""
import math
from concurrent.futures import CancelledError
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from .. import fastgs_blender as fg
from ..fastgs_blender.rendering.exposure import Aperture
from ..fastgs_blender.rendering.instances import Moment
from ..fastgs_blender.rendering.relight import SceneLight
from ..fastgs_blender.util.backends import describe_backend, failure_of, take_overflow
from ..fastgs_blender.util.threads import set_threads
from ..scene import camera, devices, exposure, holdout, lamps, notices, objects, settings, shadows, sky, snapshot, unshown, world
from . import compiling, passes, worker


def render(engine, depsgraph):
    """Render one view layer; whatever goes wrong ends as one sentence in a report, never as a silent black frame."""
    try:
        _render_layer(engine, depsgraph)
    except CancelledError:
        pass
    except fg.FastGSError as error:
        notices.fail(engine, str(error))
    except MemoryError:
        notices.fail(engine, "there is not enough memory for this frame; lower the resolution or show fewer objects.")
    except Exception as error:  # noqa: BLE001 (the boundary: Blender would call what passes it a finished render)
        notices.log.exception("unexpected error on frame %s", depsgraph.scene.frame_current)
        notices.fail(engine, f"FAST-GS could not render frame {depsgraph.scene.frame_current} ({type(error).__name__}: {error}); "
                             "the log holds the details.")


def _render_layer(engine, depsgraph):
    scene, layer = depsgraph.scene, depsgraph.view_layer
    set_threads(scene.render.threads if scene.render.threads_mode == 'FIXED' else settings.threads)
    area = camera.render_area(scene.render)
    wanted = passes.switched_on(scene, layer)
    views = _views(scene.render)
    now = _moment(engine, depsgraph, area, views)
    settings_now = passes.settings(scene)
    if _has(wanted, "shadow"):
        settings_now = replace(settings_now, shadows=shadows.shadows_of(depsgraph))
    of_lamps, status = any(entry.light for entry in wanted), Status(engine, f"{scene.name}, {layer.name}")
    around = _panorama(engine, scene, lamps.world_of(depsgraph, of_lamps), status, light=True)
    light_of = partial(lamps.scene_light, passes=of_lamps, around=around)
    settings_now = replace(settings_now, light=light_of(depsgraph))
    surfaces = lamps.surfaces(depsgraph) if settings_now.light or any(entry.name in ("normal", "unlit") for entry in wanted) else {}
    shutter = exposure.times(scene)
    middle = (shutter[0] + shutter[-1]) / 2 if shutter else 0.0
    vectors = [middle - 1, middle + 1] if _has(wanted, "vector") else []
    taken = _moments(engine, depsgraph, area, views, vectors + shutter, light_of if settings_now.light else lambda depsgraph: None)
    for text in unshown.all_of(scene, layer):
        notices.warn(engine, text)
    background = _background(engine, scene, layer, status)
    status("Reading")
    instances, left_out = worker.run(lambda progress: now.shown.load(), engine.test_break, status.progress)
    _tell(engine, layer, now.shown, left_out)
    instances = [replace(each, surface=surfaces.get(each.name)) for each in instances]
    if compiling.is_first_due():
        status("Compiling the renderer for this machine, once")
        worker.run(lambda progress: compiling.wait_for_first(), engine.test_break, status.progress)
    backend = _backend(engine, now.shown.device, status)
    status.count = sum(len(instance.model) for instance in instances)
    status.memory(objects.loaded_bytes(), area)

    passes.add(engine, layer, wanted)
    for index, view in enumerate(views):
        eye = now.cameras[view]
        status(f"Rendering {view}".strip() + f" on {describe_backend(backend)}")
        moments = [each.moment(view) for each in taken]
        before, after = moments[:2] if vectors else (None, None)
        blur, light = exposure.exposure(scene, moments[len(vectors):], now.lens), settings_now.light
        if light is not None and blur is not None:
            light = light.exposed([each.light for each in taken[len(vectors):] if each.light is not None], blur.curve)
        found = replace(settings_now, before=before, after=after, light=light)
        images = worker.run(
            lambda progress, eye=eye, found=found, blur=blur: passes.images(
                instances, eye, wanted, background(eye), progress, found, blur, now.holdout, backend),
            engine.test_break,
            lambda fraction, index=index: status.progress((index + fraction) / len(views)))
        _, _, width, height = area.window
        result = engine.begin_result(0, 0, width, height, layer=layer.name, view=view)
        passes.fill(result.layers[0], images)
        engine.end_result(result)
    if failed := failure_of(backend):
        notices.warn(engine, f"{describe_backend(backend)} fails, so the processor goes on: {failed}.")
    if large := take_overflow(backend):
        notices.warn(engine, f"{describe_backend(backend)} has no room for this picture, so the processor draws it: {large}.")
    passes.describe(engine, layer, wanted, [instance.name for instance in instances])


def _backend(engine, device: str, status) -> str:
    """The name of the backend that renders; says in a line which `auto` has taken and why, or why it is not the GPU that was asked for."""
    if device == "cpu":
        return "auto"
    name, remark = worker.run(lambda progress: devices.backend(device, progress), engine.test_break,
                              lambda fraction: status("Testing the GPU, once"))
    if remark:
        notices.inform(engine, remark)
    return name


def _background(engine, scene, layer, status):
    """A function of the camera that gives what lies behind the splats, for colour.film()."""
    plain, more = (None, None) if holdout.with_meshes(scene) else world.background(scene, layer)
    found = _panorama(engine, scene, more, status)
    return found.behind if found else lambda eye: plain


def _panorama(engine, scene, shown, status, light=False) -> sky.Panorama | None:
    """The panorama of a world on the current frame, as cameras see it or as it lights; None without one, or if it fails, which is told."""
    if shown is None:
        return None
    status("Rendering the world")
    request = sky.WorldRequest(shown, (scene.frame_current, scene.frame_subframe), light)
    while (found := sky.sky.get(request)) is None:
        sky.sky.ask(request)
        worker.run(lambda progress: sky.sky.wait(sky.PATIENCE), engine.test_break, status.progress)
    if isinstance(found, str):
        notices.warn(engine, found)
        return None
    return found


@dataclass(frozen=True, eq=False)
class _SceneMoment:
    """A scene at one moment, copied out of the depsgraph: its splats, the camera of each of the frame's pictures by its name, the lens of
    the camera, the triangles that hide splats, and what lights these, which the frame's own moment has elsewhere."""

    shown: snapshot.Snapshot
    cameras: dict[str, fg.Camera]
    lens: Aperture | None
    holdout: np.ndarray | None
    light: SceneLight | None = None

    def moment(self, view: str) -> Moment:
        """The library's Moment of this scene, for the picture of that name."""
        return Moment({instance.place: instance for instance in self.shown.load()[0]}, self.cameras[view], self.holdout)


def _moment(engine, depsgraph, area, views) -> _SceneMoment:
    """The scene at the current frame of the depsgraph."""
    cameras = {view: _camera(engine, depsgraph, area, view) for view in views}
    lens = exposure.aperture(_camera_object(engine, depsgraph), depsgraph.scene)
    return _SceneMoment(snapshot.take(depsgraph), cameras, lens, holdout.hidden_by(depsgraph))


def _moments(engine, depsgraph, area, views, frames: list[float], light_of) -> list[_SceneMoment]:
    """The scene at each of these offsets in frames from the current one; the frame of the depsgraph is restored afterwards."""
    scene = depsgraph.scene
    frame, subframe = scene.frame_current, scene.frame_subframe
    taken = []
    try:
        for later in frames:
            there = frame + subframe + later
            engine.frame_set(math.floor(there), there - math.floor(there))
            moment = replace(_moment(engine, depsgraph, area, views), light=light_of(depsgraph))
            if taken and np.array_equal(moment.holdout, taken[-1].holdout):  # what stands still is kept once
                moment = replace(moment, holdout=taken[-1].holdout)
            if taken and moment.light and taken[-1].light and np.array_equal(moment.light.meshes, taken[-1].light.meshes):
                moment = replace(moment, light=replace(moment.light, meshes=taken[-1].light.meshes))
            taken.append(moment)
    finally:
        if frames:
            engine.frame_set(frame, subframe)
    return taken


def _has(wanted, name: str) -> bool:
    return any(entry.name == name for entry in wanted)


def _views(render) -> list[str]:
    """The names of the pictures that a frame consists of: those of the eyes, or one without a name."""
    if not render.use_multiview:
        return [""]
    stereo = render.views_format == 'STEREO_3D'
    return [view.name for view in render.views if view.use and (not stereo or view.name in ("left", "right"))]


def _camera(engine, depsgraph, area, view):
    if view:
        engine.active_view_set(view)
    obj = _camera_object(engine, depsgraph)
    if obj.type == 'CAMERA' and obj.data.type == 'PANO':
        return camera.panorama_of(obj, area, engine.camera_model_matrix(obj) if view else None)
    if not view:
        return camera.camera_of(obj, area, depsgraph)
    return camera.camera_of(obj, area, depsgraph, engine.camera_model_matrix(obj), engine.camera_shift_x(obj))


def _camera_object(engine, depsgraph):
    """The camera to render from, evaluated.  Raises FastGSError where there is none."""
    obj = engine.camera_override or depsgraph.scene.camera
    if obj is None:
        raise fg.FastGSError("the scene has no camera; add one to render.")
    return obj.evaluated_get(depsgraph)


def _tell(engine, layer, shown, left_out):
    """Report the objects that are not in the picture.  Raises FastGSError where none is in it."""
    if not shown.instances:
        notices.warn(engine, f'The view layer "{layer.name}" shows no 4D Gaussians: only the background is rendered.')
    texts = [f"{name} is left out: {text}" for name, text in left_out]
    if texts and len(texts) == len(shown.instances):
        raise fg.FastGSError(texts[0])
    for text in texts:
        notices.warn(engine, text)


class Status:
    """Blender's status line, progress bar and memory figures."""

    def __init__(self, engine, title):
        self.engine, self.title, self.count = engine, title, None

    def __call__(self, stage):
        gaussians = "" if self.count is None else f"{self.count:,} Gaussians | "
        self.engine.update_stats("", f"{self.title} | {gaussians}{stage}")

    def progress(self, fraction):
        self.engine.update_progress(fraction)

    def memory(self, models: int, area):
        used = (models + 40 * area.window[2] * area.window[3]) / 2**20  # bytes a pixel: channels, Combined, a copy
        self.engine.update_memory_stats(memory_used=used, memory_peak=used)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws splats in the 3D viewports of the open windows, and draws them again when something changes."""
from __future__ import annotations

import logging
from dataclasses import replace
from functools import cache

import bpy
import gpu
import numpy as np

from ... import fastgs_blender as fg
from ...scene import colour, holdout, objects, proxies, shadows, sky, snapshot, unshown, world
from .. import compiling, passes
from . import frusta, meshes, overlays, shaders
from .atlas import Atlas
from .eye import WHOLE, eye, frame_in
from .fallback import DataPass
from .picture import SceneDepth
from .textures import flat
from .view import Around, Display, View
from .worker import Worker

log = logging.getLogger(__name__)

TICK = 1 / 60

atlas = Atlas()
_worker = Worker()
_views: dict[tuple[int, bool], View] = {}
_snapshots: dict[tuple, snapshot.Snapshot] = {}
_surfaces: dict[tuple, bool] = {}
_holdouts: dict[tuple, np.ndarray | None] = {}
_data_passes: dict[tuple, DataPass] = {}
_any_splats: bool | None = None
_changes = 0
_request: tuple[int, sky.WorldRequest] | None = None
_sky_awaited = False


def view_draw(context, depsgraph) -> None:
    """Rendered shading under our engine: scene-linear, premultiplied; Blender applies the view transform."""
    scene, region = depsgraph.scene, context.region
    background = _background(scene, depsgraph.view_layer)
    display = Display(colour.rec709_to_working(), background, _border(context, depsgraph))
    _draw(context, depsgraph, display, region, rendered=True, data=_data_pass(context.space_data, depsgraph))


def _background(scene, view_layer):
    """A colour or a Panorama, None for transparent film; until a world has been rendered its plain colour, or what was there before."""
    global _request
    plain, more = world.background(scene, view_layer)
    if more is None:
        _request = None
        return plain
    if _request is None or _request[0] != _changes:
        _request = _changes, sky.WorldRequest(more, (scene.frame_current, scene.frame_subframe))
    found = sky.sky.get(_request[1])
    if found is None:
        sky.sky.ask(_request[1])
        _start()
        found = sky.sky.latest()
    return found if isinstance(found, sky.Panorama) else plain


def _cover(context, depsgraph):
    """Remove the parts of Blender's overlays that lie behind splats, in Rendered shading under our engine."""
    region, matrices = context.region, context.region_data
    view = _views.get((region.as_pointer(), True))
    if view is None or overlays.in_front(context, depsgraph):
        return
    try:
        _, depths = eye(region.width, region.height, matrices.view_matrix, matrices.window_matrix)
    except fg.FastGSError:
        return
    floor, marks = overlays.floor(context), overlays.marks(context)
    view.cover(depths, (region.width, region.height), floor, marks)


def post_view() -> None:
    """Every other shading: with the scene's meshes, over what Blender has drawn."""
    context = bpy.context
    space, scene = context.space_data, context.scene
    depsgraph = context.evaluated_depsgraph_get()
    if not proxies.up_to_date():  # the window shows another scene
        _start()
    _draw_pictures(context, depsgraph)
    if not shows_over(space, scene):
        _put_aside(context.region, False)
        if overlays.drawn(context):
            _cover(context, depsgraph)
        return
    _put_aside(context.region, True)
    xray = space.shading.type == 'SOLID' and space.shading.show_xray
    display = Display(np.eye(3), opacity=space.shading.xray_alpha if xray else 1.0, **_passepartout(context, depsgraph))
    _draw(context, depsgraph, display, context.region, rendered=False, hidden=not xray)


def _draw_pictures(context, depsgraph):
    """The pictures on frusta; under our own Rendered shading they would cover splats that stand before them."""
    shading = context.space_data.shading.type
    if shading == 'RENDERED' and context.scene.render.engine == 'FASTGS':
        return
    try:
        frusta.draw(context, depsgraph)
    except Exception as error:  # noqa: BLE001 (drivers and Blender's images raise anything; the window must go on)
        _say_once(f"The cameras' pictures cannot be shown in viewports ({error}).")


def _put_aside(region, rendered):
    """Free the GPU memory of the other of the two ways in which a region can draw splats."""
    view = _views.pop((region.as_pointer(), rendered), None)
    if view is not None:
        view.free()


def shows_over(space, scene) -> bool:
    """Whether a viewport shows splats over what Blender draws."""
    shading = space.shading.type
    return scene.fastgs.show_splats and shading != 'WIREFRAME' and not (shading == 'RENDERED' and scene.render.engine == 'FASTGS')


def _draw(context, depsgraph, display, region, rendered, hidden=False, data=None):
    shown = snapshot_of(context.space_data, depsgraph, rendered)
    _forget_closed()
    view = _views.get((region.as_pointer(), rendered))
    if view is None:
        if not shown.instances and not rendered:
            return
        compiling.start_on_first_use()
        view = _views[region.as_pointer(), rendered] = View(atlas, _worker, _shown_models)
    settings, matrices = context.scene.fastgs, context.region_data
    divider = int(settings.viewport_pixels)
    try:
        camera, depths = eye(
            region.width, region.height, matrices.view_matrix, matrices.window_matrix, divider, _picture(context, depsgraph))
    except fg.FastGSError as error:  # through a camera whose transform holds no numbers Blender draws nothing either
        view.trouble = str(error)
        return
    around = None
    if hidden:
        space = context.space_data
        around = Around(depths, (_changes, overlays.state(context)), bool(shown.instances) and has_surfaces(space, depsgraph),
                        lambda: scene_depth(region.width, region.height, depths))
    elif rendered and data is None and not compiling.is_running():
        triangles = _holdout(context.space_data, depsgraph)
        if triangles is not None:
            around = Around(depths, (_changes,), True, lambda: meshes.scene_depth(triangles, camera, depths), True)
    playing = context.screen is not None and context.screen.is_animation_playing
    view.draw(shown, camera, display, settings.viewport_density, playing, around, deep=rendered and overlays.drawn(context),
              data=data)
    if view.waiting or view.coarse or view.stale:
        _start()


def _start():
    if not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=TICK)


def scene_depth(width: int, height: int, depths) -> SceneDepth | None:
    """What the active framebuffer has drawn, as depth; None where nothing is there to hide splats, or it cannot be read."""
    try:
        values = flat(gpu.state.active_framebuffer_get().read_depth(0, 0, width, height)).reshape(height, width)
    except Exception as error:  # noqa: BLE001 (drivers raise anything; the window must go on)
        _say_once(f"The viewport's depth cannot be read ({error}): meshes do not hide splats in it.")
        return None
    return None if values.min(initial=1.0) >= 1.0 else SceneDepth(values, depths)


def snapshot_of(space, depsgraph, rendered: bool = False) -> snapshot.Snapshot:
    """The splats that a viewport shows, kept until something changes; those that a render shows, if it is Rendered shading."""
    global _any_splats
    if _any_splats is None:
        _any_splats = any(objects.is_splat(obj) for obj in bpy.data.objects)
    if not _any_splats:  # spare scenes without splats the walk over all their instances
        return snapshot.Snapshot([], 0.0, 1.0)
    key = *_key(space, depsgraph), rendered
    found = _snapshots.get(key)
    if found is None:
        found = _snapshots[key] = snapshot.take(depsgraph, lambda obj: _visible(obj, space), rendered)
    return found


def _holdout(space, depsgraph):
    """The triangles that hide splats in Rendered shading, kept until something changes; None without any."""
    key = _key(space, depsgraph)
    if key not in _holdouts:
        _holdouts[key] = holdout.hidden_by(depsgraph, lambda obj: _visible(obj, space))
    return _holdouts[key]


def _data_pass(space, depsgraph) -> DataPass | None:
    """The pass that a viewport shows in Rendered shading, kept until something changes; None for the picture itself."""
    chosen = passes.in_viewport(space.shading, depsgraph.scene)
    if chosen is None:
        return None
    key = *_key(space, depsgraph), chosen
    if key not in _data_passes:
        settings = passes.settings(depsgraph.scene)
        if chosen == "shadow":
            try:
                settings = replace(settings, shadow=shadows.shadow_of(depsgraph))
            except fg.FastGSError as error:
                _say_once(str(error))
        _data_passes[key] = DataPass(chosen, settings, _holdout(space, depsgraph), (_changes,))
    return _data_passes[key]


def has_surfaces(space, depsgraph) -> bool:
    """Whether a viewport shows surfaces beside splats."""
    key = _key(space, depsgraph)
    found = _surfaces.get(key)
    if found is None:
        found = _surfaces[key] = any(
            instance.object.type in unshown.SURFACES and not objects.is_splat(instance.object)
            and _visible(instance.parent if instance.is_instance else instance.object, space) for instance in depsgraph.object_instances)
    return found


def changed(*_) -> None:
    """Note that the scene has changed: all viewports take a new snapshot when they draw next."""
    global _any_splats, _changes
    _any_splats = None
    _changes += 1
    _snapshots.clear()
    _surfaces.clear()
    _holdouts.clear()
    _data_passes.clear()


def memory() -> int:
    """Bytes that viewports hold on the GPU."""
    return atlas.nbytes + sum(view.picture.nbytes for view in _views.values())


def timed() -> list[str]:
    """Of each viewport that shows splats: how long the stages of its picture take, as lines of text."""
    lines = []
    for view in _views.values():
        found = view.timed()
        if found is not None:
            camera, count, stages = found
            lines.append(f"viewport of {camera.width} x {camera.height} with {count:,} splats in order, median milliseconds: "
                         + ", ".join(f"{stage} {value:.1f}" for stage, value in stages.items()))
    return lines


def trouble() -> str | None:
    """What keeps viewports from showing all splats, as a sentence; None where nothing does."""
    found = _request and sky.sky.get(_request[1])
    return next((view.trouble for view in _views.values() if view.trouble), found if isinstance(found, str) else None)


def clear(*_) -> None:
    """Free all that is on the GPU, and forget all viewports."""
    for view in _views.values():
        view.free()
    _views.clear()
    atlas.clear()
    frusta.clear()
    changed()


def stop() -> None:
    """Stop the timer and the thread, and free all that viewports hold, when the extension is disabled."""
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    _worker.stop()
    sky.sky.stop()
    clear()
    shaders.clear()
    frusta.free_shader()
    proxies.hide(False)


def redraw(*_) -> None:
    """Draw all 3D viewports again, after a setting of theirs has changed."""
    if not bpy.app.is_job_running('RENDER'):
        proxies.update()
    _start()
    for region in _regions():
        region.tag_redraw()


@cache
def _say_once(text):
    log.warning(text)


def _key(space, depsgraph):
    """The viewport's own settings that decide which objects it shows, as values that can be compared."""
    return (space.as_pointer(), depsgraph.scene.original.as_pointer(), depsgraph.view_layer.name, space.local_view is not None,
            space.use_local_collections, space.show_object_viewport_mesh, tuple(file.filepath for file in bpy.data.cache_files))


def _visible(obj, space) -> bool:
    """Whether a viewport shows an evaluated object.  (In Blender 4.3 its original does not know about local views.)"""
    if obj.type == 'MESH' and not space.show_object_viewport_mesh:
        return False
    return obj.visible_in_viewport_get(space)


def _shown_models():
    return [model for view in _views.values() for model in view.models]


def _picture(context, depsgraph):
    """The rectangle of the region that the final render shows: left, bottom, right, top in 0..1."""
    if context.region_data.view_perspective == 'CAMERA':
        return _camera_frame(context, depsgraph) or WHOLE
    return WHOLE


def _border(context, depsgraph):
    """The part of the region to render: left, bottom, right, top, 0..1."""
    space, render = context.space_data, depsgraph.scene.render
    if context.region_data.view_perspective == 'CAMERA':
        frame_ = _camera_frame(context, depsgraph)
        if frame_ is None or not render.use_border:
            return WHOLE
        left, bottom, right, top = frame_
        return (left + render.border_min_x * (right - left), bottom + render.border_min_y * (top - bottom),
                left + render.border_max_x * (right - left), bottom + render.border_max_y * (top - bottom))
    if space.use_render_border:
        return space.render_border_min_x, space.render_border_min_y, space.render_border_max_x, space.render_border_max_y
    return WHOLE


def _passepartout(context, depsgraph) -> dict:
    """How Blender darkens what lies outside the camera's picture."""
    space = context.space_data
    if context.region_data.view_perspective == 'CAMERA' and space.overlay.show_overlays:
        frame_ = _camera_frame(context, depsgraph)
        camera = space.camera if space.use_local_camera else depsgraph.scene.camera
        if frame_ is not None and camera.data.show_passepartout:
            return {"frame": frame_, "outside": 1 - camera.data.passepartout_alpha}
    return {}


def _camera_frame(context, depsgraph):
    """Where the camera's picture lies in a region that looks through it; None where that is no camera."""
    space, render = context.space_data, depsgraph.scene.render
    camera = space.camera if space.use_local_camera else depsgraph.scene.camera
    if camera is None or camera.type != 'CAMERA':
        return None
    width, height = render.resolution_x, render.resolution_y
    projection = camera.evaluated_get(depsgraph).calc_matrix_camera(
        depsgraph, x=width, y=height, scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y)
    return frame_in(context.region_data.window_matrix, projection)


def _regions():
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == 'VIEW_3D':
                yield from (region for region in area.regions if region.type == 'WINDOW')


def _forget_closed():
    """Free the state of viewports that have been closed."""
    open_ = {region.as_pointer() for region in _regions()}
    for key in [key for key in _views if key[0] not in open_]:
        _views.pop(key).free()


def _tick():
    """A timer that draws the viewports whose new order or picture has arrived; it ends when nothing is under way."""
    global _sky_awaited
    busy = sky.sky.busy
    arrived, _sky_awaited = _sky_awaited and not busy, busy
    if bpy.app.is_job_running('RENDER'):
        return 0.5  # it reads the data that is written below
    proxies.update()
    for region in _regions():
        for rendered in (False, True):
            view = _views.get((region.as_pointer(), rendered))
            if view is None:
                continue
            if view.stale or (view.coarse and view.resting) or (arrived and rendered):
                region.tag_redraw()
            busy |= view.waiting or view.stale or view.coarse
    return TICK if busy else None

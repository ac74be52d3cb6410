# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws splats in the 3D viewports of the open windows, and draws them again when something changes."""
import logging
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import bpy
import gpu
import numpy as np

from ... import fastgs_blender as fg
from ...fastgs_blender.rendering.passes import PASSES
from ...scene import colour, holdout, lamps, objects, proxies, shadows, sky, snapshot, world
from .. import compiling, passes
from . import fallback, frusta, meshes, overlays, shaders
from .atlas import MOST_BYTES, Atlas
from .camera_frame import border, passepartout, picture
from .eye import eye
from .fallback import DataPass
from .picture import SceneDepth
from .textures import flat
from .view import Around, Display, View
from .worker import Worker

log = logging.getLogger(__name__)

TICK = 1 / 60
LIGHT_SIZE = 512
"""Pixels of the pictures from lamps, in which viewports look up shadows."""


class Viewports:
    """All 3D viewports, from the extension's start to its end.

    views    the View of each region that shows splats, by the region and whether it is Rendered shading under our engine
    changes  how often the scene has changed
    timer    draws the viewports whose new order or picture has arrived
    """

    def __init__(self):
        self.atlas, self.worker = Atlas(), Worker()
        self.views: dict[tuple[int, bool], View] = {}
        self.changes = 0
        self.timer = self._tick  # Blender knows a timer by the function itself
        self._known: dict[tuple, Any] = {}
        self._request: sky.WorldRequest | None = None
        self._sky_awaited = False

    # what the scene shows

    def changed(self) -> None:
        """Note that the scene has changed: all viewports take a new snapshot when they draw next."""
        self.changes += 1
        self._known.clear()

    def _once(self, what: str, make: Callable[[], Any], space=None, depsgraph=None, *more):
        """What make() gives, kept until the scene changes; of a viewport, for each set of the settings that decide what it shows."""
        key = (what, *more) if space is None else (
            what, *more, space.as_pointer(), depsgraph.scene.original.as_pointer(), depsgraph.view_layer.name,
            space.local_view is not None, space.use_local_collections, space.show_object_viewport_mesh,
            tuple(file.filepath for file in bpy.data.cache_files))
        if key not in self._known:
            self._known[key] = make()
        return self._known[key]

    def snapshot_of(self, space, depsgraph, rendered: bool = False) -> snapshot.Snapshot:
        """The splats that a viewport shows; those that a render shows, if it is Rendered shading."""
        if not self._once("any", lambda: any(objects.is_splat(obj) for obj in bpy.data.objects)):
            return snapshot.Snapshot([], 0.0, 1.0)  # spare scenes without splats the walk over all their instances
        return self._once("splats", lambda: snapshot.take(depsgraph, lambda obj: _visible(obj, space), rendered), space, depsgraph,
                          rendered)

    def drawn_of(self, space, depsgraph, rendered: bool = False) -> snapshot.Snapshot:
        """The same as it is drawn: overlays colour what is selected, and Wireframe shows nothing else."""
        shown, erased = self.snapshot_of(space, depsgraph, rendered), bpy.context.window_manager.fastgs.show_erased
        if not space.overlay.show_overlays:
            return shown
        alone = space.shading.type == 'WIREFRAME'
        return self._once("drawn", lambda: shown.tinted(erased, alone), space, depsgraph, rendered, erased, alone)

    def has_surfaces(self, space, depsgraph) -> bool:
        """Whether a viewport shows surfaces beside splats."""
        return self._once("surfaces", lambda: any(
            instance.object.type in objects.SURFACES and not objects.is_splat(instance.object)
            and _visible(instance.parent if instance.is_instance else instance.object, space)
            for instance in depsgraph.object_instances), space, depsgraph)

    def _holdout(self, space, depsgraph):
        """The triangles that hide splats in Rendered shading; None without any."""
        return self._once("holdout", lambda: holdout.hidden_by(depsgraph, lambda obj: _visible(obj, space)), space, depsgraph)

    def _data_pass(self, space, depsgraph) -> DataPass | None:
        """The pass that a viewport shows in Rendered shading, or the picture where lamps light splats; None: shaders draw."""
        chosen = passes.in_viewport(space.shading, depsgraph.scene)
        of_lamps = chosen in PASSES and PASSES[chosen].light
        lit_by = self._once("lit by", lambda: lamps.world_of(depsgraph, of_lamps), space, depsgraph, of_lamps)
        around = self._panorama(depsgraph.scene, lit_by, light=True) if lit_by else None
        light = self._once("light", lambda: lamps.scene_light(depsgraph, LIGHT_SIZE, of_lamps, around), space, depsgraph, of_lamps, around)
        if chosen is None and light is not None:
            chosen = fallback.PICTURE

        def make():
            settings = replace(passes.settings(depsgraph.scene), light=light)
            if chosen == "shadow":
                try:
                    settings = replace(settings, shadows=shadows.shadows_of(depsgraph)[:1])
                except fg.FastGSError as error:
                    _say_once(str(error))
            surfaces = lamps.surfaces(depsgraph) if light or chosen in ("normal", "unlit") else {}
            return DataPass(chosen, settings, self._holdout(space, depsgraph), (self.changes, around), surfaces)

        return None if chosen is None else self._once("pass", make, space, depsgraph, chosen, around)

    def _background(self, scene, view_layer):
        """A colour or a Panorama, None for transparent film; until a world has been rendered its plain colour, or what was there before."""
        plain, more = world.background(scene, view_layer)
        if more is None:
            self._request = None
            return plain
        return self._panorama(scene, more) or plain

    def _panorama(self, scene, shown, light=False) -> sky.Panorama | None:
        """The panorama of a world, as cameras see it or as it lights, or the one that was there before until it has been rendered."""
        self._request = self._once("world as it lights" if light else "world as it is seen", lambda: sky.WorldRequest(
            shown, (scene.frame_current, scene.frame_subframe), light))
        found = sky.sky.get(self._request)
        if found is None:
            sky.sky.ask(self._request)
            self.start()
            found = sky.sky.latest()
        return found if isinstance(found, sky.Panorama) else None

    # drawing

    def view_draw(self, context, depsgraph) -> None:
        """Rendered shading under our engine: scene-linear, premultiplied; Blender applies the view transform."""
        background = self._background(depsgraph.scene, depsgraph.view_layer)
        display = Display(colour.rec709_to_working(), background, border(context, depsgraph))
        self._draw(context, depsgraph, display, rendered=True, data=self._data_pass(context.space_data, depsgraph))

    def post_view(self) -> None:
        """Every other shading: with the scene's meshes, over what Blender has drawn."""
        context = bpy.context
        space, scene = context.space_data, context.scene
        depsgraph = context.evaluated_depsgraph_get()
        if not proxies.up_to_date():  # the window shows another scene
            self.start()
        _draw_pictures(context, depsgraph)
        wires = space.shading.type == 'WIREFRAME'
        over = scene.fastgs.show_splats and space.overlay.show_overlays if wires else shows_over(space, scene)
        aside = self.views.pop((context.region.as_pointer(), over), None)
        if aside is not None:  # the other of the two ways in which a region can draw splats
            aside.free()
        if not over:
            if overlays.drawn(context):
                self._cover(context, depsgraph)
            return
        xray = space.shading.type == 'SOLID' and space.shading.show_xray
        display = Display(np.eye(3), opacity=space.shading.xray_alpha if xray else 1.0, **passepartout(context, depsgraph))
        self._draw(context, depsgraph, display, rendered=False, hidden=not (xray or wires))

    def _cover(self, context, depsgraph):
        """Remove the parts of Blender's overlays that lie behind splats, in Rendered shading under our engine."""
        region, matrices = context.region, context.region_data
        view = self.views.get((region.as_pointer(), True))
        if view is None or overlays.in_front(context, depsgraph):
            return
        try:
            _, depths = eye(region.width, region.height, matrices.view_matrix, matrices.window_matrix)
        except fg.FastGSError:
            return
        view.cover(depths, (region.width, region.height), overlays.floor(context), overlays.marks(context))

    def _draw(self, context, depsgraph, display, rendered, hidden=False, data=None):
        space, region = context.space_data, context.region
        shown = self.drawn_of(space, depsgraph, rendered)
        self._forget_closed()
        view = self.views.get((region.as_pointer(), rendered))
        if view is None:
            if not shown.instances and not rendered:
                return
            compiling.start_on_first_use()
            view = self.views[region.as_pointer(), rendered] = View(
                self.atlas, self.worker, lambda: [model for view in self.views.values() for model in view.models])
        settings, matrices = context.scene.fastgs, context.region_data
        try:
            camera, depths = eye(region.width, region.height, matrices.view_matrix, matrices.window_matrix, int(settings.viewport_pixels),
                                 picture(context, depsgraph))
        except fg.FastGSError as error:  # through a camera whose transform holds no numbers Blender draws nothing either
            view.trouble = str(error)
            return
        around = None
        if hidden:
            around = Around(depths, (self.changes, overlays.state(context)), bool(shown.instances) and self.has_surfaces(space, depsgraph),
                            lambda: scene_depth(region.width, region.height, depths))
        elif rendered and data is None and not compiling.is_running():
            triangles = self._holdout(space, depsgraph)
            if triangles is not None:
                around = Around(depths, (self.changes,), True, lambda: meshes.scene_depth(triangles, camera, depths), True)
        playing = context.screen is not None and context.screen.is_animation_playing
        view.draw(shown, camera, display, settings.viewport_density, playing, around, deep=rendered and overlays.drawn(context), data=data)
        if view.waiting or view.coarse or view.stale:
            self.start()

    def redraw(self, *_) -> None:
        """Draw all 3D viewports again, after a setting of theirs has changed, and the buttons that depend on it."""
        if not bpy.app.is_job_running('RENDER'):
            proxies.update()
        self.start()
        for window in bpy.context.window_manager.windows:
            for area in window.screen.areas:
                if area.type in {'VIEW_3D', 'PROPERTIES'}:
                    area.tag_redraw()

    def start(self) -> None:
        """Start the timer; it ends when nothing is under way."""
        if not bpy.app.timers.is_registered(self.timer):
            bpy.app.timers.register(self.timer, first_interval=TICK)

    def _tick(self):
        busy = sky.sky.busy
        arrived, self._sky_awaited = self._sky_awaited and not busy, busy
        if bpy.app.is_job_running('RENDER'):
            return 0.5  # it reads the data that is written below
        proxies.update()
        for region in _regions():
            for rendered in (False, True):
                view = self.views.get((region.as_pointer(), rendered))
                if view is None:
                    continue
                if view.stale or (view.coarse and view.resting) or (arrived and rendered):
                    region.tag_redraw()
                busy |= view.waiting or view.stale or view.coarse
        return TICK if busy else None

    # what they hold, and its end

    def memory(self) -> int:
        """Bytes that viewports hold on the GPU."""
        return self.atlas.nbytes + sum(view.picture.nbytes for view in self.views.values())

    def most_memory(self) -> int:
        """Bytes that they hold there at most: with as many Gaussians as textures take, in windows of this size."""
        return self.memory() - self.atlas.nbytes + MOST_BYTES

    def timed(self) -> list[str]:
        """Of each viewport that shows splats: how long the stages of its picture take, as lines of text."""
        found = [each for each in (view.timed() for view in self.views.values()) if each is not None]
        return [f"viewport of {camera.width} x {camera.height} with {count:,} splats in order, median milliseconds: "
                + ", ".join(f"{stage} {value:.1f}" for stage, value in stages.items()) for camera, count, stages in found]

    def trouble(self) -> str | None:
        """What keeps viewports from showing all splats, as a sentence; None where nothing does."""
        found = self._request and sky.sky.get(self._request)
        return next((view.trouble for view in self.views.values() if view.trouble), found if isinstance(found, str) else None)

    def _forget_closed(self):
        """Free the state of viewports that have been closed."""
        open_ = {region.as_pointer() for region in _regions()}
        for key in [key for key in self.views if key[0] not in open_]:
            self.views.pop(key).free()

    def clear(self) -> None:
        """Free all that is on the GPU, and forget all viewports."""
        for view in self.views.values():
            view.free()
        self.views.clear()
        self.atlas.clear()
        frusta.clear()
        self.changed()

    def stop(self) -> None:
        """Stop the timer and the thread, and free all that viewports hold, when the extension is disabled."""
        if bpy.app.timers.is_registered(self.timer):
            bpy.app.timers.unregister(self.timer)
        self.worker.stop()
        sky.sky.stop()
        self.clear()
        shaders.clear()
        frusta.free_shader()
        proxies.hide(False)


viewports = Viewports()


def changed(*_) -> None:
    """A handler of Blender's for what changes the scene."""
    viewports.changed()


def clear(*_) -> None:
    """A handler of Blender's for what closes the scene."""
    viewports.clear()


def shows_over(space, scene) -> bool:
    """Whether a viewport shows splats over what Blender draws."""
    shading = space.shading.type
    return scene.fastgs.show_splats and shading != 'WIREFRAME' and not (shading == 'RENDERED' and scene.render.engine == 'FASTGS')


def scene_depth(width: int, height: int, depths) -> SceneDepth | None:
    """What the active framebuffer has drawn, as depth; None where nothing is there to hide splats, or it cannot be read."""
    try:
        values = flat(gpu.state.active_framebuffer_get().read_depth(0, 0, width, height)).reshape(height, width)
    except Exception as error:  # noqa: BLE001 (drivers raise anything; the window must go on)
        _say_once(f"The viewport's depth cannot be read ({error}): meshes do not hide splats in it.")
        return None
    return None if values.min(initial=1.0) >= 1.0 else SceneDepth(values, depths)


def _draw_pictures(context, depsgraph):
    """The pictures on frusta; under our own Rendered shading they would cover splats that stand before them."""
    shading = context.space_data.shading.type
    if shading == 'RENDERED' and context.scene.render.engine == 'FASTGS':
        return
    try:
        frusta.draw(context, depsgraph)
    except Exception as error:  # noqa: BLE001 (drivers and Blender's images raise anything; the window must go on)
        _say_once(f"The cameras' pictures cannot be shown in viewports ({error}).")


@cache
def _say_once(text):
    log.warning(text)


def _visible(obj, space) -> bool:
    """Whether a viewport shows an evaluated object.  (In Blender 4.3 its original does not know about local views.)"""
    if obj.type == 'MESH' and not space.show_object_viewport_mesh:
        return False
    return obj.visible_in_viewport_get(space)


def _regions():
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == 'VIEW_3D':
                yield from (region for region in area.regions if region.type == 'WINDOW')

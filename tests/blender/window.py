# SPDX-License-Identifier: GPL-3.0-or-later
"""Stories in Blender's window (see inside.py): generators that yield the seconds to wait.

Screenshots are of the whole virtual screen, which the window fills.
"""
from __future__ import annotations

import math
import os
import struct
import sys
import zlib
from importlib import import_module
from pathlib import Path

import addon_utils
import bpy
import numpy as np
from background import ADDON, bring, look
from held_runs import GUARD
from mathutils import Euler, Matrix, Vector

SCREEN = "/tmp/Xvfb_screen0"  # noqa: S108 - a folder of this Blender's own
"""Where window.sh's X server keeps what it shows, in the format of xwd."""


def screen():
    """The virtual screen, RGB [h, w, 3], from the file in which its server keeps it: no program is started to ask for it."""
    data = Path(SCREEN).read_bytes()
    header = [int(number) for number in np.frombuffer(data, ">u4", 20)]  # xwd's; behind it 12 bytes a colour of a palette
    width, height, stride, begin = header[4], header[5], header[12], header[0] + 12 * header[19]
    return np.frombuffer(data, np.uint8, height * stride, begin).reshape(height, -1, 4)[:, :width, 2::-1]


def shot(name, picture=None):
    """A screenshot, or a picture of screen(), as a PNG.  Blender's own operator takes black ones on software OpenGL."""
    picture = screen() if picture is None else picture
    height, width = picture.shape[:2]
    rows = np.insert(picture.reshape(height, -1), 0, 0, axis=1)  # each begins with its filter: none
    chunks = {b"IHDR": struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0), b"IDAT": zlib.compress(rows.tobytes(), 1), b"IEND": b""}
    Path(f"{name}.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks.items()))


def turns(number=3):
    """Let Blender's loop go round so often: each time it handles what was simulated and draws, however long that takes."""
    for _ in range(number):
        yield 0.0


def under_way():
    """Whether viewports wait for anything, such as a file or an order of the splats, that the extension's thread works on.

    One behind a full-screen editor or a picture is not drawn, and may wait for as long as that is there.
    """
    spaces = sys.modules.get(f"{ADDON}.engine.viewport.spaces")
    shown = any(area.type == 'VIEW_3D' for window in bpy.context.window_manager.windows for area in window.screen.areas)
    return shown and spaces is not None and any(view.waiting or view.stale or view.coarse for view in spaces.viewports.views.values())


def settled(name, limit=GUARD):
    """A screenshot of when the screen was the same in six looks in a row, a tenth of a second apart, and nothing was under way."""
    before, same, waited = None, 0, 0.0
    while same < 5:
        if waited > limit:
            raise AssertionError(f"the window did not come to rest within {limit} s")
        yield 0.1  # Blender draws in between, however long that takes
        waited += 0.1
        now = screen()
        same = same + 1 if np.array_equal(now, before) and not under_way() else 0
        before = now
    shot(name, now)


def area_of(kind='VIEW_3D'):
    """The window's largest area of a kind."""
    areas = [area for area in bpy.context.window_manager.windows[0].screen.areas if area.type == kind]
    return max(areas, key=lambda area: area.width * area.height)


def within(area):
    """The context of an area's main region."""
    region = next(region for region in area.regions if region.type == 'WINDOW')
    return bpy.context.temp_override(window=bpy.context.window_manager.windows[0], area=area, region=region)


def press(key, area):
    """A key, with the mouse in the middle of an area."""
    window = bpy.context.window_manager.windows[0]
    x, y = area.x + area.width // 2, area.y + area.height // 2
    window.event_simulate(type='MOUSEMOVE', value='NOTHING', x=x, y=y)
    yield from turns()
    for value in ('PRESS', 'RELEASE'):
        window.event_simulate(type=key, value=value, x=x, y=y)
    yield from turns()


def until(condition, limit=GUARD):
    """Wait for something; False where it does not come to be, however long that takes: the limit is a guard against hanging."""
    waited = 0.0
    while not condition() and waited < limit:
        yield 0.05
        waited += 0.05
    return condition()


def f12(area):
    """Press F12 and wait for the picture, which replaces an area."""
    done = []
    bpy.app.handlers.render_complete.append(lambda *_: done.append(True))
    bpy.context.preferences.view.render_display_type = 'AREA'
    yield from press('F12', area)
    finished = yield from until(lambda: done)
    yield from turns()
    if not finished:
        raise AssertionError("F12 did not finish")


def frame_in_region(area):
    """Look through the camera with one pixel of the picture on one of the screen: (x, y, w, h) of the picture in a screenshot."""
    from bpy_extras.view3d_utils import location_3d_to_region_2d as project

    region = next(region for region in area.regions if region.type == 'WINDOW')
    space = area.spaces.active
    scene = bpy.context.scene
    space.region_3d.view_perspective = 'CAMERA'
    space.overlay.show_overlays = False
    space.show_gizmo = False
    with within(area):
        bpy.ops.view3d.zoom_camera_1_to_1()
    yield from turns()
    camera = scene.camera
    corners = [project(region, space.region_3d, camera.matrix_world @ corner) for corner in camera.data.view_frame(scene=scene)]
    left, low = min(c.x for c in corners), min(c.y for c in corners)
    right, high = max(c.x for c in corners), max(c.y for c in corners)
    height = bpy.context.window_manager.windows[0].height
    return [region.x + left, height - (region.y + high), right - left, high - low]


def sidebar(area):
    """Open our tab."""
    with within(area):  # a timer has no window by itself after a file was loaded, and Blender crashes without one
        area.spaces.active.show_region_ui = True
    yield from turns()
    region = next(region for region in area.regions if region.type == 'UI')
    for _ in range(2):  # 4.3 shows it one redraw late
        region.active_panel_category = "FAST-GS"
        region.tag_redraw()
        yield from turns()


def first_steps():
    """What a newcomer does: import the example, look at it, open our tab, Rendered shading, F12."""
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.fastgs.import_example()
    scene, obj = bpy.context.scene, bpy.context.view_layer.objects.active
    camera = look(scene, 640, 420, eye=(0.9, -2.7, 1.6), target=(0.0, 0.1, 1.0), lens=30)
    scene.render.film_transparent = False
    scene.camera.data.display_size = 0.2
    area = area_of()
    view = area.spaces.active.region_3d
    view.view_rotation = Euler((1.36, 0, -0.2)).to_quaternion()
    view.view_location, view.view_distance = (0.45, 0.1, 0.95), 3.0
    yield from sidebar(area)
    scene.frame_set(12)
    yield from settled("solid")
    through = seen_by(area)
    area.spaces.active.shading.type = 'RENDERED'
    area.spaces.active.overlay.show_overlays = False  # their lines would run over the splats
    yield from settled("rendered")
    yield from f12(area)
    yield from settled("f12")
    areas = [a.type for a in bpy.context.window_manager.windows[0].screen.areas]
    bpy.data.images["Render Result"].save_render(os.path.abspath("f12-saved.png"))
    return {"areas": areas, "camera": camera, "count": obj.fastgs.gaussian_count, "frame": 12, "start": obj.fastgs.start_frame, **through}


def seen_by(area, region=None, view=None):
    """What a view shows where: its matrices, and the place of its region in a screenshot.  By default the area's only one."""
    region = region or next(region for region in area.regions if region.type == 'WINDOW')
    view = view or area.spaces.active.region_3d
    matrices = {name: [list(row) for row in matrix] for name, matrix in (("view", view.view_matrix), ("window", view.window_matrix))}
    top = bpy.context.window_manager.windows[0].height - region.y - region.height
    return {**matrices, "region": [region.x, top, region.width, region.height]}


def properties(model):
    """The property editor's tabs that hold panels of ours, each in a screenshot: {tab: [panels' names, x, y, w, h]}."""
    scene = bring(model)
    look(scene, 640, 420)
    yield from turns()
    editor = area_of('PROPERTIES')
    with within(editor):
        bpy.ops.screen.screen_full_area()
    yield from turns()
    editor = area_of('PROPERTIES')
    region = next(region for region in editor.regions if region.type == 'WINDOW')
    bpy.context.view_layer.objects.active = next(o for o in scene.objects if o.type == 'MESH')
    taken = {}
    for context in ('RENDER', 'VIEW_LAYER', 'OBJECT'):
        editor.spaces.active.context = context
        yield from settled(f"properties-{context.lower()}")
        ours = [cls.bl_label for cls in bpy.types.Panel.__subclasses__()
                if cls.__name__.startswith("FASTGS_") and getattr(cls, "bl_context", "") == context.lower()]
        top = bpy.context.window_manager.windows[0].height - region.y - region.height
        taken[context] = [ours, region.x, top, region.width, region.height]
    return taken


def through_camera(model, frame):
    """Rendered shading under our engine, one pixel of the picture on one of the screen: (area, facts for `crops`)."""
    scene = bring(model)
    area = area_of()
    region = next(region for region in area.regions if region.type == 'WINDOW')
    # in the middle of the region, the picture's pixels are the screen's if both sizes are even or odd
    camera = look(scene, 640 + region.width % 2, 420 + region.height % 2)
    scene.render.film_transparent = False
    scene.frame_set(frame)
    area.spaces.active.shading.type = 'RENDERED'
    yield from turns()
    box = yield from frame_in_region(area)
    yield from settled("anchor")
    obj = next(o for o in scene.objects if o.fastgs.filepath)
    return area, {"box": box, "camera": camera, "start": obj.fastgs.start_frame, "frame": frame}


def viewports(model):
    """Rendered and Solid shading through the camera, two frames of each, and F12 of the same."""
    area, facts = yield from through_camera(model, 12)
    scene, space = bpy.context.scene, area.spaces.active
    scene.frame_set(25)
    yield from settled("rendered-25")
    space.shading.type = 'SOLID'
    yield from settled("solid-25")
    # a wall that stands before the left half of the picture
    corners = [scene.camera.matrix_world @ Vector(corner) for corner in ((-2, -2, -1), (0, -2, -1), (0, 2, -1), (-2, 2, -1))]
    mesh = bpy.data.meshes.new("Wall")
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    scene.collection.objects.link(bpy.data.objects.new("Wall", mesh))
    yield from settled("solid-wall")
    scene.frame_set(12)
    yield from f12(area)
    bpy.data.images["Render Result"].save_render(os.path.abspath("rendered-f12.png"))
    return facts


def playing(model):
    """Playback under Rendered shading, a screenshot in the middle of it and one of where it was stopped."""
    area, facts = yield from through_camera(model, 5)
    sent = import_module(f"{ADDON}.engine.viewport.textures").Sent
    drawn = []
    handler = bpy.types.SpaceView3D.draw_handler_add(lambda: drawn.append(bpy.context.scene.frame_current), (), 'WINDOW', 'POST_PIXEL')
    with within(area):
        bpy.ops.screen.animation_play()
    yield from until(lambda: len(set(drawn)) > 3)
    before, number = sent.bytes, len(drawn)
    shot("playing")
    yield from until(lambda: len(set(drawn)) > 12)
    facts["bytes"] = (sent.bytes - before) / (len(drawn) - number)
    with within(area):
        bpy.ops.screen.animation_cancel(restore_frame=False)
    bpy.types.SpaceView3D.draw_handler_remove(handler, 'WINDOW')
    yield from settled("stopped")
    return {**facts, "drawn": drawn, "stopped": bpy.context.scene.frame_current}


def switching(model):
    """The engine, then the extension, go while they draw, and come back."""
    area, facts = yield from through_camera(model, 12)
    scene = bpy.context.scene
    with within(area):
        bpy.ops.screen.animation_play()
    yield from turns(10)
    scene.render.engine = 'BLENDER_WORKBENCH'
    yield from turns(10)
    with within(area):
        bpy.ops.screen.animation_cancel(restore_frame=False)
    scene.frame_set(12)
    yield from settled("other-engine")
    with within(area):
        bpy.ops.screen.animation_play()
    yield from turns(10)
    addon_utils.disable(ADDON)
    yield from turns(10)
    with within(area):
        bpy.ops.screen.animation_cancel(restore_frame=False)
    yield from settled("without-extension")
    for obj in scene.objects:
        obj.hide_viewport = obj.type == 'MESH'
    yield from settled("nothing")
    for obj in scene.objects:
        obj.hide_viewport = False
    addon_utils.enable(ADDON)
    scene.render.engine = 'FASTGS'
    scene.frame_set(12)
    yield from settled("back")
    return facts


def cropping(model):
    """A crop box around one half of the model: through the camera, and as its user sees it."""
    area, facts = yield from through_camera(model, 12)
    obj = next(o for o in bpy.context.scene.objects if o.fastgs.filepath)
    with within(area):
        bpy.ops.fastgs.add_crop_box()
    box = obj.fastgs.crops[0].object
    box.scale.x *= 0.5
    box.location.x += box.scale.x
    yield from settled("cropped")
    facts["crop"] = [list(row) for row in box.matrix_world]
    space = area.spaces.active
    space.overlay.show_overlays = True
    space.shading.type = 'SOLID'
    view = space.region_3d
    view.view_perspective = 'PERSP'
    view.view_rotation = Euler((1.1, 0, -0.35)).to_quaternion()
    view.view_location, view.view_distance = (0.9, 0, 0.5), 8.5
    yield from sidebar(area)
    yield from settled("crop")
    return facts


def filmed(model):
    """Cameras around the model with what they have rendered as their backgrounds: one seen straight from behind, and all of them."""
    from bpy_extras.view3d_utils import location_3d_to_region_2d as project

    scene = bring(model)
    look(scene, 320, 210)
    scene.render.film_transparent = False
    scene.world = scene.world or bpy.data.worlds.new("World")
    scene.frame_set(12)
    first, made = scene.camera, []
    for number in range(5):
        camera = first if number == 0 else first.copy()
        if number:
            camera.data = first.data.copy()
            scene.collection.objects.link(camera)
            camera.matrix_world = Matrix.Rotation(number * 2 * math.pi / 5, 4, 'Z') @ first.matrix_world
        camera.data.display_size = 1.6
        made.append(camera)
    for camera in made:
        scene.camera = camera
        scene.render.filepath = os.path.abspath(f"filmed-{made.index(camera)}.png")
        bpy.ops.render.render(write_still=True)
        background = camera.data.background_images.new()
        background.image = bpy.data.images.load(scene.render.filepath)
        camera.data.show_background_images = True
    scene.fastgs.show_pictures = True
    area = area_of()
    region = next(region for region in area.regions if region.type == 'WINDOW')
    space = area.spaces.active
    space.shading.type = 'SOLID'
    view = space.region_3d
    view.view_perspective = 'ORTHO'
    view.view_rotation = first.matrix_world.to_quaternion()
    view.view_location, view.view_distance = first.matrix_world @ Vector((0, 0, -1)), 3.0
    bpy.ops.object.select_all(action='DESELECT')
    yield from settled("picture")
    frusta = import_module(f"{ADDON}.engine.viewport.frusta")
    corners = [project(region, view, first.matrix_world @ Vector(corner)) for corner in frusta.plane(first.data, scene, 1.0)]
    left, right = min(c.x for c in corners), max(c.x for c in corners)
    low, high = min(c.y for c in corners), max(c.y for c in corners)
    height = bpy.context.window_manager.windows[0].height
    view.view_perspective = 'PERSP'
    view.view_rotation = Euler((1.0, 0, -0.15)).to_quaternion()
    view.view_location, view.view_distance = (0, 0, 1.0), 12.0
    yield from settled("cameras")
    return {"box": [region.x + left, height - (region.y + high), right - left, high - low]}

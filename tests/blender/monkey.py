# SPDX-License-Identifier: GPL-3.0-or-later
"""A monkey at Blender's window: everything that users do, in any order (see inside.py).

The same seed does the same actions in the same order, however fast the machine is: their number is given, not a time, and each draws
from random numbers of its own, so that one that Blender does not allow this time changes none of the later ones.
Each action is printed before it happens, so that the log of a crash ends with its cause.
"""
from __future__ import annotations

import ctypes
import gc
import os
import random
import sys
import time
from importlib import import_module

import bpy
from background import ADDON, look
from mathutils import Euler
from window import press, turns

LAP = 30
"""Actions between two rests in an empty file."""
REST = (0.0, 0.0, 0.05, 0.2)
"""Seconds between two actions."""
OFTEN = {"do_orbit": 4, "do_shading": 4, "do_play": 3, "do_scrub": 3, "do_undo": 2, "do_import": 2}
"""How many times as often as the other actions."""


class Monkey:
    """What it can do: the methods whose names begin with do_.  One that waits in between is a generator."""

    def __init__(self, seed, models, files):
        self.seed, self.models, self.files = seed, models, files
        self.rewind()
        names = [name for name in dir(self) if name.startswith("do_")]
        self.actions = [name for name in names for _ in range(OFTEN.get(name, 1))]
        self.done = dict.fromkeys(names, 0)
        self.begin = time.monotonic()

    def rewind(self):
        """Begin with the first action again."""
        self.order, self.number = random.Random(self.seed), 0

    @property
    def window(self):
        return self.random.choice(list(bpy.context.window_manager.windows))

    def area(self, kind='VIEW_3D'):
        """A random area of a kind in a random window; (None, None) where there is none."""
        found = [(window, area) for window in bpy.context.window_manager.windows for area in window.screen.areas if area.type == kind]
        return self.random.choice(found) if found else (None, None)

    def view(self):
        """The context of a random 3D view; its space."""
        window, area = self.area()
        if area is None:
            window = bpy.context.window_manager.windows[0]
            area = max(window.screen.areas, key=lambda a: a.width * a.height)
            area.type = 'VIEW_3D'
        region = area.regions[-1] if area.spaces.active.region_quadviews else next(r for r in area.regions if r.type == 'WINDOW')
        return bpy.context.temp_override(window=window, area=area, region=region), area.spaces.active

    def step(self, name=None):
        """One action, by itself any; a generator of seconds to wait."""
        name = name or self.order.choice(self.actions)
        self.number += 1
        self.random = random.Random(f"{self.seed}/{self.number}/{name}")
        print(f"monkey: {self.number}, {time.monotonic() - self.begin:.1f} s, {memory()} MiB, {name[3:]}", flush=True)
        self.done[name] += 1
        result = getattr(self, name)()
        if result is not None:
            yield from result
        yield self.random.choice(REST)

    def do_play(self):
        context, _ = self.view()
        with context:
            if bpy.ops.screen.animation_play.poll():  # not while a render is under way
                bpy.ops.screen.animation_play(reverse=self.random.random() < 0.3)

    def do_scrub(self):
        for _ in range(4):
            bpy.context.window_manager.windows[0].scene.frame_set(self.random.randint(-5, 60), subframe=self.random.random())
            yield 0.03

    def do_orbit(self):
        _, space = self.view()
        for _ in range(5):
            turn = Euler([self.random.uniform(-0.3, 0.3) for _ in range(3)]).to_quaternion()
            space.region_3d.view_rotation = turn @ space.region_3d.view_rotation
            space.region_3d.view_distance = self.random.uniform(0.1, 15)
            yield 0.03

    def do_turn_by_key(self):
        _, area = self.area()
        if area is not None:
            yield from press("NUMPAD_" + self.random.choice(['0', '1', '3', '5', '6', '7', 'PERIOD']), area)

    def do_shading(self):
        _, space = self.view()
        space.shading.type = self.random.choice(['WIREFRAME', 'SOLID', 'RENDERED', 'RENDERED'])

    def do_engine(self):
        bpy.context.window_manager.windows[0].scene.render.engine = self.random.choice(['FASTGS', 'FASTGS', 'BLENDER_WORKBENCH'])

    def do_view_options(self):
        _, space = self.view()
        for owner, name in ((space.overlay, "show_overlays"), (space.shading, "show_xray"), (space, "show_gizmo"), (space, "lock_camera")):
            if self.random.random() < 0.4:
                setattr(owner, name, not getattr(owner, name))

    def do_quad_view(self):
        context, _ = self.view()
        with context:
            if bpy.ops.screen.region_quadview.poll():
                bpy.ops.screen.region_quadview()

    def do_local_view(self):
        context, _ = self.view()
        with context:
            if bpy.context.selected_objects and bpy.ops.view3d.localview.poll():
                bpy.ops.view3d.localview()

    def do_import(self):
        if len(bpy.data.objects) > 6:
            return
        context, _ = self.view()
        with context:
            bpy.ops.import_scene.fastgs(filepath=os.path.abspath(self.random.choice(self.models)), use_engine=self.random.random() < 0.5)
            bpy.ops.ed.undo_push(message="import")

    def splats(self):
        return [obj for obj in bpy.data.objects if obj.fastgs.filepath]

    def do_select(self):
        for obj in bpy.context.window_manager.windows[0].view_layer.objects:
            obj.select_set(self.random.random() < 0.5)

    def do_move(self):
        for obj in self.splats():
            obj.location = [self.random.uniform(-1, 1) for _ in range(3)]
            obj.scale = [self.random.uniform(0.3, 1.5)] * 3

    def do_hide(self):
        for obj in self.splats():
            obj.hide_viewport = self.random.random() < 0.3

    def do_retime(self):
        for obj in self.splats():
            obj.fastgs.speed = self.random.choice([-2, 0.5, 1, 3])
            obj.fastgs.after = self.random.choice(['HIDE', 'HOLD', 'LOOP', 'PING_PONG'])

    def do_crop(self):
        context, _ = self.view()
        with context:
            layer = bpy.context.view_layer
            found = [obj for obj in self.splats() if obj.name in layer.objects]
            if not found:
                return
            layer.objects.active = obj = self.random.choice(found)
            if obj.fastgs.crops and self.random.random() < 0.5:
                bpy.ops.fastgs.remove_crop_box(index=0)
            elif len(obj.fastgs.crops) < 2 and bpy.ops.fastgs.add_crop_box.poll():
                bpy.ops.fastgs.add_crop_box()
                obj.fastgs.crops[-1].object.scale *= self.random.uniform(0.3, 1)
            bpy.ops.ed.undo_push(message="crop")

    def do_duplicate(self):
        context, _ = self.view()
        with context:
            if len(bpy.data.objects) < 6 and bpy.ops.object.duplicate.poll() and bpy.context.selected_objects:
                bpy.ops.object.duplicate(linked=self.random.random() < 0.5)
                bpy.ops.ed.undo_push(message="duplicate")

    def do_delete_by_key(self):
        _, area = self.area()
        if area is not None:
            yield from press('DEL', area)

    def do_remove(self):
        if self.splats():
            bpy.data.objects.remove(self.random.choice(self.splats()))

    def do_undo(self):
        context, _ = self.view()
        with context:
            for _ in range(self.random.randint(1, 3)):
                if bpy.ops.ed.undo.poll():
                    bpy.ops.ed.undo()

    def do_redo(self):
        context, _ = self.view()
        with context:
            if bpy.ops.ed.redo.poll():
                bpy.ops.ed.redo()

    def do_load(self):
        context, _ = self.view()
        with context:
            bpy.ops.wm.open_mainfile(filepath=os.path.abspath(self.random.choice(self.files)), load_ui=self.random.random() < 0.5)
        yield from turns()

    def do_begin_anew(self):
        context, _ = self.view()
        with context:
            bpy.ops.wm.read_homefile()
        # Eevee alone takes half a GiB and a quarter of a minute of software OpenGL
        bpy.context.window_manager.windows[0].scene.render.engine = 'BLENDER_WORKBENCH'
        yield from turns()

    def do_split(self):
        window, area = self.area()
        if area is not None and len(window.screen.areas) < 8 and min(area.width, area.height) > 200:
            with bpy.context.temp_override(window=window, area=area, region=area.regions[-1]):
                bpy.ops.screen.area_split(direction=self.random.choice(['HORIZONTAL', 'VERTICAL']), factor=0.5)

    def do_close_area(self):
        window = self.window
        if len(window.screen.areas) > 2:
            area = self.random.choice(list(window.screen.areas))
            with bpy.context.temp_override(window=window, area=area):
                if bpy.ops.screen.area_close.poll():
                    bpy.ops.screen.area_close()

    def do_change_area(self):
        window = self.window
        area = self.random.choice(list(window.screen.areas))
        area.type = self.random.choice(['VIEW_3D', 'VIEW_3D', 'PROPERTIES', 'OUTLINER', 'DOPESHEET_EDITOR', 'IMAGE_EDITOR'])

    def do_sidebar(self):
        context, space = self.view()
        with context:
            space.show_region_ui = not space.show_region_ui

    def do_open_window(self):
        if len(bpy.context.window_manager.windows) < 3:
            context, _ = self.view()
            with context:
                bpy.ops.screen.area_dupli('INVOKE_DEFAULT')
            yield from turns()

    def do_close_window(self):
        windows = list(bpy.context.window_manager.windows)
        if len(windows) > 1:
            with bpy.context.temp_override(window=self.random.choice(windows[1:])):
                bpy.ops.wm.window_close()
            yield from turns()

    def do_render_with_meshes(self):
        bpy.context.window_manager.windows[0].scene.fastgs.render_meshes = self.random.choice(('OFF', 'CYCLES', 'EEVEE'))
        for scene in bpy.data.scenes:
            scene.cycles.samples = scene.eevee.taa_render_samples = 1

    def do_render(self):
        scene = bpy.context.window_manager.windows[0].scene
        if scene.camera is None or scene.render.engine != 'FASTGS':
            return
        scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 160, 120, 100
        bpy.context.preferences.view.render_display_type = 'NONE'
        context, _ = self.view()
        with context:
            bpy.ops.render.render('INVOKE_DEFAULT')
        yield self.random.choice([0.0, 0.3, 1.0])


def memory() -> int:
    """MiB that the process holds; software OpenGL's textures are among them."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") >> 20


def held() -> dict[str, int]:
    """Entries of the containers in the extension's modules that remember what they have seen."""
    found = {}
    for name, module in list(sys.modules.items()):
        if name.startswith(ADDON):
            for key, value in [*vars(module).items(), *vars(getattr(module, "viewports", object)).items()]:
                if isinstance(value, (dict, list, set)) and (key == "views" or key[:1] == "_" != key[1:2]):
                    found[f"{name.removeprefix(ADDON)}.{key}"] = len(value)
    return found


def rest():
    """Back to an empty file with one view, as after each lap: what is held then is held for nothing."""
    while len(bpy.context.window_manager.windows) > 1:
        with bpy.context.temp_override(window=bpy.context.window_manager.windows[-1]):
            bpy.ops.wm.window_close()
        yield from turns()
    while bpy.app.is_job_running('RENDER'):
        yield 0.2
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)
    yield from turns(10)
    gc.collect()
    ctypes.CDLL("libc.so.6").malloc_trim(0)  # what is free in the heap is not held


def level(laps, slack=3):
    """Whether memory, in MiB after each lap, has not risen in the last two."""
    return len(laps) > 3 and max(laps[-2:]) <= max(laps[:-2]) + slack


def run(actions, seed, models, files, laps):
    """First so many actions in any order; then everything in one order, lap after lap, until the memory held after a lap is level.

    What Blender and the software OpenGL allocate once is there after a few laps of the second kind; what is forgotten to be freed
    grows with every one, however many.  `laps` is the most.
    """
    viewports = import_module(f"{ADDON}.engine.viewport.spaces").viewports
    for path, model in zip(files, models):
        bpy.ops.wm.read_homefile()
        bpy.ops.import_scene.fastgs(filepath=os.path.abspath(model), use_engine=True)
        look(bpy.context.scene, 160, 120)
        bpy.ops.wm.save_as_mainfile(filepath=os.path.abspath(path))
        yield from turns()
    monkey = Monkey(seed, models, files)
    gpu, grown = [], []

    def lap(steps):
        yield from monkey.step("do_load")
        for name in steps:
            yield from monkey.step(name)
        yield from rest()
        gpu.append(viewports.memory())
        print("monkey: lap,", memory(), "MiB,", gpu[-1], "bytes in viewports", held(), flush=True)

    for done in range(0, actions, LAP):
        yield from lap([None] * min(LAP, actions - done))
    while len(grown) < laps and not level(grown):
        monkey.rewind()
        yield from lap(monkey.order.sample(list(monkey.done), len(monkey.done)))
        grown.append(memory())
    return {"done": monkey.done, "memory": grown, "level": level(grown), "gpu": gpu, "held": held(), "steps": sum(monkey.done.values())}

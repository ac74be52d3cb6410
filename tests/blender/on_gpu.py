# SPDX-License-Identifier: GPL-3.0-or-later
"""A story without a window (see inside.py): from a scene to a rendered model on a GPU, with nothing but the zip."""
from __future__ import annotations

import importlib.util
import os
import sys
from importlib import import_module

import bpy
from background import ADDON, look


def part(name):
    """A module of the extension."""
    return import_module(f"{ADDON}.{name}")


def matter(name, colour):
    """A material of one colour."""
    material = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (*colour, 1)
    return material


def build():
    """In an empty file: a head that turns and rises over a plate, for six frames; saved beside the tests."""
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, 6
    scene.render.engine = 'CYCLES'
    scene.cycles.use_denoising = False  # not every build can
    scene.view_settings.view_transform = 'Standard'
    bpy.ops.mesh.primitive_cylinder_add(radius=1.5, depth=0.2, location=(0, 0, -0.1), vertices=48)
    bpy.context.object.data.materials.append(matter("Plate", (0.1, 0.3, 0.5)))
    bpy.ops.mesh.primitive_monkey_add(size=1.6)
    head = bpy.context.object
    head.data.materials.append(matter("Head", (0.9, 0.4, 0.1)))
    bpy.ops.object.shade_smooth()
    for frame, turn, height in ((1, -0.5, 0.9), (6, 0.4, 1.2)):
        head.rotation_euler.z, head.location.z = turn, height
        head.keyframe_insert("rotation_euler", frame=frame)
        head.keyframe_insert("location", frame=frame)
    bpy.ops.object.light_add(type='SUN', rotation=(0.6, 0.2, 0.3))
    bpy.context.object.data.energy = 2.5
    scene.world = bpy.data.worlds.new("World")
    scene.world.color = (0.05, 0.05, 0.05)
    look(scene, 320, 240, eye=(2.4, -3.4, 2.4), target=(0, 0, 0.6), lens=40)
    scene.render.film_transparent = False
    scene.camera.data.display_size = 0.3
    bpy.ops.wm.save_as_mainfile(filepath=os.path.abspath("toy.blend"))
    return scene


def from_scene_to_shot(gpu, steps):
    """Capture This Scene, Train (draft) and F12 on the GPU whose name holds a text; F12 of the scene itself, too."""
    bpy.ops.wm.read_homefile(use_empty=True)
    scene = build()
    bpy.context.preferences.addons[ADDON].preferences.gpu = gpu
    scene.fastgs.device = 'GPU'
    capture, run = os.path.abspath("gpu-capture"), os.path.abspath("gpu-run")
    filmed = bpy.ops.fastgs.capture_scene(out=capture, count=8, samples=4, width=160, height=120, frame_step=2)
    trained = bpy.ops.fastgs.train(source='FOLDER', capture=capture, out=run, preset='DRAFT', iterations=steps, max_gaussians=2000)
    job, state = part("scene.training.watch").refresh()[-1]
    bpy.ops.fastgs.train_forget(job=job.id)  # other stories share the list of runs, and take what they find there for their own
    originals = [obj for obj in scene.objects if "fastgs_job" not in obj]
    model = next(obj for obj in scene.objects if "fastgs_job" in obj)
    scene.frame_set(3)
    scene.cycles.samples = 16
    camera = look(scene, 160, 120, eye=(-1.6, -3.8, 1.9), target=(0, 0, 0.6), lens=40)
    for engine, name, hidden in (('CYCLES', "truth", [model]), ('FASTGS', "model", originals)):
        for obj in scene.objects:
            obj.hide_render = obj in hidden and obj.type != 'CAMERA'
        scene.render.engine, scene.render.film_transparent = engine, engine == 'FASTGS'
        scene.render.filepath = os.path.abspath(f"gpu-{name}.png")
        bpy.ops.render.render(write_still=True)
    backends = part("fastgs_blender.util.backends")
    used = [name for name, backend in backends.loaded.items() if name.startswith("gpu:") and "models" in vars(backend)]
    failed = [backends.failure_of(name) for name in used]
    return {"filmed": list(filmed), "trained": list(trained), "kind": state.kind, "text": state.text,
            "steps": state.values.get("iterations"), "python": [job.python, sys.executable], "used": used, "failed": failed,
            "camera": camera, "matrix": [list(row) for row in model.matrix_world], "torch": importlib.util.find_spec("torch") is not None}

# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of a baked character beside Blender's own Workbench render of the mesh: docs/robot.png.

    python tools/contact_sheet.py ../shared/data/robot/RobotExpressive.blend --action Robot_Dance --out docs/robot.png
"""
from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from blender_setup import enable_addon, set_image_output

BACKGROUND = (236, 239, 243)


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("blend", type=Path)
    arguments.add_argument("--rig", default="RobotArmature")
    arguments.add_argument("--action", default="Robot_Dance")
    arguments.add_argument("--frames", default="0,16,32.5,48,64,80", help="which frames; halves are allowed")
    arguments.add_argument("--count", type=int, default=200_000)
    arguments.add_argument("--size", default="300x340", help="of one picture")
    arguments.add_argument("--out", type=Path, default=Path("docs/robot.png"))
    options = arguments.parse_args()
    frames = [float(x) for x in options.frames.split(",")]
    size = tuple(int(x) for x in options.size.split("x"))

    enable_addon()
    import bpy

    with tempfile.TemporaryDirectory() as folder:
        scene, meshes = open_character(bpy, options.blend, options.rig, options.action)
        set_up(bpy, scene, meshes, size)
        bpy.ops.fastgs.bake(filepath=str(Path(folder, "baked.safetensors")), count=options.count)
        rows = [[render(bpy, scene, engine, frame, folder) for frame in frames] for engine in ('BLENDER_WORKBENCH', 'FASTGS')]
    save(rows, frames, options.out)
    print(f"{options.out}: above Workbench, below {options.count:,} Gaussians; "
          f"mean difference {difference(rows):.2f} of 255 where either shows something")


def open_character(bpy, path, rig, action):
    """The file's scene, the rig doing the action, its meshes selected."""
    bpy.ops.wm.open_mainfile(filepath=str(path))
    scene = bpy.context.scene
    action = bpy.data.actions[action]
    bpy.data.objects[rig].animation_data.action = action
    scene.frame_start, scene.frame_end = (int(x) for x in action.frame_range)
    meshes = [obj for obj in scene.objects if obj.type == 'MESH']
    for obj in scene.objects:
        obj.select_set(obj in meshes)
    return scene, meshes


def set_up(bpy, scene, meshes, size):
    """A camera that sees the character on all frames, flat colours, a transparent film."""
    from mathutils import Vector

    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for frame in range(scene.frame_start, scene.frame_end + 1, 4):
        scene.frame_set(frame)
        corners = np.array([obj.matrix_world @ Vector(c) for obj in meshes for c in obj.bound_box])
        low, high = np.minimum(low, corners.min(0)), np.maximum(high, corners.max(0))
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    camera.data.lens, camera.data.sensor_height = 60, 24
    camera.data.sensor_fit = 'VERTICAL'
    middle, extent = Vector((low + high) / 2), [float(x) for x in high - low]
    towards = Vector((0.45, -1.0, 0.22)).normalized()
    distance = 0.9 * max(extent[2], extent[0] * size[1] / size[0]) * camera.data.lens / 24
    camera.location = middle + distance * towards
    camera.rotation_euler = (-towards).to_track_quat('-Z', 'Y').to_euler()
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = *size, 100
    render.film_transparent = True
    render.dither_intensity = 0
    set_image_output(render.image_settings)
    render.image_settings.color_mode = 'RGBA'
    scene.view_settings.view_transform = 'Standard'
    scene.display.shading.light = 'FLAT'
    scene.display.shading.color_type = 'MATERIAL'
    scene.display.shading.show_object_outline = False
    scene.display.render_aa = '16'


def render(bpy, scene, engine, frame, folder) -> np.ndarray:
    """One picture [h, w, 3] over the background.  Workbench sees the meshes without the proxy of the baked model."""
    from PIL import Image

    scene.render.engine = engine
    for obj in scene.objects:
        obj.hide_render = bool(obj.fastgs.filepath) == (engine == 'BLENDER_WORKBENCH') and obj.type == 'MESH'
    scene.frame_set(int(frame // 1), subframe=frame % 1)
    scene.render.filepath = str(Path(folder, "picture.png"))
    bpy.ops.render.render(write_still=True)
    rgba = np.asarray(Image.open(scene.render.filepath).convert("RGBA"), float)
    alpha = rgba[..., 3:] / 255
    return rgba[..., :3] * alpha + np.array(BACKGROUND) * (1 - alpha)


def difference(rows) -> float:
    """Mean absolute difference of the two rows over the pixels that are not background in both."""
    above, below = (np.stack(row) for row in rows)
    shown = (abs(above - BACKGROUND).max(-1) > 2) | (abs(below - BACKGROUND).max(-1) > 2)
    return float(abs(above - below)[shown].mean())


def save(rows, frames, path):
    from PIL import Image
    from sheet import grid

    labelled = [(f"{name if x == 0 else ''}  frame {frame:g}".strip(), np.round(picture).astype(np.uint8))
                for name, row in zip(("Workbench, the mesh", "FAST-GS, the baked Gaussians"), rows, strict=True)
                for x, (frame, picture) in enumerate(zip(frames, row, strict=True))]
    path.parent.mkdir(parents=True, exist_ok=True)
    grid(labelled, len(frames)).quantize(255, dither=Image.Dither.NONE).save(path, optimize=True)


if __name__ == "__main__":
    main()

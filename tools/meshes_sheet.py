# SPDX-License-Identifier: GPL-3.0-or-later
"""A ball that rolls around the example's dancer, under a sun, an area lamp, the world and the captured fire: docs/meshes.webp.

    python tools/meshes_sheet.py [--out docs/meshes.webp]      (needs bpy)

Eight frames, as F12 renders them after *Render With Meshes: Cycles* was chosen once, with a shutter of 1.5 frames and depth of field.
"""
from __future__ import annotations

import argparse
import os
import sys
import tempfile
from math import pi
from pathlib import Path

import numpy as np
from sheet import grid

ROOT = Path(__file__).resolve().parents[1]
SIZE = 400, 250
FRAMES = range(1, 41, 5)
CLIP = 40
EYE, TARGET = np.array([0.75, -3.0, 1.5]), np.array([0.1, 0.0, 0.78])
AROUND, RADIUS = 0.88, 0.3
"""Radii of the ball's way around the dancer, and of the ball."""
START = -0.3 * pi
"""Where on its way the ball begins; -pi / 2 is before her."""
PAPER = np.array([236, 239, 243]) / 255
USER = tempfile.TemporaryDirectory(prefix="fastgs-blender-")
os.environ["BLENDER_USER_RESOURCES"] = USER.name  # before bpy is imported
os.environ.setdefault("FASTGS_CACHE_DIR", str(ROOT / "build" / "cache"))  # which tests share: nothing is compiled twice

import bpy  # noqa: E402, I001 (it brings the other two)
import addon_utils  # noqa: E402
from mathutils import Quaternion, Vector  # noqa: E402

sys.path.append(str(ROOT / "tests" / "addon"))
import image_files  # noqa: E402

ADDON = "bl_ext.user_default.fastgs_blender"


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--out", type=Path, default=ROOT / "docs" / "meshes.webp")
    arguments.add_argument("--samples", type=int, default=48)
    arguments.add_argument("--frames", type=int, nargs="*", default=FRAMES)
    options = arguments.parse_args()
    enable()
    scene = build()
    scene.fastgs.render_meshes = 'CYCLES'
    bpy.data.scenes[f"{scene.name} Meshes"].cycles.samples = options.samples
    pictures = {}
    for frame in options.frames:
        scene.frame_set(frame)
        pictures[f"frame {frame}"] = render(scene)
    grid(pictures.items(), 4).save(options.out, quality=85, method=6)
    print(options.out)


def enable():
    """Enable the extension of this repository."""
    folder = Path(USER.name) / "extensions" / "user_default"
    folder.mkdir(parents=True)
    (folder / "fastgs_blender").symlink_to(ROOT, target_is_directory=True)
    assert addon_utils.enable(ADDON, default_set=True) is not None


def build():
    """The example with a ball, a ground for it, lamps, a shutter and a lens."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.render.engine = 'FASTGS'
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.dither_intensity = 0
    scene.world = bpy.data.worlds.new("World")
    background = scene.world.node_tree.nodes["Background"].inputs
    background["Color"].default_value, background["Strength"].default_value = (0.25, 0.33, 0.5, 1), 0.35
    bpy.ops.import_scene.fastgs(filepath=str(ROOT / "examples" / "fireside.safetensors"))
    capture = bpy.context.object
    capture.fastgs.captured_light, capture.fastgs.lamp_light, capture.fastgs.shadows = 0.35, 0.9, 0.9
    scene.view_settings.view_transform = 'Standard'
    ball()
    bpy.ops.fastgs.add_light_probe()  # around the ball, which is active
    ground()
    lamp("Sun", 'SUN', (-2.4, -4.0, 2.6), (0, 0, 0), energy=2.4, angle=0.03, color=(1.0, 0.93, 0.82))
    lamp("Footlight", 'AREA', (1.25, -1.65, 0.12), (0, 0, 0.7), energy=12, size=0.25, color=(0.9, 0.95, 1.0))
    film(scene)
    return scene


def ball():
    """A beach ball that rolls once around the dancer while the clip plays."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=96, ring_count=48, radius=RADIUS)
    bpy.ops.object.shade_smooth()
    made = bpy.context.object
    for colour in ((0.4, 0.37, 0.31), (0.04, 0.18, 0.2)):
        paint(colour, 0.2)
    for face in made.data.polygons:
        face.material_index = int(8 * (np.arctan2(face.center.y, face.center.x) / (2 * pi) % 1)) % 2
    made.rotation_mode, turned = 'QUATERNION', Quaternion((1, 0, 0), 0.6)
    for frame in range(-1, CLIP + 3):
        turn = START + 2 * pi * (frame - 1) / CLIP
        made.location = AROUND * np.cos(turn), AROUND * np.sin(turn), RADIUS
        made.rotation_quaternion = turned
        for path in ("location", "rotation_quaternion"):
            made.keyframe_insert(path, frame=frame)
        turned = Quaternion((-np.cos(turn), -np.sin(turn), 0), 2 * pi / CLIP * AROUND / RADIUS) @ turned


def ground():
    """A plane on which the ball rolls: nobody sees it, but it throws the rug's colour back at the ball."""
    bpy.ops.mesh.primitive_plane_add(size=3)
    paint((0.02, 0.04, 0.11), 0.8)
    plane = bpy.context.object
    plane.name, plane.visible_camera, plane.visible_shadow = "Ground", False, False


def lamp(name, kind, place, target, **settings):
    """A lamp that shines from a place at a target, and whose light splats keep from meshes."""
    made = bpy.data.objects.new(name, bpy.data.lights.new(name, kind))
    made.location, made.rotation_euler = place, (Vector(target) - Vector(place)).to_track_quat('-Z', 'Y').to_euler()
    for setting, value in settings.items():
        setattr(made.data, setting, value)
    made.fastgs.splat_shadow = True
    bpy.context.scene.collection.objects.link(made)


def film(scene):
    """The camera with its lens, focused on the dancer, and the shutter."""
    camera = scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.data.lens = EYE, 27
    camera.rotation_euler = Vector(TARGET - EYE).to_track_quat('-Z', 'Y').to_euler()
    camera.data.dof.use_dof, camera.data.dof.focus_distance, camera.data.dof.aperture_fstop = True, float(np.hypot(*EYE[:2])), 0.8
    scene.collection.objects.link(camera)
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.5
    scene.fastgs.shadow_bias, scene.fastgs.shadow_samples = 0.03, 12
    scene.fastgs.blur_steps, scene.fastgs.lens_samples = 8, 16


def paint(colour, roughness):
    material = bpy.data.materials.new("Paint")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*colour, 1)
    shader.inputs["Roughness"].default_value = roughness
    bpy.context.object.data.materials.append(material)


def file(scene, kind) -> Path:
    """The scene's picture, written by Blender."""
    path = Path(USER.name) / f"picture.{kind[:3].lower()}"
    image_files.set_output(scene, kind)
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True, scene=scene.name)
    return path


def render(scene) -> np.ndarray:
    """[h, w, 3] as a viewer shows it, over paper."""
    pixels = image_files.read_png(file(scene, "PNG")) / 255
    alpha = pixels[..., 3:] if pixels.shape[2] > 3 else 1.0
    return pixels[..., :3] * alpha + PAPER * (1 - alpha)


if __name__ == "__main__":
    main()

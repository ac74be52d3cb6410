# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes inside the example's splats: what they hide, the shadows they catch, and the composite with Cycles: docs/meshes.webp.

    python tools/meshes_sheet.py [--out docs/meshes.webp]      (needs bpy)
"""
from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

import numpy as np
from sheet import grid

ROOT = Path(__file__).resolve().parents[1]
SIZE = 400, 250
FRAME = 6
EYE, TARGET = np.array([0.9, -2.75, 1.6]), np.array([0.15, 0.0, 0.85])
PAPER = np.array([236, 239, 243]) / 255
USER = tempfile.TemporaryDirectory(prefix="fastgs-blender-")
os.environ["BLENDER_USER_RESOURCES"] = USER.name  # before bpy is imported

import bpy  # noqa: E402, I001 (it brings the other two)
import addon_utils  # noqa: E402
from mathutils import Vector  # noqa: E402

sys.path.append(str(ROOT / "tests" / "addon"))
import image_files  # noqa: E402

ADDON = "bl_ext.user_default.fastgs_blender"


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--out", type=Path, default=ROOT / "docs" / "meshes.webp")
    options = arguments.parse_args()
    enable()
    scene = build()
    pictures = {"splats": render(scene)}
    scene.fastgs.render_meshes = 'CYCLES'
    meshes = bpy.data.scenes[f"{scene.name} Meshes"]
    meshes.cycles.samples, meshes.cycles.use_denoising = 48, False
    shadow = image_files.read_exr(file(scene, "EXR"))["ViewLayer.Splat Shadow"][..., 0]
    scene.render.use_compositing, scene.fastgs.use_meshes = False, True
    pictures["splats that the meshes hide"] = render(scene)
    pictures["meshes, by Cycles"] = render(meshes)
    pictures["pass Splat Shadow"] = np.repeat(shadow[..., None], 3, -1)
    scene.render.use_compositing = True
    tree = scene.compositing_node_group if bpy.app.version >= (5, 0, 0) else scene.node_tree
    strength = tree.nodes["FAST-GS Shade"].inputs["Shadow Strength"]
    for name, strength.default_value in (("joined, without shadows", 0.0), ("joined", 0.8)):
        pictures[name] = render(scene)
    grid(pictures.items(), 3).save(options.out, quality=85, method=6)
    print(options.out)


def enable():
    """Enable the extension of this repository."""
    folder = Path(USER.name) / "extensions" / "user_default"
    folder.mkdir(parents=True)
    (folder / "fastgs_blender").symlink_to(ROOT, target_is_directory=True)
    assert addon_utils.enable(ADDON, default_set=True) is not None


def build():
    """The example with a ring around its dancer, a monkey on a platform beside her, and a spot light."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.render.engine = 'FASTGS'
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.dither_intensity = 0
    scene.render.film_transparent = True
    scene.world = bpy.data.worlds.new("World")
    bpy.ops.import_scene.fastgs(filepath=str(ROOT / "examples" / "fireside.safetensors"))
    scene.view_settings.view_transform = 'Standard'
    camera = scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.data.lens = EYE, 0.8 * 36
    camera.rotation_euler = Vector(TARGET - EYE).to_track_quat('-Z', 'Y').to_euler()
    spot = bpy.data.objects.new("Spot", bpy.data.lights.new("Spot", 'SPOT'))
    spot.location, spot.data.energy, spot.data.spot_size, spot.data.shadow_soft_size = (-1.3, -1.6, 2.5), 260, 1.4, 0.08
    spot.rotation_euler = (Vector((0.5, -0.3, 0.5)) - spot.location).to_track_quat('-Z', 'Y').to_euler()
    for obj in (camera, spot):
        scene.collection.objects.link(obj)
    bpy.ops.mesh.primitive_cylinder_add(vertices=96, radius=0.55, depth=0.1, location=(0.95, 0.35, 0.05))
    paint((0.75, 0.75, 0.72), 0.6)
    bpy.ops.mesh.primitive_torus_add(major_radius=0.62, minor_radius=0.035, major_segments=128, minor_segments=32,
                                     location=(0.02, 0.0, 1.18), rotation=(0.3, 0.15, 0.0))
    paint((0.95, 0.75, 0.3), 0.3)
    bpy.ops.mesh.primitive_monkey_add(size=0.55, location=(0.95, 0.35, 0.36), rotation=(-0.35, 0, 0.1))
    bpy.context.object.modifiers.new("Smooth", 'SUBSURF').render_levels = 2
    bpy.ops.object.shade_smooth()
    paint((0.12, 0.3, 0.75), 0.35)
    spot.fastgs.splat_shadow, scene.fastgs.shadow_bias = True, 0.06
    scene.frame_set(FRAME)
    return scene


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

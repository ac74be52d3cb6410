# SPDX-License-Identifier: GPL-3.0-or-later
"""A chrome ball and a white one beside the example's dancer, without a light probe and with it: docs/light-probe.webp.

    python tools/light_probe_sheet.py [--out docs/light-probe.webp]      (needs bpy)
"""
from __future__ import annotations

import argparse
from pathlib import Path

from meshes_sheet import ROOT, Vector, bpy, enable, paint, render
from sheet import grid

SIZE = 400, 250
EYE, TARGET = Vector((-1.7, -1.6, 0.9)), Vector((-0.05, -0.6, 0.45))
CHROME, WHITE = (-0.45, -0.95, 0.3), (-0.25, -1.47, 0.16)
"""Where the balls stand; the heights are their radii."""


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--out", type=Path, default=ROOT / "docs" / "light-probe.webp")
    arguments.add_argument("--samples", type=int, default=64)
    options = arguments.parse_args()
    enable()
    scene = build(options.samples)
    scene.frame_set(3)
    pictures = {"frame 3, without a light probe": render(scene)}
    bpy.ops.fastgs.add_light_probe()  # around the chrome ball, which is active
    for frame in (3, 9, 15):
        scene.frame_set(frame)
        pictures[f"frame {frame}"] = render(scene)
    grid(pictures.items(), 2).save(options.out, quality=85, method=6)
    print(options.out)


def build(samples: int):
    """The example with two balls under a dim world."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.render.engine = 'FASTGS'
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.dither_intensity = 0
    scene.world = bpy.data.worlds.new("World")
    bpy.ops.import_scene.fastgs(filepath=str(ROOT / "examples" / "fireside.safetensors"))
    scene.view_settings.view_transform = 'Standard'
    camera = scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.data.lens, camera.rotation_euler = EYE, 28, (TARGET - EYE).to_track_quat('-Z', 'Y').to_euler()
    scene.collection.objects.link(camera)
    for place, roughness, metallic in ((WHITE, 0.6, 0.0), (CHROME, 0.02, 1.0)):
        bpy.ops.mesh.primitive_uv_sphere_add(segments=96, ring_count=48, radius=place[2], location=place)
        bpy.ops.object.shade_smooth()
        paint((0.9, 0.9, 0.9), roughness)
        bpy.context.object.active_material.node_tree.nodes["Principled BSDF"].inputs["Metallic"].default_value = metallic
    scene.fastgs.render_meshes = 'CYCLES'
    meshes = bpy.data.scenes[f"{scene.name} Meshes"]
    meshes.cycles.samples, meshes.cycles.use_denoising = samples, False
    return scene


if __name__ == "__main__":
    main()

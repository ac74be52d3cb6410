# SPDX-License-Identifier: GPL-3.0-or-later
"""What features of Blender's scene cost: python benchmarks/shots.py [--gaussians 60000] [--size 960x540] [--frames 5]

Processor time of a frame change and its F12 with a feature, divided by the same without it in the same scene; medians of frames.  All
Gaussians move.  The composite has a sheet of 7200 triangles before a half of the picture: first what its splats cost (hidden by the
sheet, with the passes that join them), then all of it, Cycles' picture of 4 samples and the compositor too.

Needs a Python with Blender's bpy.
"""
from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

import numpy as np
from points import capture
from viewport import load_extension, module


def lattice(scene, obj):
    """Pose all Gaussians by a lattice that turns and stretches them."""
    import bpy

    cage = bpy.data.objects.new("Cage", bpy.data.lattices.new("Cage"))
    scene.collection.objects.link(cage)
    cage.scale = 8, 8, 8
    for point in cage.data.points:
        point.co_deform.x += 0.2 * point.co.z
    obj.fastgs.points = 'ALL'
    obj.modifiers.new("Cage", 'LATTICE').object = cage


def native_copy(scene, obj):
    """A mesh of discs beside the object, renewed on every frame."""
    import bpy

    bpy.ops.fastgs.native_copy(kind='DISCS')


def capture_frame(scene, obj):
    """Key the capture's frame: the clip in slow motion, backwards."""
    obj.fastgs.use_capture_frame = True
    for frame, shown in ((1, 200.5), (200, 100.5)):
        obj.fastgs.capture_frame = shown
        obj.fastgs.keyframe_insert("capture_frame", frame=frame)


def fading_loop(scene, obj):
    """A loop whose end and beginning are shown together on all frames that are measured."""
    obj.fastgs.after, obj.fastgs.fade, obj.fastgs.start_frame = 'LOOP', 100.0, -150.0


def stereo(scene, obj):
    """A left and a right picture."""
    scene.render.use_multiview = True


def composite(scene, obj):
    """Set up the composite with a wavy sheet, and render its splats alone."""
    import bpy
    from features import sheet

    mesh = bpy.data.meshes.new("Sheet")
    corners = sheet().reshape(-1, 3)[:, [0, 2, 1]] * (0.42, 1, 0.42) - (0, 7, 0)  # in Blender's axes
    mesh.from_pydata(corners, [], np.arange(len(corners)).reshape(-1, 3))
    scene.collection.objects.link(bpy.data.objects.new("Sheet", mesh))
    scene.fastgs.render_meshes, scene.fastgs.use_meshes = 'CYCLES', True
    scene.render.use_compositing = False


def whole_composite(scene, obj):
    """The same with what Cycles and the compositor do."""
    import bpy

    composite(scene, obj)
    scene.render.use_compositing = True
    other = next(each for each in bpy.data.scenes if each != scene)
    other.cycles.samples, other.cycles.use_denoising = 4, False


FEATURES = {
    "native copy, as discs": native_copy, "all points posed by a lattice": lattice, "capture frame keyed backwards": capture_frame,
    "cross-fade of a loop": fading_loop, "stereo, two views": stereo, "the composite's splats": composite,
    "the composite, with Cycles": whole_composite,
}


def prepared(path: str, size: tuple[int, int]):
    """A new scene with the model before its camera: (scene, the model's object)."""
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.import_scene.fastgs(filepath=path, use_engine=True)
    scene, obj = bpy.context.scene, bpy.context.object
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.camera.location, scene.camera.rotation_euler = (0, -5, 0), (1.5708, 0, 0)
    scene.collection.objects.link(scene.camera)
    scene.fastgs.device = 'CPU'
    scene.render.resolution_x, scene.render.resolution_y = size
    bpy.context.view_layer.objects.active = obj
    return scene, obj


def spent(scene, frames: int) -> float:
    """Processor time of a frame change and its F12, in seconds; the first one, which loads what later ones keep, does not count."""
    import bpy

    times = []
    for number in range(frames + 1):
        begin = time.process_time()
        scene.frame_set(40 + 3 * number)
        bpy.ops.render.render()
        times.append(time.process_time() - begin)
    return statistics.median(times[1:])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gaussians", type=int, default=60_000)
    parser.add_argument("--size", default="960x540")
    parser.add_argument("--frames", type=int, default=5)
    args = parser.parse_args()
    user = load_extension()
    fg = module("fastgs_blender")
    path = Path(user) / "model.safetensors"
    fg.save(capture(fg, args.gaussians), path)
    print(f"{args.gaussians:,} Gaussians, {args.size}: a frame change and F12 in plain ones")
    for name, set_up in FEATURES.items():
        scene, obj = prepared(str(path), tuple(int(side) for side in args.size.split("x")))
        plain = spent(scene, args.frames)
        set_up(scene, obj)
        print(f"{name:34} {spent(scene, args.frames) / plain:6.2f}", flush=True)


if __name__ == "__main__":
    main()

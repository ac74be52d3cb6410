# SPDX-License-Identifier: GPL-3.0-or-later
"""How near baked Gaussians stay to the surface of a real character, on its frames and between them.

    python benchmarks/bake.py ../shared/data/robot/RobotExpressive.blend Robot_Dance Robot_Running [--count 200000]

Default settings.  The distance is that of the sliced centres from the evaluated surface, in percent of the character's height;
"99 % within" is over all frames and half frames.  "processor" counts the seconds of all threads.
"""
from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))
from blender_setup import enable_addon
from contact_sheet import open_character


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("blend", type=Path)
    arguments.add_argument("actions", nargs="*", default=["Robot_Dance"])
    arguments.add_argument("--rig", default="RobotArmature")
    arguments.add_argument("--count", type=int, default=200_000)
    options = arguments.parse_args()

    fg = enable_addon()("fastgs_blender")
    import bpy

    print(f"{'action':15} {'frames':>6} {'basis':>12} {'seconds':>8} {'processor':>10} {'MB':>6} "
          f"{'on frames':>10} {'on halves':>10} {'99 % within':>12}")
    for action in options.actions:
        scene, meshes = open_character(bpy, options.blend, options.rig, action)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "baked.safetensors")
            began, worked = time.perf_counter(), time.process_time()
            bpy.ops.fastgs.bake(filepath=str(path), count=options.count, import_result=False)
            seconds, processor = time.perf_counter() - began, time.process_time() - worked
            size = path.stat().st_size / 1e6
            model = fg.load(path)
            first, last = scene.frame_start, scene.frame_end
            whole, half = (np.array([distances(bpy, fg, model, meshes, f + shift, first) for f in range(first, last + (shift == 0))])
                           for shift in (0.0, 0.5))
            basis = f"{model.basis.name} {model.basis.order}"
            print(f"{action:15} {last - first + 1:6} {basis:>12} {seconds:8.1f} {processor:10.1f} {size:6.0f} "
                  f"{whole.mean():9.3f}% {half.mean():9.3f}% "
                  f"{np.percentile(np.concatenate([whole, half]), 99):11.3f}%")
            del model


def distances(bpy, fg, model, meshes, frame, first, probes=4000):
    """Distances [probes] of sliced centres from the evaluated surface on a frame, in percent of the height on that frame."""
    from mathutils.bvhtree import BVHTree

    bpy.context.scene.frame_set(int(frame // 1), subframe=frame % 1)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    points, triangles = [], []
    for obj in meshes:
        evaluated = obj.evaluated_get(depsgraph)
        mesh = evaluated.to_mesh()
        mesh.calc_loop_triangles()
        triangles += [[i + len(points) for i in t.vertices] for t in mesh.loop_triangles]
        points += [evaluated.matrix_world @ v.co for v in mesh.vertices]
        evaluated.to_mesh_clear()
    tree = BVHTree.FromPolygons(points, triangles)
    position = fg.slice_model(model, (frame - first) / model.clip.frame_count).position
    some = position[np.linspace(0, len(position) - 1, probes).astype(int)]
    return 100 * np.array([tree.find_nearest(p)[3] for p in some.tolist()]) / np.ptp([p.z for p in points])


if __name__ == "__main__":
    main()

# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory of a process that renders an animation in Blender: it should stay flat, and the model should be read once.

    python benchmarks/memory.py [--frames 500] [--gaussians 20000] [--size 320x180]

Prints the median of the frames' processor time, files and all; the resident memory every fifty frames and the largest of all, as shares
of the fiftieth; and what the process has asked the allocator for and not given back.  The difference is glibc's, which keeps freed memory
for a while, apart for each thread: the resident memory rises by some 22 MiB for a frame or more when another one of Blender's threads
evaluates the points that stand for the Gaussians in other engines.  It does so in a render that draws nothing, too, and not without the
object.  Needs Linux and the bpy module.
"""
from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SCENE = """
import ctypes, resource, sys, time, bpy, addon_utils
assert addon_utils.enable("bl_ext.user_default.fastgs_blender")
from bl_ext.user_default.fastgs_blender import fastgs_blender as fg
from bl_ext.user_default.fastgs_blender.fastgs_blender.commands.bench import synthetic
folder, frames, count = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
fg.save(synthetic(count), folder + "/model.safetensors")
bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
bpy.ops.import_scene.fastgs(filepath=folder + "/model.safetensors", use_engine=True)
scene = bpy.context.scene
camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
camera.location, camera.rotation_euler = (0, -4, 0), (1.5708, 0, 0)
scene.collection.objects.link(camera)
scene.camera = camera
scene.render.resolution_x, scene.render.resolution_y = int(sys.argv[4]), int(sys.argv[5])
scene.frame_start, scene.frame_end = 1, frames
scene.render.filepath = folder + "/frames/"

class Heap(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in "arena ordblks smblks hblks mapped usmblks fsmblks used free keepcost".split()]

heap = ctypes.CDLL("libc.so.6").mallinfo2
heap.restype = Heap

def tell(*_):
    now = heap()
    with open("/proc/self/statm") as file:
        print("memory", scene.frame_current, int(file.read().split()[1]) * resource.getpagesize(), now.used + now.mapped,
              time.process_time(), flush=True)

bpy.app.handlers.render_write.append(tell)
bpy.ops.render.render(animation=True)
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=500)
    parser.add_argument("--gaussians", type=int, default=20_000)
    parser.add_argument("--size", default="320x180")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        link = Path(folder, "user", "extensions", "user_default", "fastgs_blender")
        link.parent.mkdir(parents=True)
        link.symlink_to(ROOT, target_is_directory=True)
        environment = os.environ | {"BLENDER_USER_RESOURCES": str(Path(folder, "user"))}
        text = subprocess.run([sys.executable, "-c", SCENE, folder, str(args.frames), str(args.gaussians), *args.size.split("x")],
                              env=environment, check=True, text=True, stdout=subprocess.PIPE).stdout
    told = [line.split()[1:] for line in text.splitlines() if line.startswith("memory ")]
    times = [float(after[3]) - float(before[3]) for before, after in pairwise(told)]
    print(f"a frame      {1e3 * statistics.median(times):.0f} ms of processor time")
    sizes = {int(n): (int(resident), int(used)) for n, resident, used, _ in told}

    def tell(what, number):
        print(f"{what:12}" + "".join(f"   {name} {size / 2**20:7.1f} MiB, {size / first:.4f} of frame 50"
                                     for name, size, first in zip(("resident", "in use"), sizes[number], sizes[50], strict=True)))

    for number in range(50, args.frames + 1, 50):
        tell(f"frame {number}", number)
    tell("the largest", max((number for number in sizes if number >= 50), key=lambda number: sizes[number]))


if __name__ == "__main__":
    main()

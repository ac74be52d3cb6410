# SPDX-License-Identifier: GPL-3.0-or-later
"""A sequence of PLY files played from disk in a viewport: python benchmarks/sequence.py [--gaussians 100000] [--frames 100] [--beside N]

* read        one frame's file, median
* a frame     what the viewport's thread takes for one: reading where the look-ahead is not there yet, sorting, texels
* shown       frames a second, drawn one after another, each in full (on the machine's GPU or its software rasteriser)
* sent        bytes that go to the GPU for a frame; --beside N: with a still model of N Gaussians in the same view
* process     bytes of memory of the whole process, Blender included, at most (resident set)
* F12         whether the final pictures of some frames are those of their files, to the bit

Writes 2.5 GB of files into a temporary folder.  Needs a Python with Blender's bpy, and an EGL driver.
"""
from __future__ import annotations

import argparse
import os
import resource
import statistics
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from viewport import SIZE, load_extension, module


def write(fg, folder: Path, count: int, frames: int) -> None:
    """Numbered PLY files of a cloud that drifts and turns: the same Gaussians in one order."""
    rng = np.random.default_rng(0)
    cloud = fg.GaussianModel(
        position=rng.normal(0, 1, (count, 3)), rotation=rng.normal(size=(count, 4)), scale=rng.normal(-4.5, 0.5, (count, 3)),
        opacity=rng.normal(1, 2, count), features=rng.normal(0, 0.3, (count, 48)), appearance=fg.SH(3), axes="RFU")
    for i in range(frames):
        angle = 0.02 * i
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        fg.save(replace(cloud, position=cloud.position @ turn.T.astype(np.float32)), folder / f"frame_{i:04d}.ply")


def play(fg, folder: Path, frames: int, beside: Path | None = None) -> dict:
    """Show every frame in a view, and every half frame of the first tenth."""
    import gpu

    atlas, view, eye, worker, sorting = (module(f"engine.viewport.{name}") for name in ("atlas", "view", "eye", "worker", "sorting"))
    snapshot, retime = module("scene.snapshot"), module("scene.time").Retime(start_frame=0.0)
    thread, textures = worker.Worker(), atlas.Atlas()
    shown, display = view.View(textures, thread), view.Display(np.eye(3))
    window = np.array([[1.2, 0, 0, 0], [0, 1.2 * SIZE[0] / SIZE[1], 0, 0], [0, 0, -1.0002, -0.02], [0, 0, -1, 0]])
    camera, _ = eye.eye(*SIZE, np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -4], [0, 0, 0, 1]]), window)
    work, plain, sent, counter = [], sorting.sort, [], module("engine.viewport.textures").Sent

    def timed(*args):
        start = time.perf_counter()
        answer = plain(*args)
        work.append(time.perf_counter() - start)
        return answer

    sorting.sort = timed
    offscreen = gpu.types.GPUOffScreen(*SIZE, format='RGBA16F')
    with offscreen.bind():
        start = time.perf_counter()
        for number in [*range(frames), *np.arange(0, frames / 10, 0.5)]:
            counter.bytes = 0
            shown_files = {"frames": folder} | ({"beside": beside} if beside else {})
            moment = snapshot.Snapshot([snapshot.FileInstance(name, str(path), np.eye(4), retime) for name, path in shown_files.items()],
                                       float(number), 24.0)
            shown.draw(moment, camera, display, playing=True)
            while shown.waiting:
                time.sleep(0.001)
            shown.draw(moment, camera, display, playing=True)  # with the order that has arrived
            gpu.state.active_framebuffer_get().read_color(0, 0, 1, 1, 4, 0, 'FLOAT')  # until the picture is there
            sent.append(counter.bytes)
        seconds = time.perf_counter() - start
    thread.stop()
    if shown.trouble or not shown.shows:
        sys.exit(f"nothing was drawn: {shown.trouble}")
    return {"work": work, "sent": sent, "rate": (frames + len(np.arange(0, frames / 10, 0.5))) / seconds}


def same_as_files(fg, folder: Path, frames: int) -> bool:
    """Whether some frames of the sequence are rendered as their files are."""
    source = fg.open_source(folder)
    camera = fg.Camera(320, 240, 300.0, 300.0, 160.0, 120.0, np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 5], [0, 0, 0, 1]]))
    chosen = {0, frames // 3, frames - 1}
    return all(np.array_equal(fg.render(source, camera, source.clip.t_of_frame(f))["rgb"],
                              fg.render(fg.load(folder / f"frame_{f:04d}.ply"), camera)["rgb"]) for f in chosen)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gaussians", type=int, default=100_000)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--beside", type=int, default=0, help="Gaussians of a still model that is shown beside the sequence")
    arguments = parser.parse_args()
    load_extension()
    import bpy
    from gpu_context import open_gpu

    open_gpu(bpy.context.scene)
    fg = module("fastgs_blender")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name, "frames")
        folder.mkdir()
        write(fg, folder, arguments.gaussians, arguments.frames)
        beside = None
        if arguments.beside:
            (beside := Path(name, "beside")).mkdir()
            write(fg, beside, arguments.beside, 1)
            beside /= "frame_0000.ply"
        read = []
        for i in range(min(arguments.frames, 9)):
            start = time.perf_counter()
            fg.load(folder / f"frame_{i:04d}.ply")
            read.append(time.perf_counter() - start)
        played = play(fg, folder, arguments.frames, beside)
        same = same_as_files(fg, folder, arguments.frames)
    rows = {
        "frames": f"{arguments.frames} x {arguments.gaussians:,} Gaussians, SH 3",
        "read, ms": f"{1e3 * statistics.median(read):.0f}",
        "a frame on the thread, ms": f"{1e3 * statistics.median(played['work']):.0f}",
        "shown, frames a second": f"{played['rate']:.1f}",
        "sent for a frame, MB": f"{statistics.median(played['sent']) / 1e6:.1f}",
        "frames in memory, MB": f"{module('fastgs_blender.model.sequence').cache.nbytes() / 1e6:.0f}",
        "process, MB at most": f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3:.0f}",
        "F12 is the file's": "yes, to the bit" if same else "NO",
    }
    for row, value in rows.items():
        print(f"{row:28} {value}")
    sys.stdout.flush()
    os._exit(0 if same else 1)  # Blender as a module may crash at exit


if __name__ == "__main__":
    main()

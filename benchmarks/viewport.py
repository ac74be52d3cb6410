# SPDX-License-Identifier: GPL-3.0-or-later
"""The viewport's figures, without a window: python benchmarks/viewport.py [--gaussians 300000] [--frames 60] [--json FILE]

* sort          1 M depths, median, on the threads in use
* order         culling and sorting of the playing model on the viewport's thread
* upload        bytes handed to the GPU for a frame of playback
* main thread   time of a drawn frame up to the submission of its draw calls: Python, matrices, uploads; not the GPU
                (or the software rasteriser) behind them; by the clock, and as processor time where the machine is busy
* scrubbing     a redraw at another time until the GPU has done it, in Rendered and in Solid shading with a mesh in the window, with all
                splats and with the share that is drawn by default; Solid must not take more than 1.3 times as long
* still         a redraw in which nothing has changed, in Solid shading
* playback      frames a second, drawn one after the other as fast as they come
* orbit         1 M still Gaussians, the camera moves: the main thread's own time for a redraw; orders exact and in motion; what is held;
                and the longest time for which a sort keeps Python's lock from the main thread, which asks for it all the while.  It is
                counted in processor time of the sorting thread.  On a busy machine most waits are for a processor, in steps of 4 ms,
                so the sort in which the longest wait was shortest tells; the median is given beside it (Linux alone)
* stages        what diagnostics report: each stage of a picture until the GPU has done it

Needs a Python with Blender's bpy, and an EGL driver.
"""
from __future__ import annotations

import argparse
import ctypes
import importlib
import json
import os
import statistics
import sys
import tempfile
import time
from importlib import import_module
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
ADDON = "bl_ext.user_default.fastgs_blender"
SIZE = 1280, 720


def load_extension():
    """Enable the repository as Blender's extension, in a user folder of its own."""
    user = Path(tempfile.mkdtemp(prefix="fastgs-"))
    os.environ["BLENDER_USER_RESOURCES"] = str(user)
    folder = user / "extensions" / "user_default"
    folder.mkdir(parents=True)
    (folder / "fastgs_blender").symlink_to(ROOT, target_is_directory=True)
    import bpy  # noqa: F401 (makes the next one importable)
    import addon_utils  # isort: skip

    addon_utils.enable(ADDON, default_set=True)
    sys.path.insert(0, str(ROOT / "tests" / "addon"))
    return user


def module(name):
    return import_module(f"{ADDON}.{name}")


def cloud(fg, n: int):
    """Gaussians that stand still, in plain colours."""
    rng = np.random.default_rng(0)
    return fg.GaussianModel(position=rng.normal(0, 1, (n, 3)), rotation=rng.normal(size=(n, 4)), scale=rng.normal(-5.5, 0.5, (n, 3)),
                            opacity=rng.normal(1, 2, n), features=rng.uniform(0, 1, (n, 3)))


def capture(fg, n: int):
    """10 s at 30 fps in the paper's kind: Fourier motion, turning, temporal opacity, features with a decoder."""
    rng = np.random.default_rng(0)
    appearance = fg.Features(rng.normal(0, 0.3, (6, 12)), rng.normal(0, 0.3, (3, 6)))
    return fg.GaussianModel(
        position=rng.normal(0, 1, (n, 3)), rotation=rng.normal(size=(n, 4)), scale=rng.normal(-5, 0.5, (n, 3)),
        opacity=rng.normal(1, 2, n), features=rng.uniform(0, 1, (n, 9)), motion=rng.normal(0, 0.02, (n, 10, 3)),
        rotation_motion=rng.normal(0, 0.2, (n, 1, 4)), mu_tau=rng.uniform(0, 1, n), temporal=rng.normal(2, 1, (n, 1)),
        basis=fg.Fourier(5), rotation_basis=fg.Polynomial(1), temporal_kind=fg.Radial(), appearance=appearance,
        clip=fg.Clip(300, 30.0))


def sort_milliseconds(runs: int = 31) -> list[float]:
    """Sorting 1 M depths."""
    order_by = module("fastgs_blender.kernels.cpu.sort").order_by
    depth = np.random.default_rng(0).uniform(0.5, 40, 1_000_000).astype(np.float32)
    index = np.arange(len(depth), dtype=np.int32)
    order_by(depth, index)
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        order_by(depth, index)
        times.append(1e3 * (time.perf_counter() - start))
    return times


class Stopwatch:
    """Stands for a batch and measures what its draw calls take: that is not the main thread's own work."""

    def __init__(self, batch):
        self.batch, self.seconds, self.processor = batch, 0.0, 0.0

    def draw(self, *args, **kwargs):
        self._time(self.batch.draw, *args, **kwargs)

    def draw_instanced(self, *args, **kwargs):
        self._time(self.batch.draw_instanced, *args, **kwargs)

    def _time(self, function, *args, **kwargs):
        start, processor = time.perf_counter(), time.thread_time()
        function(*args, **kwargs)
        self.seconds += time.perf_counter() - start
        self.processor += time.thread_time() - processor


class Lock:
    """Asks for Python's lock again and again while another thread works."""

    def __init__(self, thread):
        self.clock = time.pthread_getcpuclockid(thread.ident)
        self.library, self.then = ctypes.CDLL(None), (ctypes.c_long * 2)()

    def wait(self) -> float:
        """Milliseconds of processor that the other thread used while this one waited for the lock."""
        self.library.clock_gettime(self.clock, self.then)  # what is called so holds no lock, and waits for it when it is done
        return 1e3 * (time.clock_gettime(self.clock) - self.then[0]) - 1e-6 * self.then[1]


def playback(fg, model, frames: int, orbit: float | None = None) -> dict:
    """Play a capture in a view, as fast as it goes; orbit: its time stands still, and of the splats this share is drawn."""
    import gpu

    atlas, textures, view, eye, worker, shaders, sorting = (module(f"engine.viewport.{name}") for name in (
        "atlas", "textures", "view", "eye", "worker", "shaders", "sorting"))
    snapshot = module("scene.snapshot")
    retime = module("scene.time").Retime(start_frame=0.0)
    path = Path(tempfile.mkdtemp()) / "capture.safetensors"
    fg.save(model, path)
    focal = 1.2
    window = np.array([[focal, 0, 0, 0], [0, focal * SIZE[0] / SIZE[1], 0, 0], [0, 0, -1.0002, -0.02], [0, 0, -1, 0]])
    thread, textures_of_all = worker.Worker(), atlas.Atlas()
    shown = view.View(textures_of_all, thread)
    display = view.Display(np.eye(3))
    features = isinstance(model.appearance, fg.Features)
    pairs = shaders.splats(features, False), shaders.resolve(features, False, False)
    watches = [Stopwatch(batch) for _, batch in pairs]
    shaders.splats = lambda *kind: (pairs[0][0], watches[0])
    shaders.resolve = lambda *kind: (pairs[1][0], watches[1])
    offscreen = gpu.types.GPUOffScreen(*SIZE, format='RGBA16F')
    own, processor, sent, order, hurried, held = [], [], [], [], [], []
    with offscreen.bind():
        for number in range(frames + 2):
            at = float(number if orbit is None else 1)
            moment = snapshot.Snapshot([snapshot.FileInstance("capture", str(path), np.eye(4), retime)], at, 30.0)
            turn = 0.01 * number
            pose = np.array([[np.cos(turn), 0, np.sin(turn), 0], [0, 1, 0, 0], [-np.sin(turn), 0, np.cos(turn), -4], [0, 0, 0, 1]])
            bytes_before = textures.Sent.bytes
            for watch in watches:
                watch.seconds = watch.processor = 0.0
            start, start_processor = time.perf_counter(), time.thread_time()
            camera, _ = eye.eye(*SIZE, pose, window)
            shown.draw(moment, camera, display, orbit or 1.0, playing=True, wait=number == 0)
            own.append(time.perf_counter() - start - sum(w.seconds for w in watches))
            processor.append(time.thread_time() - start_processor - sum(w.processor for w in watches))
            sent.append(textures.Sent.bytes - bytes_before)
            gpu.state.active_framebuffer_get().read_color(0, 0, 1, 1, 4, 0, 'FLOAT')  # until the picture is there
            lock = Lock(thread._thread) if thread._thread and hasattr(time, "pthread_getcpuclockid") else None
            longest = 0.0
            while shown.waiting:
                longest = max(longest, lock.wait() if lock else 0.0)
            held.append(longest)
        standing = {}
        for share, kept, times in [(1.0, None, order)] * 9 + [(orbit or 1.0, standing, hurried)] * 10:
            start = time.process_time()
            sorting.sort(moment, camera, share, textures_of_all, kept)
            times.append(time.process_time() - start)
    thread.stop()
    path.unlink()
    importlib.reload(shaders)  # without the stopwatches
    return {"first frame": 1e3 * own[0], "main thread": [1e3 * x for x in own[2:]],
            "processor": [1e3 * x for x in processor[2:]], "upload": sent[2:], "order": [1e3 * x for x in order],
            "in motion": [1e3 * x for x in hurried[1:]], "lock": held[2:],
            "held": {"atlas": textures_of_all.nbytes, "standing": sum(a.nbytes for entry in standing.values() for a in entry)}}


def shadings(fg, n: int, frames: int, share: float) -> dict:
    """Redraws in Rendered and in Solid shading, alternating, as milliseconds until the GPU has done them."""
    import gpu

    atlas, view, eye, worker, spaces, timing = (module(f"engine.viewport.{name}") for name in (
        "atlas", "view", "eye", "worker", "spaces", "timing"))
    snapshot, retime = module("scene.snapshot"), module("scene.time").Retime(start_frame=0.0)
    path = Path(tempfile.mkdtemp()) / "capture.safetensors"
    fg.save(capture(fg, n), path)
    window = np.array([[1.2, 0, 0, 0], [0, 1.2 * SIZE[0] / SIZE[1], 0, 0], [0, 0, -1.0002, -0.02], [0, 0, -1, 0]])
    pose = np.eye(4)
    pose[2, 3] = -4
    camera, depths = eye.eye(*SIZE, pose, window)
    thread, display = worker.Worker(), view.Display(np.eye(3))
    views = {name: view.View(atlas.Atlas(), thread) for name in ("Rendered", "Solid")}
    around = {"Rendered": None, "Solid": view.Around(depths, (), True, lambda: spaces.scene_depth(*SIZE, depths))}
    offscreen = gpu.types.GPUOffScreen(*SIZE, format='RGBA16F')
    out = {}

    def moment(at):
        return snapshot.Snapshot([snapshot.FileInstance("capture", str(path), np.eye(4), retime)], float(at), 30.0)

    with offscreen.bind():
        framebuffer = gpu.state.active_framebuffer_get()

        def redraw(name, at, density=1.0, **options):
            framebuffer.clear(color=(0, 0, 0, 0), depth=depths.a + depths.b / 4.0)
            timing.wait_for_gpu(framebuffer)
            start = time.perf_counter()
            views[name].draw(moment(at), camera, display, density, around=around[name], deep=True, **options)
            timing.wait_for_gpu(framebuffer)
            return 1e3 * (time.perf_counter() - start)

        def settle(name):
            while views[name].waiting:
                time.sleep(0.001)

        for name in views:
            redraw(name, 0, wait=True)
        for density, label in ((1.0, "all"), (share, f"{share:g} of all")):
            for number in range(frames):
                for name in views:
                    took = redraw(name, number + 1, density)
                    settle(name)
                    out.setdefault(f"scrubbing {name}, {label}", []).append(took)
        time.sleep(2 * view.RESTING)
        redraw("Solid", frames, share)
        settle("Solid")
        redraw("Solid", frames, share)
        out["still, Solid"] = [redraw("Solid", frames, share) for _ in range(9)]
        for name in views:
            start = time.perf_counter()
            for number in range(frames):
                redraw(name, number, share, playing=True)
            out[f"playback {name}"] = [frames / (time.perf_counter() - start)]
        settle("Rendered"), settle("Solid")
        for stage, value in timing.measure(moment(1), camera, 3).items():
            out[f"stage: {stage}"] = [value]
    thread.stop()
    path.unlink()
    return {name: statistics.median(values) for name, values in out.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gaussians", type=int, default=300_000)
    parser.add_argument("--orbit", type=int, default=1_000_000, help="Gaussians of the orbit; 0: none")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    load_extension()
    import bpy
    from gpu_context import open_gpu

    open_gpu(bpy.context.scene)
    fg, threads = module("fastgs_blender"), module("fastgs_blender.util.threads")
    sort = sort_milliseconds()
    played = playback(fg, capture(fg, arguments.gaussians), arguments.frames)
    own, sent = played["main thread"], played["upload"]
    figures = {
        "threads": threads.thread_count(), "gaussians": arguments.gaussians, "sort of 1 M, ms": statistics.median(sort),
        "culling and sorting, processor ms": statistics.median(played["order"]), "upload a frame, MB": max(sent) / 1e6,
        "main thread, ms, median": statistics.median(own), "main thread, ms, 95 %": float(np.percentile(own, 95)),
        "main thread, processor ms": statistics.median(played["processor"]), "first frame, ms": played["first frame"],
    }
    share = module("scene.properties").FASTGS_PG_scene.bl_rna.properties["viewport_density"].default
    if arguments.orbit:
        orbit = playback(fg, cloud(fg, arguments.orbit), arguments.frames, share)
        figures |= {
            "orbit: main thread, processor ms, median": statistics.median(orbit["processor"]),
            "orbit: main thread, processor ms, 95 %": float(np.percentile(orbit["processor"], 95)),
            "orbit: upload, MB": max(orbit["upload"]) / 1e6,
            "orbit: lock held at a time, ms, at most": min(orbit["lock"]),
            "orbit: longest wait for it, ms, median": statistics.median(orbit["lock"]),
            "orbit: exact order, processor ms": statistics.median(orbit["order"]),
            "orbit: order in motion, processor ms": statistics.median(orbit["in motion"]),
            "orbit: atlas, MB": orbit["held"]["atlas"] / 1e6, "orbit: kept for motion, MB": orbit["held"]["standing"] / 1e6}
    shown = shadings(fg, arguments.gaussians, max(arguments.frames // 4, 3), share)
    for label in ("all", f"{share:g} of all"):
        shown[f"scrubbing, Solid / Rendered, {label}"] = shown[f"scrubbing Solid, {label}"] / shown[f"scrubbing Rendered, {label}"]
    figures |= {(f"{name}, ms" if not name.startswith("playback") and "/" not in name else
                 f"{name}, frames a second" if name.startswith("playback") else name): value for name, value in shown.items()}
    for name, value in figures.items():
        print(f"{name:44} {value:,.2f}" if isinstance(value, float) else f"{name:44} {value:,}")
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1))
    sys.stdout.flush()
    os._exit(0)  # Blender as a module may crash at exit


if __name__ == "__main__":
    main()

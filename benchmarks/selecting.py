# SPDX-License-Identifier: GPL-3.0-or-later
"""Grow to the Thing on scenes whose truth is known, a lasso among 300 000 Gaussians, and redraws with a selection.

    python benchmarks/selecting.py [--count 20000] [--scene walker] [--speed]
    python benchmarks/selecting.py --capture captures/room --run runs/room/model.safetensors --things Walker

A stroke over the thing and one over what is not it are drawn on one frame of one view; the masks of what is found and of the truth are
compared in views and on frames without strokes.  --run takes a model that was trained on a capture of make_capture.py, and --things what
the names of the thing's objects begin with.  Then the second stroke is drawn beside the thing.  Redraws need Blender's bpy and an EGL
driver.
"""
from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "library")]

import touching_scenes as scenes  # noqa: E402

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.selecting.grow import grow  # noqa: E402
from fastgs_blender.selecting.joins import joins  # noqa: E402
from fastgs_blender.selecting.light import Light  # noqa: E402
from fastgs_blender.selecting.shapes import Lasso, seen_under, touched, under  # noqa: E402


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--scene", choices=scenes.SCENES)
    parser.add_argument("--run", type=Path)
    parser.add_argument("--capture", type=Path)
    parser.add_argument("--things", nargs="+", default=[])
    parser.add_argument("--speed", action="store_true", help="only the lasso and the redraws")
    options = parser.parse_args()
    if options.capture:
        filmed(options.capture, fg.load(options.run), tuple(options.things))
        return
    for name in () if options.speed else [options.scene] if options.scene else scenes.SCENES:
        scene = scenes.made(name, options.count)
        model = scene.model
        for against in (True, False):
            seconds, found = timed(model, scene, against)
            overlaps = scenes.overlaps(model, found, scene)
            print(f"{name:14} {'two strokes' if against else 'one stroke ':11}  IoU {np.mean(overlaps):.3f}, least {np.min(overlaps):.3f}"
                  f"   {len(model)} Gaussians, joins {seconds[0]:.2f} s, growing {seconds[1]:.2f} s of processor", flush=True)
    lasso()
    redraws()


def filmed(capture: Path, model, beginnings: tuple[str, ...], view: int = 1):
    """Prints intersection over union of what strokes in one view of a capture find, in other views and on other frames."""
    told, names = (json.loads((capture / file).read_text(encoding="utf-8")) for file in ("cameras.json", "things.json"))
    keys = "width", "height", "fx", "fy", "cx", "cy"
    cameras = [fg.Camera(*(told_of[key] for key in keys), np.array(told_of["world_to_camera"])) for told_of in told["cameras"]]
    wanted, frames = [number for name, number in names.items() if name.startswith(beginnings)], told["frame_count"]

    def truth(k, frame):
        return np.isin(np.asarray(Image.open(capture / "things" / told["cameras"][k]["name"] / f"{frame + 1:04}.png")), wanted)

    frame = frames // 3
    mask, seen = truth(view, frame), fg.Instance(model, np.eye(4), frame / frames).viewed(cameras[view])
    yes, no = (touched([seen], cameras[view], scenes.stroke_in(where, k))[0] for k, where in enumerate((mask, beside(mask))))
    for against in (True, False):
        found, overlaps = grow(model, yes, no if against else None), []
        for k in (0, 3, 5, 8, 10):
            for at in sorted({1, frames // 2, frames * 3 // 4, frames - 2} - {frame}):
                right = truth(k, at)
                if right.sum() >= 60:
                    mine = scenes.parts_in_view(model, found, cameras[k], at / frames)[0]
                    overlaps.append((mine & right).sum() / (mine | right).sum())
        print(f"{capture.name:14} {'two strokes' if against else 'one stroke '}  IoU {np.mean(overlaps):.3f}, least {np.min(overlaps):.3f}")


def beside(mask: np.ndarray, far: int = 24, near: int = 3) -> np.ndarray:
    """What lies within so many pixels of a mask [h, w], and not at its edge."""
    rings = [mask]
    for _ in range(far):
        wide = np.pad(rings[-1], 1)
        rings.append(wide[1:-1, 1:-1] | wide[:-2, 1:-1] | wide[2:, 1:-1] | wide[1:-1, :-2] | wide[1:-1, 2:])
    return rings[far] & ~rings[near]


def timed(model, scene, against):
    """((seconds of processor of the joins, of growing), what is found)."""
    yes, no = scenes.strokes(model, scene)
    start = time.process_time()
    joins(model)
    middle = time.process_time()
    found = grow(model, yes, no if against else None)
    return (middle - start, time.process_time() - middle), found


def lasso(count: int = 300_000):
    """Prints the seconds of processor of a lasso around a quarter of a picture of the example with `count` Gaussians,"""
    example = fg.load(ROOT / "examples" / "fireside.safetensors")
    model = example.take(np.arange(count) % len(example))
    camera = fg.Camera(1280, 720, 1100, 1100, 640, 360, fg.look_at(np.array([0.9, -2.7, 1.6]), (0.0, 0.1, 1.0)))
    angles = np.linspace(0, 2 * np.pi, 200)
    line = Lasso(tuple((640 + 360 * np.cos(a), 360 + 200 * np.sin(a)) for a in angles))
    seen, took, lights = fg.Instance(model, np.eye(4), 0.4).viewed(camera), {}, []

    def visible():
        seen_under([seen], camera, line, lights[-1])

    def first():
        lights.append(Light([seen], camera))
        visible()

    for _ in range(6):
        for name, work in (("through", lambda: under(seen, camera, line)), ("visible, the first in a view", first), ("visible", visible)):
            start = time.process_time()
            work()
            took.setdefault(name, []).append(time.process_time() - start)
    for name, seconds in took.items():
        print(f"lasso among {count}, {name}: {np.median(seconds[1:]):.3f} s of processor", flush=True)


def redraws(count: int = 300_000, frames: int = 5):
    """Prints how many times as long redraws take with a selection as without: on the viewport's thread, and until the GPU is done."""
    import viewport

    viewport.load_extension()
    import bpy
    import gpu
    from gpu_context import open_gpu

    open_gpu(bpy.context.scene)
    own, names = viewport.module("fastgs_blender"), ("atlas", "eye", "sorting", "timing", "view", "worker")
    atlas, eye, sorting, timing, view, worker = (viewport.module(f"engine.viewport.{name}") for name in names)
    snapshot, pack_mask = viewport.module("scene.snapshot"), viewport.module("fastgs_blender.rendering.masks").pack_mask
    retime, size = viewport.module("scene.time").Retime(start_frame=0.0), viewport.SIZE
    path = Path(tempfile.mkdtemp()) / "capture.safetensors"
    own.save(viewport.capture(own, count), path)
    picked = pack_mask(own.load(path).position[:, 0] > 0.5)
    window = np.array([[1.2, 0, 0, 0], [0, 1.2 * size[0] / size[1], 0, 0], [0, 0, -1.0002, -0.02], [0, 0, -1, 0]])
    pose = np.eye(4)
    pose[2, 3] = -4
    camera, _ = eye.eye(*size, pose, window)
    thread, display = worker.Worker(), view.Display(np.eye(3))
    views = {name: view.View(atlas.Atlas(), thread) for name in ("", picked)}
    took = {}

    def timed(what, name, work):
        start = time.process_time(), time.perf_counter()
        work()
        took.setdefault((what, name), []).append((time.process_time() - start[0], time.perf_counter() - start[1]))

    offscreen = gpu.types.GPUOffScreen(*size, format='RGBA16F')
    with offscreen.bind():
        framebuffer = gpu.state.active_framebuffer_get()

        def redraw(name, moment):
            views[name].draw(moment, camera, display, wait=True, deep=True)  # as with overlays, without which no selection is shown
            timing.wait_for_gpu(framebuffer)

        for number in range(frames + 1):
            for name in views:
                shown = snapshot.FileInstance("capture", str(path), np.eye(4), retime, selection=name)
                moment = snapshot.Snapshot([shown], float(number), 30.0).tinted()
                timed("culling and sorting", name, lambda moment=moment: sorting.sort(moment, camera, 1.0, atlas.Atlas()))
                timed("a frame", name, lambda name=name, moment=moment: redraw(name, moment))
                timed("a redraw of the frame", name, lambda name=name, moment=moment: redraw(name, moment))
    thread.stop()
    path.unlink()
    for what in ("culling and sorting", "a frame", "a redraw of the frame"):
        with_, without = (np.median(np.array(took[what, name][1:]), 0) for name in (picked, ""))
        print(f"{what} with a selection beside one without, {count} Gaussians: {with_[0] / without[0]:.2f} of the processor, "
              f"{with_[1] / without[1]:.2f} of the time ({1e3 * without[1]:.1f} ms)", flush=True)


if __name__ == "__main__":
    main()

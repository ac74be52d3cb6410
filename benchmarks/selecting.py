# SPDX-License-Identifier: GPL-3.0-or-later
"""Grow to the Thing on scenes whose truth is known, tools among 300 000 Gaussians, and redraws with a selection.

    python benchmarks/selecting.py [--count 20000] [--scene walker] [--speed]
    python benchmarks/selecting.py --many [--count 6000] [--scene gears]
    python benchmarks/selecting.py --capture captures/room --run runs/room/model.safetensors --things Walker

A stroke over the thing and one over what is not it are drawn on one frame of one view; the masks of what is found and of the truth are
compared in views and on frames without strokes.  --many takes the scenes of touching_many.py instead, three pairs of strokes for each
wanted thing, and compares by the light of Gaussians; all of them take minutes.  --run takes a model that was trained on a capture of
make_capture.py, and --things what the names of the thing's objects begin with.  Then the second stroke is drawn beside the thing.  Tools
need Blender's bpy, redraws an EGL driver as well.
"""
from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "library")]

import touching_many  # noqa: E402
import touching_scenes as scenes  # noqa: E402

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.selecting.grow import grow  # noqa: E402
from fastgs_blender.selecting.joins import joins  # noqa: E402
from fastgs_blender.selecting.light import Light  # noqa: E402
from fastgs_blender.selecting.shapes import Stroke, touched  # noqa: E402


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int)
    parser.add_argument("--scene")
    parser.add_argument("--many", action="store_true", help="the thirty scenes of touching_many.py")
    parser.add_argument("--run", type=Path)
    parser.add_argument("--capture", type=Path)
    parser.add_argument("--things", nargs="+", default=[])
    parser.add_argument("--speed", action="store_true", help="only the tools and the redraws")
    options = parser.parse_args()
    if options.capture:
        filmed(options.capture, fg.load(options.run), tuple(options.things))
        return
    known = touching_many.SCENES if options.many else scenes.SCENES
    if options.scene and options.scene not in known:
        parser.error(f"--scene is one of: {', '.join(known)}")
    names = [options.scene] if options.scene else list(known)
    if options.many:
        many(names, options.count or 6000)
        return
    for name in () if options.speed else names:
        scene = scenes.made(name, options.count or 20_000)
        model = scene.model
        for against in (True, False):
            seconds, found = timed(model, scene, against)
            overlaps = scenes.overlaps(model, found, scene)
            print(f"{name:14} {'two strokes' if against else 'one stroke ':11}  IoU {np.mean(overlaps):.3f}, least {np.min(overlaps):.3f}"
                  f"   {len(model)} Gaussians, joins {seconds[0]:.2f} s, growing {seconds[1]:.2f} s of processor", flush=True)
    tools()
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


def many(names: list[str], count: int):
    """Prints, of each scene of touching_many.py and of all, the mean over its pairs of strokes and how many reach 0.9."""
    reached = []
    for name in names:
        own = by_light(name, count)
        reached += own
        summed(name, own)
    summed("all", reached)


def summed(what: str, shares: list[float]):
    print(f"{what:16} IoU {np.mean(shares):.3f}, 0.9 or more in {np.sum(np.array(shares) >= 0.9)} of {len(shares)}", flush=True)


def by_light(name: str, count: int, views=(1, 3, 4, 6), times=(0.05, 0.5, 0.95)) -> list[float]:
    """Intersection over union, by the light of Gaussians in views and at times without strokes, for each pair of strokes in a scene."""
    things, wanted = touching_many.SCENES[name]()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the bake's, on how closely fast limbs are followed
        scene = scenes.baked(things, (), count, basis="auto")
    small, large = (scenes.cameras(8, size) for size in ((160, 120), (320, 240)))
    shown = [(labels(scene, small[view], t), lit(scene, small[view], t)[1].whole[0]) for view in views for t in times]
    drawn = [(large[view], labels(scene, large[view], t), *lit(scene, large[view], t)) for view, t in ((0, 1 / 3), (2, 0.7), (5, 0.2))]
    result = []
    for these in wanted:
        numbers = [scene.names.index(one) + 1 for one in these]
        truth = np.isin(scene.label + 1, numbers)
        judged = [light for picture, light in shown if np.isin(picture, numbers).sum() >= 30]
        for (camera, picture, seen, light), pair in zip(drawn, (along, near, over_neighbour), strict=True):
            mine = np.isin(picture, numbers)
            if mine.sum() >= 150:
                yes, no = (touched([seen], camera, stroke, light)[0] for stroke in pair(mine, np.where(mine, 0, picture)))
                found = grow(scene.model, yes, no)
                result.append(float(np.mean([light[found & truth].sum() / light[found | truth].sum() for light in judged])))
    return result


def labels(scene, camera, t) -> np.ndarray:
    """Which of a scene's things, counted from 1, covers most of each pixel [h, w]; 0: none."""
    given = [fg.Instance(scene.model, np.eye(4), t, name=name, index=k + 1).part(np.flatnonzero(scene.label == k))
             for k, name in enumerate(scene.names)]
    drawn = fg.render(given, camera, passes=["object_index", "alpha"])
    return np.where(drawn["alpha"] > 0.5, np.round(drawn["object_index"]), 0).astype(int)


def lit(scene, camera, t):
    """A scene as a camera sees it, and its light."""
    seen = fg.Instance(scene.model, np.eye(4), t).viewed(camera)
    return seen, Light([seen], camera)


def along(mine, others):
    """The longest strokes within a mask [h, w] and within what the other things cover [h, w]."""
    return scenes.stroke_in(mine, 0, 5.0), scenes.stroke_in(others > 0, 1, 5.0)


def near(mine, others):
    """A shorter stroke, and one close beside the thing."""
    close = beside(mine) & (others > 0)
    return shorter(scenes.stroke_in(mine, 2, 4.0), 0.7), scenes.stroke_in(close if close.sum() > 60 else others > 0, 3, 4.0)


def over_neighbour(mine, others):
    """A short stroke with a wide brush, and one over that of the others of which most lies at the thing's edge."""
    edge = beside(mine, 5, 1) & (others > 0)
    numbers, counts = np.unique(others[edge if edge.any() else others > 0], return_counts=True)
    neighbour = others == numbers[np.argmax(counts)]
    return shorter(scenes.stroke_in(mine, 4, 6.0), 0.5), shorter(scenes.stroke_in(neighbour, 5, 6.0), 0.8)


def shorter(stroke: Stroke, share: float) -> Stroke:
    """A share of a straight stroke, around its middle."""
    ends = np.array(stroke.middles)
    return Stroke(tuple((float(x), float(y)) for x, y in ends.mean(0) + share * (ends - ends.mean(0))), stroke.radius)


def timed(model, scene, against):
    """((seconds of processor of the joins, of growing), what is found)."""
    yes, no = scenes.strokes(model, scene)
    start = time.process_time()
    joins(model)
    middle = time.process_time()
    found = grow(model, yes, no if against else None)
    return (middle - start, time.process_time() - middle), found


def tools(count: int = 300_000):
    """Prints the seconds of processor of each tool in Blender among `count` Gaussians of the example, with its step of undo.

    The lasso goes around a quarter of the picture.  Of what is seen, the first tool in a view also makes its light.
    """
    import viewport

    viewport.load_extension()
    import bpy

    own, shapes, selection = (viewport.module(name) for name in ("fastgs_blender", "fastgs_blender.selecting.shapes", "scene.selection"))
    with tempfile.TemporaryDirectory() as folder:
        example = own.load(ROOT / "examples" / "fireside.safetensors")
        path = Path(folder) / "many.safetensors"
        own.save(example.take(np.arange(count) % len(example)), path)
        bpy.ops.import_scene.fastgs(filepath=str(path))
        obj, pose = bpy.context.object, fg.look_at(np.array([0.9, -2.7, 1.6]), (0.0, 0.1, 1.0))
        camera = own.Camera(1280, 720, 1100, 1100, 640, 360, pose)

        def use(shape, through=False, again=True):
            if not again:
                selection.Sight.forget()
            sight = selection.Sight(bpy.context.evaluated_depsgraph_get(), camera)
            found = sight.under(obj, shape, through)
            meant = sight.touched(obj, shape) if isinstance(shape, shapes.Stroke) and not through else None
            if not selection.drawn(obj, found, 'SET', meant):
                raise RuntimeError("the tool has changed nothing.")
            bpy.ops.ed.undo_push(message="Select Gaussians")

        angles, took = np.linspace(0, 2 * np.pi, 200), {}
        for x in range(640, 664, 3):  # each time something else is selected
            lasso = shapes.Lasso(tuple((x + 360 * np.cos(a), 360 + 200 * np.sin(a)) for a in angles))
            stroke = shapes.Stroke(tuple((float(x + step), 360.0) for step in range(-120, 121, 4)), 40.0)
            for name, given in {"a lasso, through": (lasso, True), "a lasso, the first in a view": (lasso, False, False),
                                "a stroke": (stroke,), "a lasso": (lasso,), "a stroke, through": (stroke, True),
                                "a click, before it grows": (shapes.Stroke(((x, 360.0),) * 2, 6.0),)}.items():
                start = time.process_time()
                use(*given)
                took.setdefault(name, []).append(time.process_time() - start)
    for name, seconds in took.items():
        print(f"{name} among {count}: {np.median(seconds[1:]):.3f} s of processor, at least {np.min(seconds):.3f}", flush=True)


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

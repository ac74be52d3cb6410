# SPDX-License-Identifier: GPL-3.0-or-later
"""A final frame: F12, animations and the command line."""
from __future__ import annotations

from concurrent.futures import CancelledError
from dataclasses import replace

import numpy as np

from .. import fastgs_blender as fg
from ..fastgs_blender.util.threads import set_threads
from ..scene import camera, colour, notices, objects, passes, settings, world
from ..scene import snapshot as frame
from . import compiling, worker


def render(engine, depsgraph):
    """Render one view layer; whatever goes wrong ends as one sentence in a report, never as a silent black frame."""
    try:
        _render_layer(engine, depsgraph)
    except CancelledError:
        pass
    except fg.FastGSError as error:
        notices.fail(engine, str(error))
    except MemoryError:
        notices.fail(engine, "there is not enough memory for this frame; lower the resolution or show fewer objects.")
    except Exception as error:  # the boundary: Blender would call what passes it a finished render
        notices.log.exception("unexpected error on frame %s", depsgraph.scene.frame_current)
        notices.fail(engine, f"FAST-GS could not render frame {depsgraph.scene.frame_current} ({type(error).__name__}: {error}); "
                             "the log holds the details.")


def _render_layer(engine, depsgraph):
    scene, layer = depsgraph.scene, depsgraph.view_layer
    set_threads(scene.render.threads if scene.render.threads_mode == 'FIXED' else settings.threads)
    picture = camera.frame_of(scene.render)
    shown = frame.contents(depsgraph)
    background, remark = world.background(scene, layer)
    if remark:
        notices.warn(engine, remark)
    status = Status(engine, f"{scene.name}, {layer.name}")
    status("Reading")
    parts, failed = worker.run(lambda progress: shown.parts(), engine.test_break, status.progress)
    _tell(engine, layer, shown, failed)
    if compiling.is_running():
        status("Compiling the renderer for this machine, once")
        worker.run(lambda progress: compiling.wait(), engine.test_break, status.progress)
    status.count = sum(len(part.model) for part in parts)
    status.memory(objects.loaded_bytes(), picture)

    depth = None
    if passes.wants_depth(layer):
        depth = "median_depth" if scene.fastgs.depth == 'MEDIAN' else "depth"
    passes.add(engine, layer)
    views = _views(scene.render)
    for index, view in enumerate(views):
        eye = _camera(engine, depsgraph, picture, view)
        status(f"Rendering {view}".strip())
        images = worker.run(
            lambda progress, eye=eye: pictures(parts, eye, depth, background, progress), engine.test_break,
            lambda fraction, index=index: status.progress((index + fraction) / len(views)))
        _, _, width, height = picture.window
        result = engine.begin_result(0, 0, width, height, layer=layer.name, view=view)
        passes.fill(result.layers[0], images)
        engine.end_result(result)


def pictures(parts, eye, depth: str | None, background, progress) -> passes.Pictures:
    """All pictures of one view.

    parts       list of rendering.instances.Instance
    depth       the library's depth pass to compute, or None
    background  scene-linear colour under the splats, or None for transparent film
    """
    working = colour.rec709_to_working()
    wanted = ("rgb", "alpha") + ((depth,) if depth else ())
    spaces = {part.model.colour_space for part in parts}
    if len(spaces) < 2:
        images = fg.render(parts, eye, passes=wanted, progress=progress)
        linear = colour.scene_linear(images["rgb"], images["alpha"], spaces != {"linear"}, working)
    else:
        # Splats add up: rgb = sum of weight x colour.  So each space's share of the picture, and of the weight, can be had
        # by painting the other's splats black, and is decoded by itself.
        encoded = fg.render(_painted(parts, "linear", 0), eye, passes=("rgb",), progress=lambda f: progress(f / 3))["rgb"]
        weight = fg.render(_painted(_painted(parts, "srgb", 1), "linear", 0), eye, passes=("rgb",),
                           progress=lambda f: progress((1 + f) / 3))["rgb"][..., 0]
        images = fg.render(_painted(parts, "srgb", 0), eye, passes=wanted, progress=lambda f: progress((2 + f) / 3))
        linear = (colour.scene_linear(encoded, weight, True, working)
                  + colour.scene_linear(images["rgb"], images["alpha"], False, working))
    return passes.Pictures(colour.film(linear, images["alpha"], background), images["alpha"], images.get(depth))


def _painted(parts, space: str, value: float):
    """The same splats, those of models in one colour space all in one grey."""
    def paint(model):
        if model.colour_space != space:
            return model
        return replace(model, appearance=fg.RGB(), features=np.full((len(model), 3), value, np.float32))

    return [replace(part, model=paint(part.model)) for part in parts]


def _views(render) -> list[str]:
    """The names of the pictures that a frame consists of: those of the eyes, or one without a name."""
    if not render.use_multiview:
        return [""]
    stereo = render.views_format == 'STEREO_3D'
    return [view.name for view in render.views if view.use and (not stereo or view.name in ("left", "right"))]


def _camera(engine, depsgraph, picture, view):
    if view:
        engine.active_view_set(view)
    obj = engine.camera_override or depsgraph.scene.camera
    if obj is None:
        raise fg.FastGSError("the scene has no camera; add one to render.")
    obj = obj.evaluated_get(depsgraph)
    if not view:
        return camera.camera_of(obj, picture, depsgraph)
    return camera.camera_of(obj, picture, depsgraph, engine.camera_model_matrix(obj), engine.camera_shift_x(obj))


def _tell(engine, layer, shown, failed):
    if not shown.shown:
        notices.warn(engine, f'The view layer "{layer.name}" shows no 4D Gaussians: only the background is rendered.')
    elif len(failed) == len({item.name for item in shown.shown}):
        raise fg.FastGSError(next(iter(failed.values())))
    for name, text in failed.items():
        notices.warn(engine, f"{name} is left out: {text}")


class Status:
    """Blender's status line, progress bar and memory figures."""

    def __init__(self, engine, title):
        self.engine, self.title, self.count = engine, title, None

    def __call__(self, stage):
        gaussians = "" if self.count is None else f"{self.count:,} Gaussians | "
        self.engine.update_stats("", f"{self.title} | {gaussians}{stage}")

    def progress(self, fraction):
        self.engine.update_progress(fraction)

    def memory(self, models: int, picture):
        used = (models + 40 * picture.window[2] * picture.window[3]) / 2**20  # bytes a pixel: channels, Combined, a copy
        self.engine.update_memory_stats(memory_used=used, memory_peak=used)

# SPDX-License-Identifier: GPL-3.0-or-later
"""render(): slice, project, rasterise, decode.  The one call that everything uses."""
import warnings
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..cameras.camera import Camera
from ..cameras.panorama import Panorama
from ..model.appearance import Features
from ..model.gaussians import GaussianModel
from ..model.sequence import Sequence, Source
from ..util.arguments import real, shown
from ..util.backends import load_backend
from ..util.errors import FastGSError, LossWarning
from .exposure import Exposure
from .holdout import as_triangles
from .instances import LIMIT, Instance, ObjectSettings, ViewedInstance
from .layout import PROBES, Layout
from .panorama import render_panorama
from .passes import DEFAULTS, PASSES, SHADOWS, Blended, PassSettings, images
from .quantities import shares
from .shadow_edges import sharpened

AT_ONCE = 16
"""Objects whose shares of the pixels are computed with one list of splats: each takes a number of every splat."""
DECODER_LIMIT = 1e12
"""Weights of a decoder beyond which its colours may not fit into float32."""


def render(model: Source | list, camera: Camera | Panorama, t: float = 0.0, passes: Iterable[str] = ("rgb", "alpha"), backend: str = "auto",
           progress: Any = None, settings: PassSettings = DEFAULTS, exposure: Exposure | None = None,
           holdout: ArrayLike | None = None) -> dict[str, np.ndarray]:
    """Render 4D Gaussians at time t (any real number; frame f of a clip is t = f / frame_count).

    model     one source (a model or a sequence), or a list of instances, sorted and blended together: instances.Instance, or (source,
              placement [4, 4] in the world, t), which a fourth member may crop (crops.Crop boxes, or instances.ObjectSettings)
    camera    Camera, or Panorama
    passes    rgb           [h, w, 3]  premultiplied, in the model's own colour space.  A model of Spacetime Gaussians that is alone,
                            without holdout and exposure, comes as its trainer shows it, with a colour where alpha is 0; see settings
              alpha         [h, w]
              holdout       [h, w]  the light that the holdout's triangles stop; alpha, this and what lies behind make up a pixel
              shadow        [h, w]  the share of the light of settings.shadows[0] that arrives at its meshes, 1 where the camera sees
                                    none; shadow_2 ... of the next ones
              lamp_light    [h, w, 3]  linear, not premultiplied: the light of the first of settings.light's lamps on the splats, as if
                                    they were white and nothing in its way; lamp_light_2 ... of the next ones
              mesh_shadow   [h, w]  the share of it that meshes let through; mesh_shadow_2 ...
              lamp_shadow   [h, w]  the share of it that meshes and splats let through; lamp_shadow_2 ...
              contact       [h, w]  the share of light from all around that settings.light's meshes nearby leave
              unlit         [h, w, 3]  premultiplied, in the model's own colour space: an estimate of the colour without light
              depth         [h, w]  expected depth along the view axis, of the points of greatest density on the pixel's ray; inf where
                            alpha is 0
              median_depth  [h, w]  depth where transmittance falls to a half (the last splat's where it does not), else inf
              first_depth   [h, w]  depth of the nearest splat, else inf
              mist          [h, w]  0 near .. 1 far, and where nothing is
              position      [h, w, 3]  in the world, the point at that depth; 0 where alpha is 0
              normal        [h, w, 3]  unit vectors in the world, of the surface that the Gaussians make, turned to the camera; else 0
              vector        [h, w, 4]  motion in pixels, y up: to the frame before minus here, and here minus in the frame after
              object_index  [h, w]  Instance.index of what covers most of the pixel; 0 for nothing
              cryptomatte_00 .. _07  [h, w, 4]  two objects each, by Instance.name: number and coverage (cryptomatte.py)
              count         [h, w]  how many splats were blended
    backend   "cpu" (numba), "reference" (NumPy, slow), "auto" (of these two the first that is there), "gpu" (the best GPU; "gpu:PART": the
              one whose name holds PART), which lets the CPU draw what it fails at
    progress  called with 0..1 between pieces of work; what it raises cancels the render and passes through
    settings  PassSettings: the film, the mist's distances, the frames before and after for vectors, the light that casts shadows, and how
              splats are sorted
    exposure  Exposure: motion blur and depth of field, of rgb, alpha, holdout and Cryptomatte.  The other passes show the middle of the
              exposure's time through the middle of the lens
    holdout   opaque triangles [F, 3, 3] in the world, which hide the splats behind them (rendering/holdout.py)

    Returns float32 arrays, the top row first, of the camera's window.  Same inputs, same bytes, for any number of threads.

    Example:
        image = fg.render(model, camera, t=0.25, passes=["rgb", "depth"])["rgb"]
    """
    if not isinstance(camera, (Camera, Panorama)):
        raise FastGSError(f"render() needs a Camera to look through, such as fg.load_cameras(path)[0].camera, not {shown(camera)}.")
    if isinstance(passes, str) or not isinstance(passes, Iterable):
        raise FastGSError(f"the passes are a list of names, such as [\"rgb\"], not {shown(passes)}.")
    passes = tuple(passes)
    unknown = [p for p in passes if not isinstance(p, str) or p not in PASSES]
    if unknown:
        raise FastGSError(f"the pass {unknown[0]!r} is unknown; there are {', '.join(PASSES)}.")
    holdout, progress = as_triangles(holdout), progress or (lambda share: None)
    if isinstance(camera, Panorama):
        face = partial(render, model, t=t, backend=backend, holdout=holdout)
        return render_panorama(face, camera, passes, settings, exposure, progress)
    entries = [PASSES[name] for name in passes]
    sharp = [entry for entry in entries if not (entry.exposed and exposure)]
    needs = {part for entry in sharp for part in entry.needs} | {"alpha"}
    kernels = load_backend(backend)
    instances = _instances(model, camera, t)
    if settings.light is not None:
        still = exposure is None and not settings.by_pixel  # what hides what is found by the splats' centres
        lit = settings.light.lit(instances, camera, kernels, progress, any(entry.light for entry in entries), still)
        instances = [each.viewed(camera) for each in lit if len(each.model)]
    blended, blurred = None, None
    drawn = bool(instances) or holdout is not None
    sharpen = partial(sharpened, instances=instances, camera=camera, settings=settings, backend=kernels, holdout=holdout, exposure=exposure)
    if drawn and sharp:
        middle = (instances, camera, holdout) if exposure is None else exposure.middle(instances, camera, holdout)
        blended = sharpen(partial(_blended, kernels, *middle[:2], needs, progress, settings, middle[2]), needs, averaged=False)
    if drawn and exposure is not None and len(sharp) < len(entries):
        needs = {part for entry in entries if entry not in sharp for part in entry.needs}
        draw = partial(_exposed, kernels, exposure, instances, camera, needs, progress, holdout, settings.by_pixel)
        blurred = sharpen(draw, needs, averaged=True)
    found = images(sharp, blended, camera) | images([each for each in entries if each not in sharp], blurred, camera)
    progress(1.0)
    return {name: found[name] for name in passes}


def _blended(backend: Any, instances: list[ViewedInstance], camera: Camera, needs: set[str], progress: Any,
             settings: PassSettings, holdout: np.ndarray | None) -> Blended:
    """Draw the instances with a backend; returns the blended sums for the passes that were asked for."""
    objects = _objects(instances, needs)
    quantities = settings.quantities(needs, instances, backend)
    if objects:
        quantities["shares"] = shares(instances, objects[:AT_ONCE])
    draws = max(1, -(-len(objects) // AT_ONCE))
    planes = holdout is not None
    opaque = settings.film == "opaque" and holdout is None
    layout = Layout(instances, False, quantities, planes or "plane" in needs, settings.by_pixel, opaque)
    buffers = backend.draw(instances, camera, layout, needs & set(PROBES), lambda f: progress(f / draws), holdout=holdout)
    rgb = backend.numpy(backend.colour(buffers, layout, camera)) if "rgb" in needs else None
    sums, probes = ({name: backend.numpy(array) for name, array in found.items()} for found in (buffers.sums, buffers.probes))
    parts = [sums.pop("shares")] if objects else [np.zeros((*camera.window[:1:-1], 0), np.float32)] if "shares" in needs else []
    for i in range(1, draws):
        more = Layout(instances, False, {"shares": shares(instances, objects[i * AT_ONCE:(i + 1) * AT_ONCE])}, planes, settings.by_pixel)
        drawn = backend.draw(instances, camera, more, (), lambda f, i=i: progress((i + f) / draws), holdout=holdout)
        parts.append(backend.numpy(drawn.sums["shares"]))
    casting = [each for each in instances if each.settings.casts]
    shadows = {entry.name: shadow.picture(backend, casting, camera, progress)
               for entry, shadow in zip(SHADOWS, settings.shadows, strict=False) if entry.name in needs}
    return Blended(camera, rgb, backend.numpy(buffers.alpha), sums, probes, objects, np.concatenate(parts, -1) if parts else None,
                   None if buffers.held is None else backend.numpy(buffers.held), shadows)


def _exposed(backend: Any, exposure: Exposure, instances: list[ViewedInstance], camera: Camera, needs: set[str], progress: Any,
             holdout: np.ndarray | None, by_pixel: bool) -> Blended:
    """Draw the average over an exposure with a backend."""
    objects = _objects(instances, needs)
    draws = max(1, -(-len(objects) // AT_ONCE))
    found = [backend.expose(exposure, instances, camera, "rgb" in needs and i == 0, lambda f, i=i: progress((i + f) / draws),
                            holdout=holdout, objects=objects[i * AT_ONCE:(i + 1) * AT_ONCE], by_pixel=by_pixel) for i in range(draws)]
    rgb, held = (None if array is None else backend.numpy(array) for array in (found[0].rgb, found[0].held))
    parts = [backend.numpy(each.objects) for each in found] if objects else [np.zeros((*camera.window[:1:-1], 0), np.float32)]
    return Blended(camera, rgb, backend.numpy(found[0].alpha), {}, {}, objects, np.concatenate(parts, -1), held)


def _objects(instances: list[ViewedInstance], needs: set[str]) -> list[tuple[str, int]]:
    """The objects whose shares of the pixels are needed."""
    return list(dict.fromkeys(instance.identity for instance in instances)) if "shares" in needs else []


def _instances(model: Source | list, camera: Camera, t: ArrayLike) -> list[ViewedInstance]:
    """The instances of render()'s arguments before the camera.  Empty ones, and those with numbers out of range, are left out."""
    alone = isinstance(model, (GaussianModel, Sequence))
    if not alone and (isinstance(model, (str, Path)) or not isinstance(model, Iterable)):
        raise FastGSError(f"render() needs a model, as fg.load(path) reads it, or a list of them with their places, not {shown(model)}.")
    given: Any = [(model, np.eye(4), t)] if alone else model
    found = [_instance(each) for each in given]
    viewed = [instance.viewed(camera) for instance in found if len(instance.model)]
    for instance in viewed:
        if not instance.in_range:
            warnings.warn(LossWarning(f"a model is not drawn: its placement before the camera has numbers beyond {LIMIT:g}."), stacklevel=3)
        appearance = instance.model.appearance
        if isinstance(appearance, Features) and max(np.abs(appearance.w1).max(), np.abs(appearance.w2).max()) > DECODER_LIMIT:
            text = f"a model's decoder has weights beyond {DECODER_LIMIT:g}: colours that float32 cannot hold are black."
            warnings.warn(LossWarning(text), stacklevel=3)
    return [instance for instance in viewed if instance.in_range]


def _instance(given: Any) -> Instance:
    """The Instance of (model, placement [4, 4], t), perhaps with boxes or ObjectSettings as a fourth member."""
    if isinstance(given, Instance):
        return given
    if not isinstance(given, (tuple, list)) or not 3 <= len(given) <= 4 or not isinstance(given[0], (GaussianModel, Sequence)):
        raise FastGSError("each model of a list for render() is given as (model, placement [4, 4], t).")
    source, placement, t, *rest = given
    model, t = source.moment(real(t, "the time of a model"))
    settings = rest[0] if rest else ObjectSettings()
    return Instance(model, placement, t, settings if isinstance(settings, ObjectSettings) else ObjectSettings(settings))

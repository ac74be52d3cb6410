# SPDX-License-Identifier: GPL-3.0-or-later
"""Which backend a device's name means, and whether a GPU computes what it should: the self-test, whose verdict is kept.

A verdict holds for an adapter, its driver and the shaders.  It lies in gpus.json in the folder for caches; before a test it says that the
test did not come to its end, in case the driver takes the program with it.
"""
from __future__ import annotations

import hashlib
import json
import os
from contextlib import suppress
from functools import cache

import numpy as np

from ...cameras.camera import Camera
from ...model.appearance import SH, Features
from ...model.gaussians import GaussianModel
from ...model.motion import Fourier, Polynomial
from ...model.temporal import Radial
from ...rendering.instances import Instance
from ...rendering.layout import Layout
from ...util.errors import FastGSError
from ...util.outputs import replacing
from ...util.reading import read_json
from ..cpu.backend import CPU
from ..cpu.cache import base_folder
from ..parameters import DECODER
from . import shaders
from .adapters import Adapter, adapters, find
from .backend import GPU
from .device import Failure

UNFINISHED = "the self-test did not come to its end"
CLOSE, MEAN, MANY = 2e-3, 1e-4, 0.01
"""A picture has passed if at most MANY of its pixels differ by more than CLOSE (those at the alpha cut), and the mean by less than MEAN."""
STRAY = 0.01
"""The relative error of gradients that passes."""


def choose(device: str) -> tuple[str, str]:
    """(the backend's name, a remark or "") of a device: auto, gpu, or a part of an adapter's name; raises FastGSError.

    auto is the first GPU, no software, that has passed the self-test, else the CPU; the remark says why.
    """
    if device != "auto":
        adapter = find("" if device == "gpu" else device)
        wrong = verdict(adapter)
        return f"gpu:{adapter.name}", f"{adapter.name} has failed the self-test: {wrong}." if wrong else ""
    try:
        first = find("")
    except FastGSError as error:
        return "auto", str(error).removesuffix("; use the device cpu.") + ": the CPU is used."
    failed = []
    for adapter in dict.fromkeys([first, *(each for each in adapters() if not each.software)]):
        wrong = verdict(adapter)
        if not wrong:
            return f"gpu:{adapter.name}", ""
        failed.append(f"{adapter.name} has failed the self-test ({wrong})")
    return "auto", f"{'; '.join(failed)}: the CPU is used."


def describe() -> dict:
    """All adapters, and what `auto` means, as JSON values."""
    try:
        found = adapters()
    except Failure:
        found = ()
    name, reason = choose("auto")
    known = [{"name": each.name, "kind": each.kind, "interface": each.interface, "driver": each.driver, "software": each.software,
              "largest_bytes": each.largest, "self_test": verdict(each)} for each in found]
    return {"devices": known, "auto": name.partition(":")[2] or None, "reason": reason}


def verdict(adapter: Adapter) -> str:
    """What is wrong with an adapter, as a part of a sentence; "": nothing.  Tests it where that has not been done."""
    path, key = base_folder() / "gpus.json", _key(adapter)
    known = _known(path)
    if key not in known:
        _keep(path, known | {key: UNFINISHED})
        known = _known(path) | {key: test(adapter)}
        _keep(path, known)
    return known[key]


def _key(adapter: Adapter) -> str:
    return f"{adapter.name} | {adapter.driver} | {adapter.interface} | {_digest()}"


@cache
def _digest() -> str:
    files = sorted(shaders.FOLDER.parent.rglob("*.wgsl")) + sorted(shaders.FOLDER.parent.glob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:12]


def _known(path) -> dict[str, str]:
    """The verdicts in a file; those of a damaged one are forgotten."""
    if not path.is_file():
        return {}
    with suppress(FastGSError):
        values = read_json(path)
        if isinstance(values, dict):
            return {key: value for key, value in values.items() if isinstance(value, str)}
    return {}


def _keep(path, verdicts: dict[str, str]) -> None:
    """Write the verdicts, where the folder can be written to."""
    with suppress(OSError, FastGSError):
        os.makedirs(path.parent, exist_ok=True)
        with replacing([path]) as (aside,):
            aside.write_text(json.dumps(verdicts, indent=1), "utf-8")


def test(adapter: Adapter) -> str:
    """What is wrong with an adapter, as verdict() gives it: pictures and gradients of two models, by it and by the CPU."""
    backend = GPU(adapter.open)
    try:
        for look in (SH(1), Features(*(np.random.default_rng(1).normal(0, 0.5, shape) for shape in ((6, 12), (3, 6))))):
            model, camera = _scene(look)
            wanted, once, again = (_picture(each, model, camera) for each in (CPU(), backend, backend))
            if backend.failed is not None:
                return backend.failed
            if not np.array_equal(once, again):
                return "two pictures of the same are not the same"
            difference = np.nan_to_num(np.abs(once - wanted), nan=np.inf)
            if difference.mean() > MEAN or (difference > CLOSE).mean() > MANY:
                return f"its pictures are wrong by {difference.max():.2g}"
            wanted, found = (_gradients(each, model, camera) for each in (CPU(), backend))
            for name, array in wanted.items():
                error = np.linalg.norm(found[name] - array) / max(np.linalg.norm(array), 1e-12)
                if not error < STRAY:
                    return f"its gradients of {name} are wrong by {100 * error:.2g} %"
    except Failure as failure:
        return str(failure)
    return ""


def _scene(look) -> tuple[GaussianModel, Camera]:
    """A small model of some look, and what sees it."""
    rng, n = np.random.default_rng(2), 300
    model = GaussianModel(
        position=rng.uniform((-2, -1.4, 1.5), (2, 1.4, 6), (n, 3)), rotation=rng.normal(size=(n, 4)), scale=rng.normal(-2.3, 0.6, (n, 3)),
        opacity=rng.normal(0.5, 2, n), features=rng.normal(0.3, 0.3, (n, look.width)), motion=rng.normal(0, 0.05, (n, 4, 3)),
        rotation_motion=rng.normal(0, 0.3, (n, 1, 4)), mu_tau=rng.uniform(0, 1, n), temporal=rng.normal(1, 1, (n, 1)), basis=Fourier(2),
        rotation_basis=Polynomial(1), temporal_kind=Radial(), appearance=look)
    return model, Camera(96, 64, 70, 75, 47, 33, np.eye(4))


def _picture(backend, model: GaussianModel, camera: Camera) -> np.ndarray:
    """Colour and alpha [h, w, 4] by a backend."""
    instances = [Instance(model, np.eye(4), 0.4).viewed(camera)]
    layout = Layout(instances, depth=False)
    buffers = backend.draw(instances, camera, layout, (), lambda share: None)
    rgb, alpha = backend.numpy(backend.colour(buffers, layout, camera)), backend.numpy(buffers.alpha)
    return np.concatenate([rgb, alpha[..., None]], -1)


def _gradients(backend, model: GaussianModel, camera: Camera) -> dict[str, np.ndarray]:
    """Gradients of the loss against a grey picture, by a backend."""
    decoder = {name: getattr(model.appearance, name) for name in DECODER if hasattr(model.appearance, name)}
    parameters = {name: backend.array(array) for name, array in (model.arrays | decoder).items()}
    picture = backend.splat(parameters, model, camera, 0.4)
    goal = backend.array(np.full((camera.height, camera.width, 3), 0.4, np.float32))
    loss = backend.compare(picture, goal, None, None, 0.2, 0.0, 1.0)
    return {name: backend.numpy(array) for name, array in backend.backward(picture, loss.rgb, loss.alpha).items()}

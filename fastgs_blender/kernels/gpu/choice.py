# SPDX-License-Identifier: GPL-3.0-or-later
"""Chooses the backend for a device's name, and tests whether a GPU computes correctly (the self-test, whose result is stored).

A result is valid for one adapter, its driver and the shaders.  It is stored in gpus.json in the user's folder for caches.  Before a test
starts, "not finished" is stored: where a faulty driver ends the whole program, the next start does not test that GPU again.
"""
from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
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
from ..cpu.cache import user_folder
from ..parameters import DECODER
from . import shaders
from .adapters import Adapter, adapters, find
from .backend import GPU
from .device import Failure

VERDICTS = "gpus.json"
UNFINISHED = "the self-test did not come to its end"
CLOSE, MEAN, MANY = 2e-3, 1e-4, 0.01
"""A picture has passed if at most MANY of its pixels differ by more than CLOSE (those at the alpha cut), and the mean by less than MEAN."""
STRAY = 0.01
"""The relative error of gradients that passes."""


def choose(device: str, examine: Callable[[Adapter], str | None] | None = None) -> tuple[str, str]:
    """(the backend's name, a remark or "") of a device: auto, gpu, or a part of an adapter's name; raises FastGSError.

    auto is the first GPU, no software, that has passed the self-test.  Where none has, and where one that was named has not, it is the
    CPU, and the remark says why.
    examine  gives an adapter's verdict in place of verdict(), None where it has not been tested
    """
    examine = examine or verdict
    try:
        wanted = [find("" if device in ("auto", "gpu") else device)]
    except FastGSError as error:
        if device != "auto":
            raise
        return "auto", str(error).removesuffix("; use the device cpu.") + ": the CPU is used."
    if device == "auto":
        wanted += [each for each in adapters() if not each.software]
    failed = []
    for adapter in dict.fromkeys(wanted):
        wrong = examine(adapter)
        if wrong == "":
            return f"gpu:{adapter.name}", ""
        failed.append(f"{adapter.name} " + ("has not been tested yet" if wrong is None else f"has failed the self-test ({wrong})"))
    return "auto", f"{'; '.join(failed)}: the CPU is used."


def describe(part: str = "", test: bool = True, again: bool = False, tell: Callable[[str], None] = lambda text: None) -> dict:
    """The adapters whose name holds a text, and what `auto` means, as JSON values.

    test   test those that have not been; else their verdict is None.  again: test the others once more
    tell   is told which adapter is being tested
    """
    try:
        found = [each for each in adapters() if part.lower() in each.name.lower()]
    except Failure:
        found = []
    verdicts = {}
    for number, each in enumerate(found, 1):
        if test and (again or known(each) is None):
            tell(f"testing {each.name} ({number} of {len(found)})")
        verdicts[each] = verdict(each, again) if test else known(each)
    name, reason = choose("auto", lambda each: verdicts[each] if each in verdicts else known(each))
    listed = [{"name": each.name, "kind": each.kind, "interface": each.interface, "driver": each.driver, "software": each.software,
               "largest_bytes": each.largest, "self_test": wrong} for each, wrong in verdicts.items()]
    return {"devices": listed, "auto": name.partition(":")[2] or None, "reason": reason}


def verdict(adapter: Adapter, again: bool = False) -> str:
    """The fault of an adapter as a clause, "" where it has passed the self-test.  It is tested where there is no result yet, or once
    more."""
    if not again and (found := known(adapter)) is not None:
        return found
    _keep(adapter, UNFINISHED)
    found = test(adapter)
    _keep(adapter, found)
    return found


def known(adapter: Adapter) -> str | None:
    """The stored result of an adapter's self-test; None where it has not been tested."""
    return _kept().get(_key(adapter))


def _key(adapter: Adapter) -> str:
    return f"{adapter.name} | {adapter.driver} | {adapter.interface} | {_digest()}"


@cache
def _digest() -> str:
    files = sorted(shaders.FOLDER.parent.rglob("*.wgsl")) + sorted(shaders.FOLDER.parent.glob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:12]


def _kept() -> dict[str, str]:
    """The stored results; none where the file is damaged."""
    path = user_folder() / VERDICTS
    if path.is_file():
        with suppress(FastGSError):
            values = read_json(path)
            if isinstance(values, dict):
                return {key: value for key, value in values.items() if isinstance(value, str)}
    return {}


def _keep(adapter: Adapter, wrong: str) -> None:
    """Store a result, if the folder is writable."""
    path = user_folder() / VERDICTS
    with suppress(OSError, FastGSError):
        os.makedirs(path.parent, exist_ok=True)
        with replacing([path]) as (aside,):
            aside.write_text(json.dumps(_kept() | {_key(adapter): wrong}, indent=1), "utf-8")


def test(adapter: Adapter) -> str:
    """Test an adapter: compute pictures and gradients of two models by it and by the CPU.  Returns the fault as verdict() does."""
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
                    return f"its {'' if name == 'loss' else 'gradients of '}{name} are wrong by {100 * error:.2g} %"
    except Failure as failure:
        return str(failure)
    return ""


def _scene(look) -> tuple[GaussianModel, Camera]:
    """A small random model with a given appearance, and a camera."""
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
    """Gradients of the loss against a grey picture, and the loss itself, by a backend."""
    decoder = {name: getattr(model.appearance, name) for name in DECODER if hasattr(model.appearance, name)}
    parameters = {name: backend.array(array) for name, array in (model.arrays | decoder).items()}
    picture = backend.splat(parameters, model, camera, 0.4)
    goal = backend.array(np.full((camera.height, camera.width, 3), 0.4, np.float32))
    loss = backend.compare(picture, goal, None, None, 0.2, 0.0, 1.0)
    found = backend.backward(picture, loss.rgb, loss.alpha) | {"loss": loss.values}
    return {name: backend.numpy(array) for name, array in found.items()}

# SPDX-License-Identifier: GPL-3.0-or-later
"""The self-test of a GPU: small pictures of every kind, the gradients of a view and the updates of a step, computed by it and by the CPU.
Where they agree, it takes the time of a frame and of a training step on both.

Each stage that pictures or training use (wgsl/) is run here: a test lets each of them do nothing, and the self-test must notice.
"""
import time
from collections.abc import Callable
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np

from ...cameras.camera import Camera
from ...model.appearance import SH, Appearance
from ...model.gaussians import GaussianModel
from ...rendering.exposure import Aperture, Exposure
from ...rendering.instances import Instance, ViewedInstance
from ...rendering.layout import PROBES, Layout
from ...rendering.quantities import shares
from ...util.verdicts import Verdict
from ..cpu.backend import CPU
from ..cpu.steps import GATE, SHARPNESS
from ..made import made_camera, made_decoder, made_model
from ..parameters import DECODER
from ..protocol import MotionNorm
from .adapters import Adapter
from .backend import GPU
from .device import Failure
from .pace import pace

CLOSE, MEAN, MANY = 2e-3, 1e-4, 0.01
"""A picture has passed if at most MANY of its pixels differ by more than CLOSE (those at the alpha cut), and the mean by less than MEAN.
Depths differ by their shares."""
STRAY = 0.01
"""The relative error of gradients and steps that passes."""
NARROW = 32 << 10
"""Bytes of bindings with which the splats of STRIP lie in several buffers."""
TIME = 0.4
N = 300
STRIP = Camera(16, 48, 45, 45, 8, 24, np.eye(4))
TRIANGLE = np.array([[[-0.6, -0.5, 3], [0.7, -0.4, 4], [0, 0.6, 3.5]]], np.float32)

FRAME, MANY_SPLATS, FINER = (960, 540), 60_000, 1.8
"""Size, Gaussians and their smallness (_model) of the frame and the step that are timed.  Smaller ones would time a GPU's start."""

Work = Callable[[CPU], dict[str, np.ndarray]]


def self_test(adapter: Adapter, clock: Callable[[], float] = time.perf_counter) -> Verdict:
    """Test what an adapter computes, then, but for software, how long it takes (pace.py); clock gives seconds."""
    backend, cpu = GPU(adapter.open), CPU()
    fault = next((fault for kind, works in WORKS.items() for work in works if (fault := fault_of(backend, kind, work, work(cpu)))), "")
    if fault or adapter.software:
        return Verdict(fault)
    try:
        found = pace(backend, cpu, _model(SH(1), MANY_SPLATS, FINER), made_camera(*FRAME), clock)
    except Failure as failure:
        return Verdict(str(failure))
    fault = backend.failed or backend.too_large
    return Verdict(fault) if fault else Verdict("", **found)


def fault_of(backend: GPU, kind: str, work: Work, wanted: dict[str, np.ndarray]) -> str:
    """What is wrong with a work, of a kind in WORKS, by a GPU, of which the CPU gives what is wanted."""
    try:
        once, again = work(backend), work(backend)
    except Failure as failure:
        return str(failure)
    if fault := backend.failed or backend.too_large:
        return fault
    for name, array in wanted.items():
        if not np.array_equal(once[name], again[name], equal_nan=True):
            return f"two {kind} of the same are not the same"
        if fault := (_wrong_picture if kind == "pictures" else _wrong_array)(once[name], array):
            return f"its {kind} are wrong by {fault} ({name})"
    return ""


def _wrong_picture(found: np.ndarray, wanted: np.ndarray) -> str:
    """By how much a picture is wrong; "" where it is not."""
    found, wanted = (np.nan_to_num(each.astype(np.float64), nan=-2, posinf=-1, neginf=-3) for each in (found, wanted))
    difference = np.abs(found - wanted) / np.maximum(np.abs(wanted), 1)
    wrong = difference.mean() > MEAN or (difference > CLOSE).mean() > MANY
    return f"{difference.max():.2g}" if wrong else ""


def _wrong_array(found: np.ndarray, wanted: np.ndarray) -> str:
    """By how much an array is wrong; "" where it is not."""
    error = np.linalg.norm(found.astype(np.float64) - wanted) / max(float(np.linalg.norm(wanted)), 1e-12)
    return "" if error < STRAY else f"{100 * error:.2g} %"


def _model(look: Appearance, n: int = N, small: float = 0.0) -> GaussianModel:
    return made_model(look, n, small)


def _in_small_buffers(work: Work) -> Work:
    """The same work, for which a GPU has to do with buffers of NARROW bytes."""
    def narrow(backend: CPU) -> dict[str, np.ndarray]:
        with backend.device.narrow(NARROW) if isinstance(backend, GPU) else nullcontext():
            return work(backend)
    return narrow


def _nothing(share: float) -> None:
    """Nobody is told."""


# pictures


def _scene(camera: Camera, copies: int = 1) -> list[ViewedInstance]:
    """An object with a decoder, and copies of one without."""
    plain, decoded = _model(SH(1)), _model(made_decoder())
    places = [np.eye(4) for _ in range(copies + 1)]
    for number, place in enumerate(places):
        place[:3, 3] = 0.1 * number, -0.2 * number, 0.3 * number
    return [Instance(model, place, TIME, name=str(number)).viewed(camera)
            for number, (model, place) in enumerate(zip([decoded, *[plain] * copies], places, strict=True))]


def _picture(backend: CPU, camera: Camera, triangles: np.ndarray | None = None, copies: int = 1) -> dict[str, np.ndarray]:
    """All that a picture may hold."""
    instances = _scene(camera, copies)
    objects = [instance.identity for instance in instances[:2]]
    layout = Layout(instances, True, {"shares": shares(instances, objects)}, triangles is not None)
    buffers = backend.draw(instances, camera, layout, PROBES, _nothing, triangles)
    found = {"colour": backend.colour(buffers, layout, camera), "alpha": buffers.alpha, **buffers.sums, **buffers.probes}
    if triangles is not None:
        found["held"] = buffers.held
    return {name: np.array(backend.numpy(array)) for name, array in found.items()}


def _behind_a_triangle(backend: CPU) -> dict[str, np.ndarray]:
    return _picture(backend, made_camera(96, 64), TRIANGLE) | {"surface": np.array(backend.surface(TRIANGLE, made_camera(96, 64)))}


def _sorted_by_pixel_and_blurred(backend: CPU) -> dict[str, np.ndarray]:
    camera = made_camera(48, 32)
    instances = _scene(camera)
    exposure = Exposure(-2, 2, steps=2, aperture=Aperture(0.1, 2.0, samples=2))
    objects = [instance.identity for instance in instances]
    found = backend.expose(exposure, instances, camera, True, _nothing, TRIANGLE, objects, True)
    return {name: np.array(backend.numpy(array)) for name, array in zip(("colour", "alpha", "held", "shares"), found, strict=True)}


# training


def _gradients(backend: CPU, look: Appearance, camera: Camera, n: int = N) -> dict[str, np.ndarray]:
    """The loss, its gradients and the statistics of density control, of a view."""
    model = _model(look, n)
    decoder = {name: getattr(look, name) for name in DECODER if hasattr(look, name)}
    parameters = {name: backend.array(array) for name, array in (model.arrays | decoder).items()}
    statistics = SimpleNamespace(**{name: backend.zeros((n,)) for name in ("gradient", "absolute", "seen", "radius")})
    seen, rng = backend.zeros((n,)), np.random.default_rng(3)
    stored = rng.integers(0, 256, (camera.height, camera.width, 3), np.uint8)
    weight = backend.array(rng.uniform(0.5, 1, stored.shape[:2]).astype(np.float32))
    least = backend.array(rng.uniform(size=stored.shape) < 0.2)
    backend.begin_step()
    picture = backend.forward(parameters, model, camera, TIME, True)
    goal = backend.picture(stored.astype(np.float32) / 255, stored)
    loss = backend.compare(picture, goal, weight, np.array([0.2, 0.3, 0.4], np.float32), 0.2, 0.01, 1.0, least)
    sides = [backend.forward(parameters, model, camera, TIME + apart) for apart in (0.05, -0.05)]
    three = np.array([0.2, 0.3, 0.4], np.float32)
    agreement = backend.agreement(picture, goal, weight, least, three, 1 + three, three, sides, 0.1, 0.5, 0.1)
    depth = backend.array(np.full(stored.shape[:2], 1e-4, np.float32))
    found = backend.backward(picture, loss.rgb, loss.alpha, depth, statistics=statistics, emphasis=loss.emphasis, seen=seen)
    found = backend.backward(picture, loss.rgb, loss.alpha, into=found)
    values = backend.end_step(loss.values, agreement)()
    if values is None:
        raise Failure("it finds more splats in a picture that it has drawn before")
    return {"loss": values[0], "agreement": values[1], "drawn": np.array(backend.numpy(seen))} | {
        name: np.array(backend.numpy(array)) for name, array in (found | vars(statistics)).items()}


def _step(backend: CPU) -> dict[str, np.ndarray]:
    """What follows the gradients, each on random numbers: penalties, anchors, Adam, and MCMC's terms and random moves."""
    rng, model = np.random.default_rng(4), _model(SH(1))
    parameters = {name: backend.array(array.copy()) for name, array in model.arrays.items()}
    slopes = {name: backend.array(rng.normal(0, 1, array.shape).astype(np.float32)) for name, array in model.arrays.items()}
    rows = backend.rows(backend.array((np.arange(N) % 2).astype(np.float32)))
    target = backend.array(np.where(np.arange(N)[:, None] % 3 == 0, np.nan, 0.5 * model.features).astype(np.float32))
    moved = backend.array(np.arange(N) % 5)
    since = backend.steps_since(rows, moved, 9)
    found = {"since": since, "count": backend.count(rows)}
    weights = np.linspace(0, 2, 3 * model.basis.terms)
    for reading in ("mean", "group"):
        norm = MotionNorm(None, 100 * weights, 2.0, 1e-2, reading)
        found[f"penalty {reading}"] = backend.motion_penalty(norm, parameters["motion"], slopes["motion"], 0.3, since)
    backend.anchor(parameters["features"], target, slopes["features"], rows, 2.0)
    backend.mcmc_penalty(parameters, slopes, 1000.0, 1000.0, 2.0)
    tensors = [(backend.zeros(model.arrays[name].shape), slopes[name], *(backend.zeros(model.arrays[name].shape) for _ in range(2)),
                backend.zeros((N,), np.int32), 1e-2, 0.1, name == "scale") for name in ("motion", "scale", "opacity", "features")]
    backend.adam(rows, tensors, (0.9, 0.999), moved, 9)
    backend.adam(rows, tensors, (0.9, 0.999), moved, 10)
    found |= {f"Adam's {i} of {j}": array for i, tensor in enumerate(tensors) for j, array in enumerate(tensor[:5])} | {"moved": moved}
    return {name: np.array(backend.numpy(array)) for name, array in found.items()} | {"random moves": _moves(backend, model)}


def _moves(backend: CPU, model: GaussianModel) -> np.ndarray:
    """Whether MCMC's random moves are as large as they should be: the random numbers themselves are each backend's own."""
    arrays = dict(model.arrays) | {"opacity": np.full(N, -8, np.float32)}
    parameters = {name: backend.array(array.copy()) for name, array in arrays.items()}
    backend.mcmc_noise(parameters, 2.0, (1, 2))
    size = np.linalg.norm(backend.numpy(parameters["position"]) - model.position, axis=1)
    wanted = 2.0 / (1 + np.exp(-SHARPNESS * (1 - 1 / (1 + np.exp(8.0)) - GATE))) * np.sqrt(np.exp(4.0 * model.scale).sum(1))
    return np.array([abs(np.sqrt(np.mean((size / wanted) ** 2)) - 1) < 0.2, np.isfinite(size).all()])


WORKS: dict[str, tuple[Work, ...]] = {
    "pictures": (lambda backend: _picture(backend, made_camera(96, 64), copies=7),  # more Gaussians than are scanned at once
                 _behind_a_triangle, _in_small_buffers(lambda backend: _picture(backend, STRIP)), _sorted_by_pixel_and_blurred),
    "gradients": (lambda backend: _gradients(backend, SH(1), made_camera(96, 64)),
                  lambda backend: _gradients(backend, made_decoder(), made_camera(96, 64)),
                  _in_small_buffers(lambda backend: _gradients(backend, made_decoder(), STRIP, 720))),
    "steps": (_step,),
}
"""The works by what they compute."""

# SPDX-License-Identifier: GPL-3.0-or-later
"""Backends refuse arrays that do not belong together before a kernel sees them: each array of each operation, one at a time."""
from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.kernels.parameters import DECODER
from fastgs_blender.kernels.protocol import MotionNorm
from fastgs_blender.util.backends import load_backend

N, CAMERA = 24, fg.Camera(40, 30, 32, 32, 20, 15, np.eye(4))


@pytest.fixture(params=["cpu", "gpu"])
def backend(request):
    return load_backend("cpu") if request.param == "cpu" else request.getfixturevalue("gpu")


@pytest.fixture
def calls(backend, make_model, rng):
    """Operation -> arguments by name with which it works."""
    model = make_model(rng, N, appearance="sigmoid")
    arrays = dict(model.arrays) | {name: getattr(model.appearance, name) for name in DECODER}
    pixels, terms = (CAMERA.height, CAMERA.width), model.basis.terms

    def some(*shape):
        return backend.array(rng.uniform(0.1, 0.9, shape).astype(np.float32))

    def parameters(*names):
        return {name: backend.array(arrays[name].copy()) for name in names or arrays}

    picture = backend.forward(parameters(), model, CAMERA, 0.4)
    least = backend.array(np.ones((*pixels, 3), bool))
    rows = backend.rows(backend.array(np.ones(N, np.float32)))
    image, other = rng.random((6, 8, 3), np.float32), rng.random((5, 7, 3), np.float32)
    return {
        "forward": {"parameters": parameters(), "template": model, "camera": CAMERA, "t": 0.4},
        "compare": {"picture": picture, "target": some(*pixels, 3), "weight": some(*pixels), "background": np.ones(3, np.float32),
                    "dssim": 0.2, "opaque_weight": 0.1, "share": 1.0, "least": least},
        "agreement": {"picture": picture, "target": some(*pixels, 3), "weight": some(*pixels), "least": least,
                      "background": np.ones(3, np.float32), "gain": np.ones(3), "bias": np.zeros(3), "sides": [picture, picture],
                      "apart": 0.1, "solid": 0.9, "outlier": 0.1},
        "over": {"picture": picture, "background": np.ones(3, np.float32)},
        "backward": {"picture": picture, "rgb": some(*pixels, 3), "alpha": some(*pixels), "depth": some(*pixels), "emphasis": some(*pixels),
                     "seen": some(N), "into": parameters(),
                     "statistics": SimpleNamespace(gradient=some(N), absolute=some(N), seen=some(N), radius=some(N))},
        "steps_since": {"rows": rows, "moved": backend.zeros((N,), np.int64), "step": 1},
        "motion_penalty": {"norm": MotionNorm(None, np.ones(3 * terms), 1.0, 0.1, "mean"), "motion": some(N, terms, 3),
                           "gradient": some(N, terms, 3), "scale": 1.0, "since": some(N)},
        "anchor": {"features": some(N, 9), "target": some(N, 9), "gradient": some(N, 9), "rows": rows, "strength": 1.0},
        "mcmc_penalty": {"parameters": parameters("opacity", "scale"), "gradients": parameters("opacity", "scale"), "opacity_weight": 1.0,
                   "scale_weight": 1.0, "extent": 1.0},
        "mcmc_noise": {"parameters": parameters("opacity", "scale", "rotation", "position"), "reach": 1.0, "key": (1,)},
        "adam": {"rows": rows, "tensors": [(*(some(N, 3) for _ in range(4)), backend.zeros((N,), np.int32), 0.1, 0.0, False)],
                 "betas": (0.9, 0.999), "moved": backend.zeros((N,), np.int64), "step": 1},
        "surface": {"triangles": rng.normal(size=(4, 3, 3)), "camera": CAMERA},
        "nearest": {"points": rng.normal(size=(9, 3)), "turns": [np.eye(3)], "count": 2, "leaf": 4},
        "project_points": {"xyz": rng.normal(size=(9, 3)), "camera": CAMERA},
        "sweep": {"image": image, "others": [(other, np.eye(3), np.zeros(3))], "planes": np.ones((2, 3)), "outside": 1.0, "reach": 1},
        "vote": {"xyz": rng.normal(size=(9, 3)), "rgb": np.ones((9, 3)), "camera": CAMERA, "image": image, "depth": image[..., 0].copy(),
                 "cost": image[..., 0].copy(), "near": 0.1, "alike": 0.1, "sure": 1.0,
                 "agree": np.zeros(9, int), "against": np.zeros(9, int)},
        "resample": {"image": image, "positions": np.ones((4, 5, 2), np.float32)},
    }


def places(value, path=()):
    """The paths to all arrays among arguments."""
    inner = vars(value) if isinstance(value, SimpleNamespace) else value
    if isinstance(inner, dict | list | tuple):
        items = inner.items() if isinstance(inner, dict) else enumerate(inner)
        for key, each in items:
            if key != "rows":  # a form of the backend's own
                yield from places(each, (*path, key))
    elif hasattr(value, "shape"):
        yield path


def changed(value, path, change):
    """The arguments with change(array) at a path."""
    if not path:
        return change(value)
    key, *rest = path
    if isinstance(value, SimpleNamespace):
        return SimpleNamespace(**changed(vars(value), path, change))
    if isinstance(value, dict):
        return value | {key: changed(value[key], rest, change)}
    return type(value)(changed(each, rest, change) if k == key else each for k, each in enumerate(value))


def test_arrays_of_a_wrong_shape(backend, calls):
    def larger(array):
        shape = (*(size + 1 for size in array.shape), 2)
        return np.zeros(shape, array.dtype) if isinstance(array, np.ndarray) else backend.zeros(shape, array.dtype)

    for name, given in calls.items():
        getattr(backend, name)(**given)
        wrong = list(places(given))
        assert wrong
        for path in wrong:
            with pytest.raises(AssertionError, match="instead of"):
                getattr(backend, name)(**changed(given, path, larger))


def test_parameters_of_another_model(backend, calls):
    given = calls["forward"]
    with pytest.raises(AssertionError, match="another kind"):
        backend.forward(**given | {"parameters": {name: array for name, array in given["parameters"].items() if name != "motion"}})

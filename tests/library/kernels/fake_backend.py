# SPDX-License-Identifier: GPL-3.0-or-later
"""A backend for tests whose arrays NumPy cannot touch: it lends the CPU's kernels, and records what it is asked for."""
from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from types import SimpleNamespace

import numpy as np

from fastgs_blender.kernels.protocol import Comparison, ForwardPass, TrainingBackend
from fastgs_blender.rendering.layout import Buffers
from fastgs_blender.training.core.statistics import Statistics
from fastgs_blender.util.backends import load_backend

METHODS = frozenset(name for name in dir(TrainingBackend) if not name.startswith("_"))
ON_HOST = {"numpy", "read", "begin_step", "end_step", "front_to_back", "thinnest", "spread", "painted", "view_box", "posed",
           "contributing", "nearest", "project_points", "sweep", "vote", "resample", "measure_stages"}
"""Methods whose results are NumPy's."""


class Buffer:
    """An array of the fake backend: nothing can be computed with it, and nothing of it can be read."""

    __slots__ = ("_values",)
    __array_ufunc__ = None

    def __init__(self, values):
        self._values = np.array(values)

    def __array__(self, *args, **kwargs):
        raise AssertionError("a backend's array was turned into a NumPy array without numpy()")

    def __bool__(self):
        raise AssertionError("a backend's array was asked whether it is true")


def wrapped(value):
    """The CPU's result in arrays of the fake backend."""
    if isinstance(value, np.ndarray):
        buffer = Buffer(())
        buffer._values = value
        return buffer
    if isinstance(value, tuple):
        return tuple(wrapped(each) for each in value)
    if isinstance(value, dict):
        return {key: wrapped(each) for key, each in value.items()}
    if isinstance(value, (ForwardPass, Comparison, Buffers)):
        return replace(value, **{field.name: wrapped(getattr(value, field.name)) for field in fields(value) if field.name != "state"})
    return value


def unwrapped(value):
    """What the fake backend was given, in the CPU's arrays."""
    if isinstance(value, Buffer):
        return value._values
    if isinstance(value, (list, tuple)):
        return type(value)(unwrapped(each) for each in value)
    if isinstance(value, dict):
        return {key: unwrapped(each) for key, each in value.items()}
    if isinstance(value, Statistics):
        return SimpleNamespace(**{name: unwrapped(each) for name, each in vars(value).items()})
    if is_dataclass(value) and isinstance(value, (ForwardPass, Comparison, Buffers)):
        return replace(value, **{field.name: unwrapped(getattr(value, field.name)) for field in fields(value) if field.name != "state"})
    return value


class FakeBackend:
    """Offers what the protocol names and nothing else; calls: the names of the methods called, in their order."""

    def __init__(self):
        self.calls = []

    def __getattr__(self, name):
        if name not in METHODS:
            raise AttributeError(f"{name} is not in the protocol")
        return lambda *args, **options: self._call(name, args, options)

    def _call(self, name, args, options):
        self.calls.append(name)
        if name == "array":
            return Buffer(args[0])  # a copy, as a device has one
        if name in ("numpy", "read", "end_step"):
            assert all(isinstance(array, Buffer) for array in args), "what is no array of the backend was read from it"
            copies = [array._values.copy() for array in args]
            if name == "end_step":
                return lambda: copies
            return copies[0] if name == "numpy" else copies
        result = getattr(load_backend("cpu"), name)(*unwrapped(args), **unwrapped(options))
        return result if name in ON_HOST else wrapped(result)

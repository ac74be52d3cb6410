# SPDX-License-Identifier: GPL-3.0-or-later
"""The registry of rendering and training backends: their names, and how each is loaded.

Nothing outside kernels/ imports a backend's modules; it asks here.  What a backend must offer is kernels/protocol.py.  A backend is
loaded by name on first use, because one may need what is not installed (numba).
"""
from __future__ import annotations

import importlib
import logging
import os

from .errors import FastGSError

MODULES = {"cpu": "kernels.cpu.backend", "reference": "rendering.oracle"}
"""The module of each backend, whose BACKEND is the backend; relative to this library."""
GPU = "kernels.gpu.backend"
"""The module whose named() gives the backend "gpu" ("gpu:PART": on the adapter whose name holds PART)."""

loaded: dict[str, object] = {}
"""Backends by name, as far as they have been used."""


def load_backend(name: str = "auto"):
    """The backend of that name, an object as kernels/protocol.py describes it; "auto" is "cpu", or "reference" without numba.  "gpu" is
    the best GPU, "gpu:PART" the one whose name holds PART.

    Raises FastGSError for an unknown name, ImportError where the backend's packages are not installed.
    """
    if name in loaded:
        return loaded[name]
    if name == "auto":
        try:
            loaded[name] = load_backend("cpu")
        except ImportError:
            logging.getLogger(__package__).warning("numba is not installed: rendering with NumPy, which is slow.")
            loaded[name] = load_backend("reference")
    elif name in MODULES:
        loaded[name] = _module(MODULES[name]).BACKEND
    elif isinstance(name, str) and name.partition(":")[0] == "gpu":
        loaded[name] = _module(GPU).named(name.partition(":")[2])
    else:
        raise FastGSError(f"the backend {name!r} is unknown; there are auto, {', '.join(MODULES)}, gpu.")
    return loaded[name]


def choose_device(device: str | None = None) -> tuple[str, str]:
    """(the name of the backend, a remark or "") of a device: auto (a GPU that has passed its self-test, else the CPU; the remark says why),
    cpu, gpu, or a part of a GPU's name; None: $FASTGS_DEVICE, or auto.  Raises FastGSError where there is no such device."""
    device = device or os.environ.get("FASTGS_DEVICE") or "auto"
    if device == "cpu":
        return "auto", ""
    try:
        choice = _module("kernels.gpu.choice")
    except ImportError:  # without numba
        return "auto", ""
    return choice.choose(device)


def describe_devices() -> dict:
    """The GPUs of this machine, tested, as JSON values; "auto": the name of the one that `auto` means, or None and the reason."""
    return _module("kernels.gpu.choice").describe()


def _module(name: str):
    return importlib.import_module(f"{__package__.rpartition('.')[0]}.{name}")

# SPDX-License-Identifier: GPL-3.0-or-later
"""The registry of rendering and training backends: their names, and how each is loaded.

Nothing outside kernels/ imports a backend's modules; it asks here.  What a backend must offer is kernels/protocol.py.  A backend is
loaded by name on first use, because one may need what is not installed (numba).
"""
from __future__ import annotations

import importlib
import logging

from .errors import FastGSError

MODULES = {"cpu": "kernels.cpu.backend", "reference": "rendering.oracle"}
"""The module of each backend, whose BACKEND is the backend; relative to this library."""

loaded: dict[str, object] = {}
"""Backends by name, as far as they have been used."""


def load_backend(name: str = "auto"):
    """The backend of that name, an object as kernels/protocol.py describes it; "auto" is "cpu", or "reference" without numba.

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
        loaded[name] = importlib.import_module(f"{__package__.rpartition('.')[0]}.{MODULES[name]}").BACKEND
    else:
        raise FastGSError(f"the backend {name!r} is unknown; there are auto, {', '.join(MODULES)}.")
    return loaded[name]

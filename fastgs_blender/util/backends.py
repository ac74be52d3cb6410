# SPDX-License-Identifier: GPL-3.0-or-later
"""The registry of rendering and training backends: their names, and how each is loaded.

Nothing outside kernels/ imports a backend's modules; it asks here.  What a backend must offer is kernels/protocol.py.  A backend is
loaded by name on first use, because one may need what is not installed (numba).
"""
import logging
import os
from collections.abc import Callable
from types import ModuleType
from typing import Any

from .errors import FastGSError
from .importing import import_quickly
from .threads import thread_count
from .verdicts import Verdict

MODULES = {"cpu": "kernels.cpu.backend", "reference": "rendering.oracle", "gpu": "kernels.gpu.backend"}
"""The module of each backend, relative to this library: its BACKEND is the backend.  A module that offers several has named(part) instead,
which gives the backend "NAME:PART" and, of an empty part, the one called "NAME"."""

loaded: dict[str, Any] = {}
"""Backends by name, as far as they have been used."""


def load_backend(name: str = "auto") -> Any:
    """The backend of that name, an object as kernels/protocol.py describes it; "auto" is "cpu", or "reference" without numba.  "gpu" is
    the best GPU, "gpu:PART" the one whose name holds PART.

    Raises FastGSError for an unknown name, ImportError where the backend's packages are not installed.
    """
    kind, _, part = name.partition(":") if isinstance(name, str) else ("", "", "")
    if isinstance(name, str) and name in loaded:
        return loaded[name]
    if isinstance(name, str) and name == "auto":
        try:
            loaded[name] = load_backend("cpu")
        except ImportError as error:
            logging.getLogger(__package__).warning("numba cannot be imported (%s): rendering with NumPy, which is slow.", error)
            loaded[name] = load_backend("reference")
        return loaded[name]
    module = _module(MODULES[kind]) if kind in MODULES else None
    if module is not None and hasattr(module, "named"):
        loaded[name] = module.named(part)
    elif module is not None and name == kind:
        loaded[name] = module.BACKEND
    else:
        raise FastGSError(f"the backend {name!r} is unknown; there are auto, {', '.join(MODULES)}.")
    return loaded[name]


def choose_device(device: str | None = None, examine: Callable[..., Verdict | None] | None = None) -> tuple[str, str]:
    """(the name of the backend, a remark or "") of a device: auto, cpu, gpu, or a part of a GPU's name; None: $FASTGS_DEVICE, or auto.

    auto is a GPU that has passed its self-test and was faster than the CPU there, else the CPU.  The remark says which auto has taken
    and why, and why a GPU that was named is not used.  Raises FastGSError where there is no such device.

    examine  (adapter) -> its Verdict, None where it has not been tested.  Without it: a self-test here, where that has not been done
             (kernels/gpu/choice.py)
    """
    device = device or os.environ.get("FASTGS_DEVICE") or "auto"
    if device == "cpu":
        return "auto", ""
    try:
        choice = _module("kernels.gpu.choice")
    except ImportError:  # without numba
        return "auto", ""
    return choice.choose(device, examine)


def describe_devices(part: str = "", test: bool = True, again: bool = False, tell: Callable[[str], None] = lambda text: None) -> dict:
    """The GPUs whose name holds a text, as JSON values; "auto": the name of the one that `auto` means, or None; the "reason".

    test   test those that have not been; else their verdict is None.  again: test the others once more
    tell   is told which GPU is being tested
    """
    return _module("kernels.gpu.choice").describe(part, test, again, tell)


def stored_verdict(adapter: Any) -> Verdict | None:
    """The Verdict of an adapter as examine() of choose_device() is given it; None where it has not been tested."""
    return _module("kernels.gpu.choice").known(adapter)


def real_name(backend: str) -> str:
    """The name of a backend, where "auto" is given: of that which "auto" is here."""
    if backend != "auto":
        return backend
    chosen = load_backend(backend)
    return next(name for name in ("cpu", "reference") if loaded.get(name) is chosen)


def describe_backend(name: str) -> str:
    """Where a backend computes, for people."""
    gpu = name.partition(":")[2] or name if name.startswith("gpu") else ""
    return gpu or f"the processor, {thread_count()} threads"


def failure_of(name: str) -> str:
    """Why a GPU's backend has left its work to the CPU, as a part of a sentence; "" where it has not."""
    return getattr(loaded.get(name), "failed", None) or ""


def take_overflow(name: str) -> str:
    """Why the last picture that did not fit on a GPU did not, as a part of a sentence; "" where all did.  It is forgotten by this."""
    backend = loaded.get(name)
    reason = getattr(backend, "too_large", "")
    if backend is not None and reason:
        backend.too_large = ""
    return reason


def try_again() -> None:
    """Let GPUs that have failed be used again."""
    for name in [name for name in loaded if failure_of(name)]:
        del loaded[name]


def _module(name: str) -> ModuleType:
    return import_quickly(f"{__package__.rpartition('.')[0]}.{name}")

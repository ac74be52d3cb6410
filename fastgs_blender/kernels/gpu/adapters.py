# SPDX-License-Identifier: GPL-3.0-or-later
"""Lists the GPUs of this machine (WebGPU adapters) and chooses the one to use."""
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from ...util.errors import FastGSError
from .device import Device, Failure

KINDS = {"DiscreteGPU": "graphics card", "IntegratedGPU": "graphics in the processor", "CPU": "software"}
"""WebGPU's kinds of adapters, the best first; others come before software."""
APIS = ("Vulkan", "Metal", "DX12")
"""Those that compute as WebGPU promises; the same adapters through OpenGL would only be found twice."""


@dataclass(frozen=True)
class Adapter:
    """A GPU: its name and driver as its maker calls them, and the interface through which it is reached (Vulkan, Metal or D3D12).

    kind      one of KINDS' values, or "GPU"
    software  whether it is a program on the processor
    largest   bytes of the largest array that it holds; WebGPU does not say how much memory there is
    """

    name: str
    driver: str
    interface: str
    kind: str
    software: bool
    largest: int
    native: Any = field(repr=False, compare=False)

    def open(self) -> Device:
        """The adapter as a Device; each call gives another."""
        return Device(self.native)


@cache
def adapters() -> tuple[Adapter, ...]:
    """All adapters, the best first; raises Failure where wgpu is missing or no driver answers."""
    try:
        import wgpu
        from wgpu.backends.wgpu_native.extras import set_instance_extras
    except ImportError as error:
        raise Failure("the package wgpu is not installed") from error
    except (OSError, RuntimeError) as error:
        raise Failure(f"the package wgpu does not work here: {error}") from error
    with suppress(RuntimeError):  # somebody else in this process has called wgpu before
        set_instance_extras(backends=APIS)
    try:
        with _without_complaints():
            found = [each for each in wgpu.gpu.enumerate_adapters_sync() if not each.info["backend_type"].startswith("OpenGL")]
    except Exception as error:
        raise Failure(f"the drivers do not answer: {error}") from error
    order = list(KINDS)
    order.insert(2, "")
    known = [_adapter(native) for native in found]
    return tuple(sorted(known, key=lambda each: order.index(each.native.info["adapter_type"])
                        if each.native.info["adapter_type"] in order else order.index("")))


@contextmanager
def _without_complaints() -> Iterator[None]:
    """Where nobody is logged in, drivers that look for windows write lines of their own; a folder that holds no windows silences them."""
    name = "XDG_RUNTIME_DIR"
    missing = name not in os.environ and os.name == "posix"
    if missing:
        os.environ[name] = "/nonexistent"
    try:
        yield
    finally:
        if missing:
            del os.environ[name]


def _adapter(native: Any) -> Adapter:
    info, limits = native.info, native.limits
    return Adapter(info["device"], info["description"], info["backend_type"], KINDS.get(info["adapter_type"], "GPU"),
                   info["adapter_type"] == "CPU", min(limits["max-storage-buffer-binding-size"], limits["max-buffer-size"]), native)


def find(part: str) -> Adapter:
    """The adapter whose name holds a text, in small or large letters; "": the best that is no software, in several processes
    (torchrun) that of this one.  Raises FastGSError."""
    try:
        every = adapters()
    except Failure as failure:
        raise FastGSError(f"no GPU can be used: {failure}; use the device cpu.") from failure
    if part:
        found = [each for each in every if part.lower() in each.name.lower()]
        if not found:
            raise FastGSError(f"no GPU is called {part!r}; there are {', '.join(each.name for each in every) or 'none'}.")
        return found[0]
    hardware = [each for each in every if not each.software]
    if not hardware:
        software = f", only the software {', '.join(each.name for each in every)}" if every else ""
        raise FastGSError(f"no GPU was found{software}; use the device cpu.")
    rank = os.environ.get("LOCAL_RANK", "0")
    return hardware[int(rank) % len(hardware) if rank.isdecimal() else 0]

# SPDX-License-Identifier: GPL-3.0-or-later
"""The GPU of this machine for tests, in software too; where there is none, they are skipped, or fail if $FASTGS_NEED_GPU is set."""
from __future__ import annotations

import os
from types import SimpleNamespace

import pytest

from fastgs_blender.kernels.gpu import adapters
from fastgs_blender.kernels.gpu.backend import GPU
from fastgs_blender.kernels.gpu.device import Device, Failure
from fastgs_blender.util import backends


@pytest.fixture(scope="session")
def adapter():
    """The first adapter."""
    try:
        found, reason = adapters.adapters(), "no driver offers one"
    except Failure as failure:
        found, reason = (), str(failure)
    if not found:
        assert not os.environ.get("FASTGS_NEED_GPU"), f"no GPU: {reason}"
        pytest.skip(f"there is no GPU, and none in software (mesa-vulkan-drivers): {reason}")
    return found[0]


@pytest.fixture(scope="session")
def shared_gpu(adapter):
    """The backend on it, for all tests: shaders are compiled once."""
    return backends.load_backend(f"gpu:{adapter.name}")


@pytest.fixture
def gpu(shared_gpu):
    """The same, which a test must leave working."""
    yield shared_gpu
    assert shared_gpu.failed is None


@pytest.fixture
def fresh(shared_gpu, monkeypatch):
    """A backend of its own, which a test may break: fresh.backend, and fresh.name to render with.  It has the other one's shaders."""
    device = Device(shared_gpu.device.adapter, _pipelines=shared_gpu.device._pipelines)
    device.__dict__ |= {name: getattr(shared_gpu.device, name) for name in ("native", "subgroups")}
    backend = GPU(lambda: device)
    monkeypatch.setitem(backends.loaded, "gpu:fresh", backend)
    return SimpleNamespace(backend=backend, name="gpu:fresh")

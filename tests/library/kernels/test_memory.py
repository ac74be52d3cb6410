# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory that arrays of one picture leave to those of the next."""
import numpy as np
import pytest

from fastgs_blender.kernels.cpu import memory


@pytest.fixture(autouse=True)
def nothing_kept(monkeypatch):
    monkeypatch.setattr(memory, "_blocks", [])
    monkeypatch.setattr(memory, "LEAST", 1)


def test_memory_is_used_again_once_nobody_has_a_view_of_it():
    first = memory.empty((100, 3), np.float32, 10)
    part, place = first[50:].T[1], first.ctypes.data
    first[:] = 7
    del first
    other = memory.empty((100, 3), np.float32, 10)
    other[:] = 8
    assert (part == 7).all() and other.ctypes.data != place
    del part
    again = memory.empty((100,), np.float64, 10)  # smaller, of another type
    assert again.ctypes.data == place and again.flags.writeable and again.flags.c_contiguous and again.flags.aligned


def test_little_is_kept(monkeypatch):
    assert memory.empty((100,), np.float32, memory.SPLATS + 1).shape == (100,) and memory.empty((0, 3), np.int32, 5).size == 0
    monkeypatch.setattr(memory, "LEAST", 1000)
    assert memory.empty((100,), np.float32, 10).shape == (100,)  # too small to be worth a search
    assert not memory._blocks
    monkeypatch.setattr(memory, "MOST", 10_000)
    monkeypatch.setattr(memory, "LEAST", 1)
    memory.empty((1000,), np.float64, 10)
    held = memory.empty((1000,), np.float64, 10)
    held[:] = 1
    memory.empty((8000,), np.uint8, 10)
    assert sum(len(block) for block, _ in memory._blocks) <= 10_000 and (held == 1).all()
    memory.empty((100,), np.uint8, 10)
    assert any(len(block) >= 8000 and user() is None for block, user in memory._blocks)  # too large for a hundred bytes

# SPDX-License-Identifier: GPL-3.0-or-later
"""Sorting on the GPU, with subgroups and without."""
from __future__ import annotations

import numpy as np
import pytest

from fastgs_blender.kernels.gpu import shaders
from fastgs_blender.kernels.gpu.device import SUBGROUPS, Device
from fastgs_blender.kernels.gpu.lists import sort


@pytest.fixture
def other(gpu):
    """The same device with none of its shaders."""
    device = Device(gpu.device.adapter)
    device.__dict__["native"] = gpu.device.native
    return device


@pytest.mark.parametrize("subgroups", [False, True])
def test_equal_keys_keep_their_order(other, rng, subgroups):
    if subgroups and SUBGROUPS not in other.native.features:
        pytest.skip("this GPU has no subgroups")
    if not subgroups:
        other.__dict__["subgroups"] = False
    assert other.subgroups == subgroups
    keys = rng.integers(0, 1 << 10, 9000, np.uint32)
    values = sort(other, other.array(keys).buffer, other.array(np.arange(9000, dtype=np.uint32)).buffer, 9000, 10)[1]
    assert np.array_equal(other.read(values, np.uint32, 9000), np.argsort(keys, kind="stable"))
    assert ("subgroupExclusiveAdd" in shaders.source("sort_scatter", other.subgroups)) == subgroups


def test_subgroups_that_are_out_of_order_or_refused_are_not_used(other, monkeypatch):
    source = shaders.source
    for text in ("orderly[lane] = unused.x + select(1u, 0u, lane == 77u);", "this is no shader"):
        begin, end = source("subgroups").split("    orderly[lane]")[0], "\n}\n"
        monkeypatch.setattr(shaders, "source", lambda stage, *given, text=begin + text + end, **more:
                            text if stage == "subgroups" else source(stage, *given, **more))
        other._pipelines.clear()
        other.__dict__.pop("subgroups", None)
        assert not other.subgroups and not other.broken

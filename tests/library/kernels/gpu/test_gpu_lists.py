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
@pytest.mark.parametrize(("count", "bits"), [(1, 4), (9000, 10), (30_000, 32)])
def test_equal_keys_keep_their_order(other, rng, subgroups, count, bits):
    """Blocks that are full or not, digits in one row and in several, up to four passes."""
    if subgroups and SUBGROUPS not in other.native.features:
        pytest.skip("this GPU has no subgroups")
    if not subgroups:
        other.__dict__["subgroups"] = False
    assert other.subgroups == subgroups
    keys = rng.integers(0, 1 << bits, count, np.uint32) & np.uint32(0xf0f0f0f3)  # many are equal
    values = sort(other, other.array(keys).buffer, other.array(np.arange(count, dtype=np.uint32)).buffer, count, bits)[1]
    assert np.array_equal(other.read(values, np.uint32, count), np.argsort(keys, kind="stable"))
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


def test_short_loops_are_written_out():
    text = "//each i 2\na[i] = 0.0;\n    //each j 2\n    b[i] += c[j] * ij;\n    //end\n//end\nrest\n"
    assert " ".join(shaders.repeated(text).split()) == (
        "a[0u] = 0.0; b[0u] += c[0u] * ij; b[0u] += c[1u] * ij; a[1u] = 0.0; b[1u] += c[0u] * ij; b[1u] += c[1u] * ij; rest")
    assert shaders.repeated("//each i 2\nwithout an end\n") == "//each i 2\nwithout an end\n"
    assert all("//each" not in shaders.source(name, QUADS=3, LANES=64, BATCH=128, SMOOTH=False, PER_BAND=0.0)
               for name in ("raster_backward", "colour_backward"))

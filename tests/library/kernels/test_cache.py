# SPDX-License-Identifier: GPL-3.0-or-later
"""A compilation ahead that was stopped is begun again: the cache counts as filled when it came to its end, and not before."""
from __future__ import annotations

import pytest

from fastgs_blender.kernels.cpu import cache, warm


@pytest.mark.slow
def test_the_cache_is_filled_when_compilation_came_to_its_end(tmp_path, monkeypatch):
    monkeypatch.setenv("FASTGS_CACHE_DIR", str(tmp_path))
    assert not cache.is_begun() and not cache.is_filled()
    kernel = cache.folder() / "raster_0" / "raster.rasterise-1.py311.nbi"
    kernel.parent.mkdir(parents=True)
    kernel.touch()
    assert cache.is_begun() and not cache.has_first() and not cache.is_filled()

    def stopped(fraction):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        warm.compile_all(stopped)
    assert cache.has_first() and not cache.is_filled(), "what a first picture needs comes first"
    warm.compile_all()
    assert cache.is_filled()
    cache.clear()
    assert not cache.is_begun() and not cache.is_filled()

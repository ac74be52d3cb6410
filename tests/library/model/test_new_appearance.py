# SPDX-License-Identifier: GPL-3.0-or-later
"""A new appearance is one dataclass, listed once: files, exports and starting points ask it, and no one takes its columns for colours."""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.model.appearance import APPEARANCES, Appearance


@dataclass(frozen=True)
class Logarithms(Appearance):
    """Columns: the logarithms of r, g, b, as for pictures of high dynamic range."""

    name: ClassVar[str] = "logarithms"
    width: ClassVar[int] = 3

    def features_of(self, rgb):
        return np.log(np.maximum(rgb, 1e-6))

    def plain_colours(self, features):
        return np.exp(features)


@pytest.fixture
def model(rng, monkeypatch):
    monkeypatch.setitem(APPEARANCES, Logarithms.name, Logarithms)
    model = random_model(rng, 30, "cubic", temporal="radial")
    return replace(model, appearance=Logarithms(), features=Logarithms().features_of(np.maximum(model.features, 0.01)).astype(np.float32))


def test_our_own_file_keeps_it(model, tmp_path):
    fg.save(model, tmp_path / "m.safetensors")
    again = fg.load(tmp_path / "m.safetensors")
    assert again.appearance == Logarithms()
    np.testing.assert_array_equal(again.features, model.features)


def test_files_of_others_get_plain_colours(model, tmp_path):
    with pytest.warns(fg.LossWarning, match="logarithms.*plain colours"):
        fg.save(model, tmp_path / "m.ply")
    again = fg.load(tmp_path / "m.ply")
    np.testing.assert_allclose(again.appearance.plain_colours(again.features), np.exp(model.features), atol=0.01)
    still = replace(model, basis=fg.Static(), motion=None, temporal_kind=fg.Always(), temporal=None)
    with pytest.warns(fg.LossWarning, match="plain colours"):
        fg.save(still, tmp_path / "still.spz")
    again = fg.load(tmp_path / "still.spz")
    found = np.sort(again.appearance.plain_colours(again.features), axis=0)
    np.testing.assert_allclose(found, np.sort(np.exp(model.features), axis=0), atol=0.02)

# SPDX-License-Identifier: GPL-3.0-or-later
"""GaussianModel checks its arrays when it is made: kernels read them by the widths and codes of its kinds."""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from random_models import random_model

import fastgs_blender as fg


@dataclass(frozen=True)
class TooWide(fg.Polynomial):
    """A basis that gives more weights than it has terms: its kernel index would leave the array."""

    name: ClassVar[str] = "too wide"
    centred: ClassVar[bool] = False

    def weights(self, t):
        return np.ones((*np.shape(t), 9))


@dataclass(frozen=True)
class Flicker(fg.Always):
    """A temporal opacity that no kernel knows."""

    code: ClassVar[int] = 77


@pytest.mark.parametrize(("change", "sentence"), [
    (dict(motion=np.zeros((10, 4, 3))), r"motion.*shape \(10, 3, 3\)"),
    (dict(basis=TooWide()), "3 terms.*weights"),
    (dict(basis="cosine"), "basis of time"),
    (dict(rotation_basis=None), "basis of time"),
    (dict(temporal_kind=Flicker()), "temporal opacity"),
    (dict(temporal_kind=None), "temporal opacity"),
    (dict(appearance="rgb"), "appearance"),
    (dict(position=np.float32(3)), "shape"),
    (dict(position=np.zeros((11, 3))), "shape"),
    (dict(mu_tau=np.zeros((10, 1))), "mu_tau"),
    (dict(axes="XYZ"), "axes"),
])
def test_kinds_and_arrays_that_do_not_fit_are_refused(rng, change, sentence):
    model = random_model(rng, 10, "cubic")
    with pytest.raises(fg.FastGSError, match=sentence):
        replace(model, **change)


@pytest.mark.parametrize("make", [
    lambda: fg.SH(5), lambda: fg.SH(-1), lambda: fg.SH(True), lambda: fg.SH(2.0), lambda: fg.SH("2"),
    lambda: fg.Fourier(-1), lambda: fg.Fourier(10**9), lambda: fg.Fourier(2.5), lambda: fg.Fourier(True), lambda: fg.Fourier(5, np.nan),
    lambda: fg.Fourier(5, 1.0, "0"), lambda: fg.Fourier(5, linear=3),
    lambda: fg.Cosine(-1), lambda: fg.Cosine(10**6), lambda: fg.Cosine(3, np.inf),
    lambda: fg.Polynomial(-1), lambda: fg.Polynomial(33), lambda: fg.Polynomial(1.5),
    lambda: fg.Keyframes(()), lambda: fg.Keyframes((0.0, 0.0)), lambda: fg.Keyframes((0.0, 1e-12)), lambda: fg.Keyframes((1.0, 0.0)),
    lambda: fg.Keyframes((0.0, np.nan)), lambda: fg.Keyframes(tuple(range(100_001))),
    lambda: fg.Raster(blur=np.nan), lambda: fg.Raster(alpha_cut=0.0), lambda: fg.Raster(near="0"), lambda: fg.Raster(antialiased=7),
    lambda: fg.Clip(0), lambda: fg.Clip(2.5), lambda: fg.Clip(10**9), lambda: fg.Clip(5, 0.0), lambda: fg.Clip(5, 24.0, 10**12),
    lambda: fg.Clip(5, 24.0, 0.5), lambda: fg.Clip(5, "24"),
])
def test_numbers_out_of_range_are_refused(make):
    with pytest.raises(fg.FastGSError):
        make()


def test_whole_numbers_may_be_numpys():
    assert fg.SH(np.int64(2)).width == 27 and fg.Fourier(np.int32(3)).terms == 6 and fg.Clip(np.int64(4)).frame_count == 4


def test_a_model_is_described_in_two_lines(rng, make_model):
    for appearance in ("sigmoid", "sh3"):
        lines = repr(make_model(rng, 7, "keys", "line", "radial", appearance)).splitlines()
        assert len(lines) == 2 and max(map(len, lines)) <= 140 and "7 Gaussians" in lines[0] and "radial" in lines[1]

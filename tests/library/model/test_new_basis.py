# SPDX-License-Identifier: GPL-3.0-or-later
"""A new basis of time is one dataclass, listed once: those below are in every place that motion passes through."""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from numpy.polynomial import chebyshev
from random_cameras import random_camera
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.model.basis import Basis
from fastgs_blender.model.fitting import Fit, choose, motion_families
from fastgs_blender.model.joining import Segment, join
from fastgs_blender.model.motion import BASES


@dataclass(frozen=True)
class Bare(Basis):
    """Chebyshev polynomials T_1 .. T_order of 2 t - 1 that state what every basis must, and no more."""

    name: ClassVar[str] = "bare chebyshev"
    order: int = 4

    @property
    def terms(self):
        return self.order

    def weights(self, t):
        inside = 2 * np.asarray(t, np.float64) - 1
        return np.stack([chebyshev.chebval(inside, np.eye(self.order + 1)[k]) for k in range(1, self.order + 1)], -1)

    def rates(self, t):
        inside = 2 * np.asarray(t, np.float64) - 1
        return np.stack([2 * chebyshev.chebval(inside, chebyshev.chebder(np.eye(self.order + 1)[k])) for k in range(1, self.order + 1)], -1)


@dataclass(frozen=True)
class Chebyshev(Bare):
    """The same, offered to training and to fits, and closed under a change of time."""

    name: ClassVar[str] = "chebyshev"
    competes: ClassVar[bool] = True

    @classmethod
    def trained(cls, last):
        return {"chebyshev": (cls, 4)}

    @classmethod
    def fits(cls, first, last):
        return {"chebyshev": [cls]}

    def joined(self, spans):
        return self

    def retimed(self, whole, begin, length, constant, coefficients):
        t = np.linspace(begin, begin + length, 4 * self.order)
        curve = constant[:, None] + np.einsum("sk,nkd->nsd", self.weights((t - begin) / length), coefficients)
        solved = np.einsum("ks,nsd->nkd", Fit.of(whole, t).solve, curve)
        return solved[:, 0], solved[:, 1:]


@pytest.fixture(autouse=True)
def listed(monkeypatch):
    for basis in (Bare, Chebyshev):
        monkeypatch.setitem(BASES, basis.name, basis)


@pytest.fixture
def model(rng):
    return random_model(rng, 60, Chebyshev(5), Bare(2), "radial", "sh1", clip=fg.Clip(30))


def test_it_slices_and_all_backends_render_it(model, rng):
    camera = random_camera(rng, 48, 32, 3.0)
    for t in (0.0, 0.37, 0.9):
        now = fg.slice_model(model, t, cull=False)
        x = 2 * t - 1
        terms = np.array([x, 2 * x**2 - 1, 4 * x**3 - 3 * x, 8 * x**4 - 8 * x**2 + 1, 16 * x**5 - 20 * x**3 + 5 * x])
        np.testing.assert_allclose(now.position, model.position + np.einsum("k,nkd->nd", terms, model.motion), rtol=1e-6)
        after = fg.slice_model(model, t + 1e-6, cull=False)
        np.testing.assert_allclose(now.velocity, (after.position - now.position) / 1e-6, atol=1e-3)
        pictures = [fg.render(model, camera, t, backend=name)["rgb"] for name in ("cpu", "reference")]
        assert pictures[0].max() > 0.1
        np.testing.assert_allclose(*pictures, atol=2e-3)


def test_files_keep_it_or_say_what_they_lose(model, tmp_path):
    fg.save(model, tmp_path / "m.safetensors")
    back = fg.load(tmp_path / "m.safetensors")
    assert back.basis == Chebyshev(5) and back.rotation_basis == Bare(2)
    assert all(np.array_equal(array, model.arrays[name]) for name, array in back.arrays.items())
    with pytest.warns(fg.LossWarning, match=r"motion \(chebyshev, 5 terms\).*cubic"):
        fg.save(model, tmp_path / "m.splatv")


def test_a_file_that_names_it_wrongly_is_refused(model, tmp_path):
    fg.save(model, tmp_path / "m.safetensors")
    (tmp_path / "m.safetensors").write_bytes((tmp_path / "m.safetensors").read_bytes().replace(b'order\\": 5', b'order\\": []'))
    with pytest.raises(fg.FastGSError):
        fg.load(tmp_path / "m.safetensors")


def test_speeds_and_accelerations_follow_from_the_weights():
    basis = Chebyshev(4)
    assert np.allclose(basis.frequency_index(), [1, 4, 9, 16])  # |T_k'| is k^2 at most
    steepest = np.array([k**2 * (k**2 - 1) / 3 * 4 for k in range(1, 5)])  # |T_k''|, for t that runs twice as fast
    assert np.allclose(np.diag(basis.curvature()), steepest / (2 * np.pi) ** 2, rtol=1e-3)
    assert basis.curvature()[0, 0] == 0  # straight motion


@pytest.mark.parametrize("densify_time", ["keep", "random"])
def test_it_trains(densify_time):
    from toy_captures import toy_capture

    from fastgs_blender.training.core.settings import settings
    from fastgs_blender.training.core.start import Start
    from fastgs_blender.training.core.trainer import Trainer
    from fastgs_blender.training.initial.first_model import model_from_points

    capture, store, points = toy_capture()
    chosen = settings(motion="chebyshev", order=3, iterations=60, init_points=80, max_gaussians=160, densify_every=10, densify_from=0.1,
                      warm_up=(), densify_time=densify_time, position_rate=1e-3, motion_rate=2e-3, init_opacity=0.1, preview_every=0)
    trainer = Trainer(capture, store, chosen, Start(model_from_points(points, chosen, capture.clip, capture.axes, capture.extent)))
    losses = [trainer.step() for _ in range(60)]
    model = trainer.final_model({})
    assert model.basis == Chebyshev(3) and np.abs(model.motion).max() > 0
    assert losses[0]["motion_penalty"] == 0 < losses[-1]["motion_penalty"]
    assert np.mean([v["loss"] for v in losses[-10:]]) < 0.8 * np.mean([v["loss"] for v in losses[:10]])


def test_it_is_fitted_by_name_and_competes(rng):
    t = np.linspace(0, 0.98, 50)
    constant, motion = rng.normal(size=(7, 3)), rng.normal(size=(7, 6, 3))
    values = constant + np.einsum("sk,nkd->snd", Chebyshev(6).weights(t), motion)

    def error(fit):
        return np.abs(fit(values)[1] - values).max() / 1e-6

    for name in ("chebyshev", "auto"):
        basis = choose(motion_families(name, t), t, error)
        assert basis == Chebyshev(6)
    found, _ = Fit.of(basis, t)(values)
    np.testing.assert_allclose(found[1:].transpose(1, 0, 2), motion, atol=1e-6)
    with pytest.raises(fg.FastGSError, match="auto, .*chebyshev"):
        motion_families("bare chebyshev", t)


def test_segments_are_joined_where_the_basis_can_be_moved_in_time(rng):
    models = [random_model(rng, 20, Chebyshev(5), "line", "radial") for _ in range(2)]
    parts = [Segment(models[0], 0.0, 0.6), Segment(models[1], 0.5, 0.5)]
    joined = join(parts, fg.Clip(60))
    for i, part in enumerate(parts):
        for u in (0.1, 0.8):
            before = fg.slice_model(part.model, u, cull=False).position
            now = fg.slice_model(joined.take(np.arange(20 * i, 20 * (i + 1))), part.begin + part.length * u, cull=False).position
            np.testing.assert_allclose(now, before, atol=1e-4)
    bare = [replace(part, model=replace(part.model, basis=Bare(5))) for part in parts]
    with pytest.raises(fg.FastGSError, match="'bare chebyshev'.*moved"):
        join(bare, fg.Clip(60))

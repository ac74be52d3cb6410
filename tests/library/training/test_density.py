# SPDX-License-Identifier: GPL-3.0-or-later
"""Density control: what it adds, splits, removes and moves."""
from dataclasses import replace

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.training.core import density
from fastgs_blender.training.core import settings as options


class Rows:
    """An optimiser's rows, without its steps."""

    def __init__(self, model):
        self.arrays, self.begun = {k: v.copy() for k, v in model.arrays.items()}, []

    def take(self, index):
        self.arrays = {k: v[index] for k, v in self.arrays.items()}

    def append(self, arrays):
        self.arrays = {k: np.concatenate([v, arrays[k]]) for k, v in self.arrays.items()}

    def reset(self, name, rows):
        self.begun.append((name, rows))


class Gradients:
    """Statistics in which every Gaussian but the first `calm` wants more."""

    def __init__(self, n, calm=0):
        self.gradient = np.where(np.arange(n) < calm, 0.0, 1.0)
        self.absolute, self.seen, self.radius = self.gradient.copy(), np.ones(n), np.zeros(n)

    def take(self, index):
        for name in ("gradient", "absolute", "seen", "radius"):
            setattr(self, name, getattr(self, name)[index])


def strategy(name, model, centres=None, **choices):
    chosen = options.settings(density=name, iterations=1000, densify_every=100, densify_from=0.0, densify_until=1.0,
                              densify_share=0.5, **choices)
    return density.STRATEGIES[name](chosen, 1.0, model, centres)


@pytest.mark.parametrize("name", density.STRATEGIES)
def test_the_cap_holds_and_only_due_steps_change(rng, make_model, name):
    model = make_model(rng, 60, "cosine", "line", "radial", "sigmoid")
    rows, control = Rows(model), strategy(name, model, max_gaussians=100)
    for iteration in range(95, 1001):
        before = len(rows.arrays["opacity"])
        changed = control.after_step(iteration, rows, Gradients(before), {"position": 1e-4})
        assert changed == (iteration % 100 == 0)
        assert len(rows.arrays["opacity"]) <= 100 and (changed or len(rows.arrays["opacity"]) == before)
    assert len(rows.arrays["opacity"]) > 85
    assert all(np.isfinite(array).all() for array in rows.arrays.values())


def test_splitting_keeps_what_is_there_and_cloning_copies(rng, make_model):
    model = make_model(rng, 40, "cosine", "line", "radial", "sigmoid", size=0.1)
    model.opacity[:] = 2.0
    model.scale[:20] = np.log(1e-3)
    rows, control = Rows(model), strategy("default", model, max_gaussians=10_000)
    control.after_step(100, rows, Gradients(40, calm=10), {})
    assert len(rows.arrays["opacity"]) == 40 + 21  # half of the 40, and one
    old, new = ({k: v[part] for k, v in rows.arrays.items()} for part in (slice(40), slice(40, None)))
    assert np.array_equal(old["position"][:20], model.position[:20])
    assert np.array_equal(new["motion"][0], model.motion[10])
    large = np.flatnonzero(old["scale"][:, 0] != model.scale[:, 0])
    assert (large >= 20).all() and len(large)
    np.testing.assert_allclose(old["scale"][large], model.scale[large] - np.log(1.6), atol=1e-6)


def test_fog_before_a_camera_goes_and_what_it_does_not_draw_stays(rng, make_model):
    """A camera in a wall does not draw its own housing, which is before its near plane and which others see."""
    model = make_model(rng, 30)
    model.opacity[:], model.scale[:] = 3, np.log(0.15)
    model.position[:] = np.repeat([0.5, 1.5, 10], 10)[:, None] * model.raster.near * np.array([0, 0, 1])
    rows = Rows(model)
    strategy("default", model, np.zeros((1, 3))).after_step(100, rows, Gradients(30, calm=30), {})
    np.testing.assert_allclose(np.unique(rows.arrays["position"][:, 2]), np.array([0.5, 10]) * model.raster.near, rtol=1e-6)


def test_faint_gaussians_go(rng, make_model):
    model = make_model(rng, 30)
    model.opacity[:] = np.where(np.arange(30) < 12, -9, 3)
    rows = Rows(model)
    strategy("default", model).after_step(100, rows, Gradients(30, calm=30), {})
    assert len(rows.arrays["opacity"]) == 18


def test_reset_makes_opaque_ones_faint(rng, make_model):
    model = make_model(rng, 30)
    rows = Rows(model)
    strategy("default", model, reset_every=250).after_step(250, rows, Gradients(30), {})
    assert rows.arrays["opacity"].max() <= np.log(0.01 / 0.99) + 1e-6 and rows.begun[0][0] == "opacity"


def test_reborn_gaussians_leave_the_picture_alone(rng, make_model):
    """The dead are moved into a living one: what is seen stays nearly the same."""
    model = make_model(rng, 3, "static", size=0.3, raster=fg.Raster(near=0.0))
    model.position[:] = 0
    model.scale[:] = np.log(0.3)
    model.opacity[:] = [1.0, -9, -9]
    rows = Rows(model)
    strategy("mcmc", model, max_gaussians=3).after_step(100, rows, Gradients(3), {"position": 1e-4})
    camera = fg.Camera(32, 32, 40, 40, 16, 16, [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]])
    before, after = (fg.render(m, camera)["alpha"] for m in (model, replace(model, **rows.arrays)))
    assert rows.arrays["opacity"].min() > -5
    assert np.abs(after - before).max() < 0.06 and after[16, 16] == pytest.approx(before[16, 16], abs=0.02)


@pytest.mark.parametrize("basis", ["cosine", "cubic"])
def test_a_new_temporal_centre_changes_no_course(rng, make_model, basis):
    model = make_model(rng, 20, basis, "line", "radial", "rgb", motion=0.2)
    arrays = {k: v.copy() for k, v in model.arrays.items()}
    density.shift(arrays, rng.uniform(0, 1, 20).astype(np.float32), model)
    for t in (0.1, 0.8):
        a, b = (fg.slice_model(m, t, cull=False) for m in (model, replace(model, **arrays)))
        np.testing.assert_allclose(a.position, b.position, atol=1e-5)
        np.testing.assert_allclose(np.abs((a.rotation * b.rotation).sum(1)), 1, atol=1e-5)

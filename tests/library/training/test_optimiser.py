# SPDX-License-Identifier: GPL-3.0-or-later
"""The optimiser against torch's Adam, and what density control does to its rows."""
from __future__ import annotations

import numpy as np
import pytest
import torch

from fastgs_blender.training.core.optimiser import Optimiser
from fastgs_blender.util import threads

SHAPES = {"position": (3,), "motion": (10, 3), "opacity": (), "empty": (0, 4)}


def arrays(rng, n=50):
    values = {name: rng.normal(size=(n, *shape)).astype(np.float32) for name, shape in SHAPES.items()}
    return {**values, "w1": rng.normal(size=(6, 12)).astype(np.float32)}


def gradients(rng, optimiser, size=1e-3):
    return {name: (size * rng.normal(size=array.shape)).astype(np.float32) for name, array in optimiser.arrays.items()}


RATES = {"position": 1e-2, "motion": 1e-3 / np.repeat(np.arange(1.0, 11), 3), "opacity": 5e-2, "empty": 1.0, "w1": 1e-3}


def test_it_is_adam_where_every_row_is_seen(rng):
    ours = Optimiser(arrays(rng))
    theirs = {name: torch.tensor(array, dtype=torch.float64, requires_grad=True) for name, array in ours.arrays.items() if array.size}
    columns = list(theirs["motion"].detach().reshape(50, 30).T)  # a rate for each column: a group for each
    groups = [{"params": [column.requires_grad_()], "lr": rate} for column, rate in zip(columns, RATES["motion"])]
    groups += [{"params": [tensor], "lr": RATES[name]} for name, tensor in theirs.items() if name != "motion"]
    adam = torch.optim.Adam(groups, eps=1e-15)
    for _ in range(30):
        g = gradients(rng, ours)
        ours.step(g, np.arange(50), RATES)
        for name, tensor in theirs.items():
            tensor.grad = torch.tensor(g[name], dtype=torch.float64)
        for column, grad in zip(columns, g["motion"].reshape(50, 30).T):
            column.grad = torch.tensor(grad, dtype=torch.float64)
        adam.step()
    result = {name: tensor.detach().numpy() for name, tensor in theirs.items()}
    result["motion"] = np.stack([column.detach().numpy() for column in columns], 1).reshape(50, 10, 3)
    for name, value in result.items():
        np.testing.assert_allclose(ours.arrays[name], value, rtol=1e-5, atol=2e-6)


def test_rows_that_were_not_seen_stay_and_keep_their_own_count(rng):
    one, two = Optimiser(values := arrays(rng)), Optimiser({k: v.copy() for k, v in values.items()})
    before = {k: v.copy() for k, v in values.items()}
    some, rates = np.array([3, 17, 40]), {k: v for k, v in RATES.items() if k != "w1"}
    for _ in range(5):
        for optimiser, other in ((one, 1), (two, 0)):
            optimiser.step(gradients(rng, optimiser), np.array([other]), rates)  # meanwhile something else
        g = gradients(rng, one)
        one.step(g, some, rates)
        two.step(g, some, rates)
    others = np.setdiff1d(np.arange(2, 50), some)
    for name in SHAPES:
        assert np.array_equal(one.arrays[name][others], before[name][others])
        assert np.array_equal(one.arrays[name][some], two.arrays[name][some])
    assert not np.array_equal(one.arrays["position"][some], before["position"][some])
    assert np.array_equal(one.arrays["w1"], before["w1"])


@pytest.mark.parametrize("period", [1, 4, 16])
def test_what_is_seldom_seen_goes_as_far_as_by_the_usual_adam(period):
    """Which moves every row in every step, by what it remembers: torch's."""
    ours = Optimiser({"position": np.zeros((2, 3), np.float32)})
    theirs = torch.zeros(3, requires_grad=True)
    adam = torch.optim.Adam([theirs], lr=1e-3, eps=1e-15)
    for step in range(4000):
        seen = step % period == 0
        theirs.grad = torch.full((3,), float(seen))
        adam.step()
        ours.step({"position": np.ones((2, 3), np.float32)}, np.array([0] if seen else [1]), {"position": 1e-3})
    np.testing.assert_allclose(ours.arrays["position"][0], theirs.detach().numpy(), rtol=0.1)


def test_what_hardly_any_slope_pulls_at_stays_where_it_is(rng):
    """A floor is torch's epsilon; arrays without one have next to none."""
    ours = Optimiser(arrays(rng))
    before = {name: array.copy() for name, array in ours.arrays.items()}
    theirs = torch.tensor(before["position"], requires_grad=True)
    adam = torch.optim.Adam([theirs], lr=RATES["position"], eps=2e-3)
    for _ in range(20):
        g = gradients(rng, ours)
        g["position"][:25] *= 1e-3
        ours.step(g, np.arange(50), RATES, floors={"position": 2e-3})
        theirs.grad = torch.tensor(g["position"])
        adam.step()
    np.testing.assert_allclose(ours.arrays["position"], theirs.detach().numpy(), rtol=1e-5, atol=2e-6)
    far = {name: np.abs(ours.arrays[name] - before[name]).reshape(50, -1).mean(1) / RATES[name] for name in ("position", "opacity")}
    assert far["position"][:25].max() < 0.1 < far["position"][25:].min() and far["opacity"].min() > 0.1


def test_it_knows_how_long_a_row_has_waited(rng):
    optimiser = Optimiser(arrays(rng, 3))
    for rows in ([0, 1], [0], [0]):
        optimiser.step(gradients(rng, optimiser), np.array(rows), RATES)
    since = optimiser.steps_since_update
    assert since(np.arange(3)).tolist() == [1, 3, 4] and since(np.array([1])).tolist() == [0, 3, 0]
    with optimiser.on_host() as host:
        host.append({name: host.arrays[name][:1] for name in SHAPES})
        host.take(np.array([3, 1]))
    assert optimiser.steps_since_update(np.arange(2)).tolist() == [1, 3]


def test_what_is_no_number_moves_nothing(rng):
    optimiser = Optimiser(arrays(rng))
    before = optimiser.arrays["position"].copy()
    g = gradients(rng, optimiser)
    g["position"][3] = np.nan, np.inf, 0.0
    optimiser.step(g, np.arange(50), RATES)
    assert np.array_equal(optimiser.arrays["position"][3], before[3]) and np.isfinite(optimiser.arrays["position"]).all()


def test_rows_come_and_go_with_their_moments(rng):
    optimiser = Optimiser(arrays(rng))
    optimiser.step(gradients(rng, optimiser), np.arange(50), RATES)
    mean, w1 = optimiser.means["motion"].copy(), optimiser.means["w1"].copy()
    with optimiser.on_host() as rows:
        rows.take(np.array([7, 2, 2]))
        rows.append({name: np.ones((2, *shape), np.float32) for name, shape in SHAPES.items()})
    assert len(optimiser) == 5 and all(array.dtype == np.float32 and array.flags.c_contiguous for array in optimiser.arrays.values())
    assert np.array_equal(optimiser.means["motion"][:3], mean[[7, 2, 2]]) and not optimiser.means["motion"][3:].any()
    assert np.array_equal(optimiser.means["w1"], w1)
    assert optimiser.counts["position"].tolist() == [1, 1, 1, 0, 0]
    with optimiser.on_host() as rows:
        rows.reset("motion", np.array([1]))
    assert not optimiser.squares["motion"][1].any() and optimiser.counts["motion"].tolist() == [1, 0, 1, 0, 0]
    assert optimiser.squares["position"][1].any()
    before = optimiser.arrays["position"].copy()
    optimiser.step(gradients(rng, optimiser), np.arange(5), RATES)
    step = np.abs(optimiser.arrays["position"] - before)[3:]  # the first step of a row is as long as its rate
    np.testing.assert_allclose(step, RATES["position"], rtol=1e-3)


def test_its_state_continues_it_to_the_byte_on_any_number_of_threads(rng):
    one = Optimiser(arrays(rng))
    one.step(gradients(rng, one), np.arange(0, 50, 2), RATES)
    two = Optimiser.restored({name: array.copy() for name, array in one.state().items()})
    try:
        for count, optimiser in ((1, one), (3, two)):
            threads.set_threads(count)
            numbers = np.random.default_rng(5)
            for _ in range(3):
                optimiser.step(gradients(numbers, optimiser), np.arange(10, 50), RATES)
    finally:
        threads.set_threads(0)
    assert all(np.array_equal(array, two.state()[name]) for name, array in one.state().items())
    assert one.state().keys() == two.state().keys()

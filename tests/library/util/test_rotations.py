# SPDX-License-Identifier: GPL-3.0-or-later
"""Rotations: quaternions and matrices against each other, at the places where formulas divide by little."""
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastgs_blender.util import rotations

HALF_TURNS = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, 0.6, 0.8, 0], [1e-9, 0, 0.6, 0.8]])


def draw(seed, *shape):
    return rotations.unit(np.random.default_rng(seed).normal(size=(*shape, 4)))


@given(st.integers(0, 10_000))
def test_matrices_and_quaternions_are_inverse_to_each_other(seed):
    q = draw(seed, 3, 2)
    matrices = rotations.to_matrices(q)
    assert matrices.shape == (3, 2, 3, 3)
    assert np.allclose(matrices @ np.swapaxes(matrices, -1, -2), np.eye(3), atol=1e-12) and np.all(np.linalg.det(matrices) > 0)
    back = rotations.from_matrices(matrices)
    assert np.all(back[..., 0] >= 0)
    assert np.abs(np.abs((back * q).sum(-1)) - 1).max() < 1e-12


@pytest.mark.parametrize("q", HALF_TURNS)
def test_half_turns_have_a_quaternion_too(q):
    assert abs(abs(rotations.from_matrices(rotations.to_matrices(rotations.unit(q))) @ q) - 1) < 1e-12


def test_a_matrix_turns_a_vector_as_its_quaternion_does():
    p, q = draw(1), draw(2)
    v = np.array([0.3, -1.2, 0.7])
    turned = rotations.multiply(rotations.multiply(q, np.array([0.0, *v])), rotations.inverse(q))
    assert np.allclose(turned[1:], rotations.to_matrices(q) @ v)
    assert np.allclose(rotations.to_matrices(rotations.multiply(p, q)), rotations.to_matrices(p) @ rotations.to_matrices(q))


def test_normalising_leaves_no_zero_and_hides_no_nan():
    q = rotations.unit(np.array([[0.0, 0, 0, 0], [0, 3, 0, 4], [np.nan, 0, 0, 1]], np.float32))
    assert q[0].tolist() == [1, 0, 0, 0] and np.allclose(q[1], [0, 0.6, 0, 0.8]) and np.isnan(q[2]).any()


def test_logarithm_and_exponential():
    v = np.array([[0.2, -0.4, 0.1], [0, 0, 0], [0, 0, 3.0]])
    assert np.allclose(rotations.log(rotations.exp(v)), v)
    quarter = rotations.exp(np.array([0, 0, np.pi / 4]))
    assert np.allclose(rotations.to_matrices(quarter) @ [1, 0, 0], [0, 1, 0])


def test_slerp_goes_along_the_arc_at_constant_speed():
    p, q = np.array([1.0, 0, 0, 0]), rotations.exp(np.array([0, 0.5, 0]))
    for share in (0.0, 0.25, 1.0):
        assert np.allclose(rotations.slerp(p, q, share), rotations.exp(np.array([0, 0.5 * share, 0])))


def test_neighbours_get_one_sign_and_the_first_stays():
    steady = rotations.exp(np.linspace(0, 3, 40)[:, None, None] * draw(3, 5)[:, 1:])
    flipped = steady * np.random.default_rng(4).choice([-1.0, 1.0], (40, 5, 1))
    assert np.array_equal(rotations.one_sign(flipped), steady * np.sign((flipped[:1] * steady[:1]).sum(-1, keepdims=True)))

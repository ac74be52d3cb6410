# SPDX-License-Identifier: GPL-3.0-or-later
"""The similarity of pairs of places."""
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from stitched_scenes import motion

import fastgs_blender as fg


@given(st.integers(0, 10_000), st.floats(-3, 3), st.floats(0.01, 100), st.floats(0, 1000), st.integers(3, 7))
def test_it_is_found_exactly(seed, angle, scale, far, count):
    rng = np.random.default_rng(seed)
    places = rng.normal(size=(count, 3))
    if np.linalg.svd(places - places.mean(0), compute_uv=False)[1] < 0.2:
        return
    true = motion(rng, angle, far, scale)
    found = fg.similarity(places, places @ true[:3, :3].T + true[:3, 3])
    assert found.matrix == pytest.approx(true, rel=1e-7, abs=1e-7 * max(far, scale)) and found.scale == pytest.approx(scale)
    assert found.residual < 1e-9 * max(far, scale) + 1e-9 and np.linalg.det(found.matrix[:3, :3]) > 0


@given(st.integers(0, 10_000))
def test_without_scale_it_turns_and_moves_only(seed):
    rng = np.random.default_rng(seed)
    places = np.eye(3) + 0.1 * rng.normal(size=(3, 3))
    found = fg.similarity(places, 3 * places + 1, scale=False)
    turn = found.matrix[:3, :3]
    assert turn @ turn.T == pytest.approx(np.eye(3), abs=1e-9) and found.residual > 0.5


def test_no_other_is_nearer_in_the_mean():
    rng = np.random.default_rng(5)
    places, targets = rng.normal(size=(2, 5, 3))
    found = fg.similarity(places, targets)
    for _ in range(60):
        other = motion(rng, 0.02 * rng.normal(), 0.02, np.exp(0.02 * rng.normal())) @ found.matrix
        left = np.sqrt((np.square(places @ other[:3, :3].T + other[:3, 3] - targets).sum(1)).mean())
        assert left >= found.residual - 1e-12


@pytest.mark.parametrize(("places", "say"), [
    ([[0, 0, 0], [1, 0, 0], [2, 0, 0.001]], "on a line"), ([[1, 1, 1]] * 3, "on a line"), ([[0, 0, 0], [1, 0, 0]], "three pairs"),
    ([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], "finite"), ([[0, 0], [1, 0], [0, 1]], "three pairs")])
def test_pairs_that_tell_nothing_are_refused(places, say):
    with pytest.raises(fg.FastGSError, match=say):
        fg.similarity(places, places)

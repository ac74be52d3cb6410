# SPDX-License-Identifier: GPL-3.0-or-later
"""Which features of two pictures match."""
import numpy as np

import fastgs_blender as fg
from fastgs_blender.training.initial.features import Features, matches

SIDEWAYS = np.eye(4) + [[0, 0, 0, -1], [0] * 4, [0] * 4, [0] * 4]
"""World to camera of one that stands beside the other: what both see lies in the same row of their pictures."""


def features(places, kinds, pose) -> Features:
    return Features(np.array(places, float), np.eye(128, dtype=np.float32)[kinds], fg.Camera(64, 48, 60, 60, 32, 24, pose))


def test_a_match_lies_by_its_line():
    a = features([(10, 10), (30, 20), (50, 40)], [0, 1, 2], np.eye(4))
    b = features([(5, 10.9), (20, 22.0), (40, 40)], [0, 1, 2], SIDEWAYS)
    assert matches(a, b, 1.5).tolist() == [[0, 0], [2, 2]]
    assert matches(a, b, np.inf).tolist() == [[0, 0], [1, 1], [2, 2]]


def test_of_features_that_look_the_same_the_first_matches():
    a = features([(10, 10), (40, 10), (30, 20)], [0, 0, 1], np.eye(4))
    b = features([(5, 10), (20, 20)], [0, 1], SIDEWAYS)
    for within in (1.5, np.inf):
        assert matches(a, b, within).tolist() == [[0, 0], [2, 1]]

# SPDX-License-Identifier: GPL-3.0-or-later
"""Velocities of starting points, from the clouds of the moments beside theirs, and the motion of the Gaussians that begin with them."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.captures.capture import Points
from fastgs_blender.model.slicing import slice_model
from fastgs_blender.training.core.settings import settings
from fastgs_blender.training.initial.first_model import MOVING, model_from_points
from fastgs_blender.training.initial.velocity import displacements, in_motion

LAST = 11 / 12
CLIP = fg.Clip(frame_count=12)


def gone(xyz, t):
    """Two coloured boxes: one rises at speed 1, the other turns about z, half a turn per unit of time."""
    angle = np.pi * t * (xyz[:, 0] > 1.5)
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = xyz[:, 0] - 3, xyz[:, 1]
    turned = np.stack([3 + cos * x - sin * y, sin * x + cos * y, xyz[:, 2]], 1)
    return np.where(xyz[:, :1] > 1.5, turned, xyz + [0, 0, t])


def cloud(seed, t, count=1500):
    """Points on the boxes at a time, others for each seed, and where each of these was at time 0."""
    first = np.random.default_rng(seed).uniform(-1, 1, (count, 3))
    first[np.arange(count), np.arange(count) % 3] = np.where(np.arange(count) % 6 < 3, -1, 1)
    first[count // 2:, 0] += 3
    rgb = np.where(first[:, :1] > 1.5, [0.8, 0.3, 0.3], [0.2, 0.3, 0.8]) + 0.2 * np.sin(3 * first)
    return Points(gone(first, t), rgb, np.full(count, t)), first


def test_a_cloud_is_followed_into_another_ones_points():
    (now, first), (then, _) = cloud(1, 0.0), cloud(2, 0.15)
    step = displacements(now, then)
    truth = gone(first, 0.15) - first
    missed = np.linalg.norm(step - truth, axis=1)
    for rows in (first[:, 0] < 1.5, first[:, 0] > 1.5):
        assert np.median(missed[rows]) < 0.5 * np.median(np.linalg.norm(truth[rows], axis=1))


def test_velocities_are_the_mean_of_both_sides_and_none_where_pictures_show_nothing():
    clouds = [cloud(k, 0.1 * k)[0] for k in range(3)]

    def seen(points, k):
        return points.rgb[:, 0] < 0.6

    middle = in_motion(clouds, 1, seen)
    hidden = middle.rgb[:, 0] >= 0.6
    assert hidden.any() and not middle.velocity[hidden].any()
    rises = middle.xyz[:, 0] < 1.5
    np.testing.assert_allclose(np.median(middle.velocity[rises], 0), [0, 0, 1], atol=0.3)
    np.testing.assert_array_equal(middle.xyz, clouds[1].xyz)


def test_too_few_points_stay_at_rest():
    clouds = [cloud(k, 0.1 * k, 60)[0] for k in range(2)]
    assert not in_motion(clouds, 0, lambda points, k: np.ones(len(points), bool)).velocity.any()


@pytest.mark.parametrize("motion", ["cosine", "fourier", "fourier+linear", "paper", "polynomial", "keyframes"])
@pytest.mark.parametrize("moment", [1 / 12, 5 / 12, 8 / 12])
def test_gaussians_begin_at_their_points_with_their_velocities(motion, moment):
    speed = np.array([[1.0, -2, 0.5], [0, 0, 0]])
    points = Points(np.array([[1.0, 2, 3], [4, 5, 6]]), np.full((2, 3), 0.5), np.full(2, moment), velocity=speed)
    model = model_from_points(points, settings("draft", motion=motion), CLIP, "RDF", 1.0)
    np.testing.assert_allclose(slice_model(model, moment, cull=False).position, points.xyz, atol=1e-5)
    np.testing.assert_allclose(np.exp(-model.temporal[:, 0] / 2), [MOVING, settings().init_duration], rtol=1e-5)
    for t in (moment - 0.04, moment + 0.04):
        moved = slice_model(model, t, cull=False).position - points.xyz
        np.testing.assert_allclose(moved, (t - moment) * speed, atol=0.35 * 0.04 * 2)


def test_points_without_a_time_or_a_velocity_stay_at_rest():
    points = Points(np.zeros((2, 3)), np.full((2, 3), 0.5), np.array([np.nan, 0.5]), velocity=np.array([[1.0, 0, 0], [0, 0, 0]]))
    assert not model_from_points(points, settings(), CLIP, "RDF", 1.0).motion.any()
    assert not model_from_points(replace(points, velocity=None), settings(), CLIP, "RDF", 1.0).motion.any()

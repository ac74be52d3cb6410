# SPDX-License-Identifier: GPL-3.0-or-later
"""What moves fast is other Gaussians at each moment, as training makes it, and is one thing all the same."""
from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.selecting.grow import grow
from fastgs_blender.selecting.joins import joins
from fastgs_blender.selecting.succession import successions

FRAMES, EACH, FALL = 24, 3, np.array([0, 0, -4.0])
RED, GREEN = (0.8, 0.25, 0.2), (0.2, 0.55, 0.3)


def thrown(rng, start, velocity, colour, count=80):
    """A ball of 0.17, of other Gaussians every third frame, between which it goes farther than it is large."""
    centre = np.repeat((np.arange(0, FRAMES, EACH) + 0.5 * (EACH - 1)) / FRAMES, count)
    out = rng.normal(size=(len(centre), 3))
    out *= 0.17 * rng.uniform(0.6, 1, (len(out), 1)) / np.linalg.norm(out, axis=1, keepdims=True)
    place = out + start + np.outer(centre, velocity) + np.outer(centre**2, FALL / 2)
    return place, velocity + np.outer(centre, FALL), np.full((len(centre), 3), colour), centre


def filmed(*balls, life=0.03, seed=0):
    """A model of balls over a floor that lasts, and which of these things each Gaussian is; `life` is where opacity is 1/e of the most."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-2, 2, 40), np.linspace(-1, 1, 20))
    floor = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1)
    parts = [(floor, np.zeros_like(floor), np.full(floor.shape, 0.5), np.full(len(floor), 0.5)), *(thrown(rng, *ball) for ball in balls)]
    place, speed, colour, centre = (np.concatenate(each) for each in zip(*parts))
    label = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
    lives = np.where(label == 0, 10.0, life)
    model = fg.GaussianModel(position=place, motion=speed[:, None], rotation=np.tile([1.0, 0, 0, 0], (len(place), 1)),
                             features=colour + rng.normal(0, 0.02, colour.shape), scale=np.full(place.shape, np.log(0.03)),
                             opacity=np.full(len(place), 3.0), basis=fg.Polynomial(1), mu_tau=centre, temporal_kind=fg.Radial(),
                             temporal=-2 * np.log(lives)[:, None], clip=fg.Clip(FRAMES, 24.0))
    return model, label


def strokes(model, label, moment):
    """Half of what a ball is at one moment, and a quarter of all the other things that are seen then."""
    seen, number = abs(model.mu_tau - (moment * EACH + 1) / FRAMES) < 1e-6, np.arange(len(label))
    return seen & (label == 1) & (number % 2 == 0), (label != 1) & (number % 4 == 0) & (seen | (label == 0))


@pytest.mark.parametrize("moment", [0, 3, 7])
def test_a_thrown_ball_is_selected_at_all_moments(moment):
    model, label = filmed(((-1.6, 0, 1.0), (3.2, 0.3, 2.4), RED))
    assert np.mean(grow(model, *strokes(model, label, moment)) == (label == 1)) > 0.99


@pytest.mark.parametrize("colour", [GREEN, RED])
def test_what_it_passes_is_not_selected(colour):
    """Two balls that meet half-way, and of which each begins anew there."""
    model, label = filmed(((-1.6, 0.05, 1.0), (3.2, 0, 2.4), RED), ((1.6, -0.05, 1.0), (-3.2, 0, 2.4), colour))
    assert np.mean(grow(model, *strokes(model, label, 2)) == (label == 1)) > 0.99


def test_only_short_lives_follow_each_other():
    """Each pair is of one ball and of two moments; a floor that flickers is held by what lasts of it."""
    model, label = filmed(((-1.6, 0, 0.2), (3.2, 0, 2.4), RED))
    flickers = (label == 0) & (np.arange(len(label)) % 5 == 0)
    model = dataclasses.replace(model, temporal=np.where(flickers, -2 * np.log(0.03), model.temporal[:, 0])[:, None],
                                mu_tau=np.where(flickers, np.random.default_rng(0).uniform(0, 1, len(label)), model.mu_tau))
    found = joins(model)
    usual = np.full(len(label), 0.05)
    ends, near = successions(model, found.ends[:0], np.zeros(0, np.float32), usual, 0.05)
    assert (flickers[ends].any(1)).any()
    lasting = np.stack([np.flatnonzero(flickers), np.flatnonzero(flickers) + 1], 1)
    ends, near = successions(model, lasting, np.ones(len(lasting), np.float32), usual, 0.05)
    assert len(ends) > 500 and (label[ends] == 1).all() and (np.diff(model.mu_tau[ends]) != 0).all()
    assert len(np.unique(ends, axis=0)) == len(ends) and (near >= 0).all()
    lasts = dataclasses.replace(model, temporal=np.full((len(label), 1), -2 * np.log(10.0)))
    assert not len(successions(lasts, found.ends, found.near, usual, 0.05)[0])

# SPDX-License-Identifier: GPL-3.0-or-later
"""Exposures that change while cameras film: what training finds and takes out."""
from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from toy_captures import Pixels, toy_capture

from fastgs_blender.evaluation.training_record import corrections, corrections_entry, sentence
from fastgs_blender.training.core.settings import settings
from fastgs_blender.training.core.trainer import Trainer
from fastgs_blender.training.initial.fades import fades_of
from fastgs_blender.training.initial.start import start


class Still:
    """A store of pictures [48, 64] of a wall before which a dark square walks, as cameras see it whose exposures change: rates [3] by view,
    the logarithm of the gain at the end of the clip; the light, which all cameras show, becomes 1.2 times as bright."""

    def __init__(self, rates):
        self.rates, self.wall = rates, np.random.default_rng(0).uniform(0.1, 0.7, (48, 64, 3))

    def pixels(self, shot):
        rgb = self.wall * 1.2**shot.t
        rgb[10:30, int(40 * shot.t):int(40 * shot.t) + 20] = 0.2
        noise = np.random.default_rng([shot.frame, int(shot.view[3:])]).normal(0, 0.01, rgb.shape)
        return Pixels(np.float32((rgb + noise) * np.exp(np.multiply(self.rates.get(shot.view, 0.0), 2 * shot.t - 1))))


def test_exposures_that_change_while_cameras_film_are_found_and_taken_out():
    capture, _, points = toy_capture(frames=8, views=5)
    capture = replace(capture, points=points)
    rates = {"cam02": np.array([0.1, 0.12, 0.08]), "cam04": np.array([-0.04, -0.04, -0.04]), "cam03": np.array([0.005, 0.0, 0.0])}
    store, chosen = Still(rates), settings(init="file", backdrop=0)
    fades = fades_of(capture, store, chosen)
    assert fades == pytest.approx(np.array([np.zeros(3), rates["cam02"], np.zeros(3), rates["cam04"]]), abs=0.008)
    assert (fades[[0, 2]] == 0).all(), "steady cameras are left as they are"
    said = []
    began = start(capture, store, chosen, said.append)
    assert np.array_equal(began.fades, fades) and "cam02 by 1.2" in said[0] and "cam03" not in said[0]
    found = Trainer(capture, store, chosen, began).cameras.response
    assert found.colours_differ and found.facts()["exposures"]["cam02"]["fade"] == pytest.approx(rates["cam02"], abs=0.008)
    first, last = capture.shots[2], capture.shots[-3]  # of cam02
    filmed = [store.pixels(shot).rgb for shot in (first, last)]
    steady = [found.pixels(shot, store.pixels(shot)).rgb for shot in (first, last)]
    change = [np.median(rgb[1] / rgb[0]) for rgb in (filmed, steady)]
    light = 1.2 ** (7 / 8)
    assert change[0] > light + 0.15 and change[1] == pytest.approx(light, rel=0.02)
    model = SimpleNamespace(provenance=corrections_entry(found.facts()))
    assert ": cam02, cam04" in sentence(corrections(model))
    off = start(capture, store, settings(init="file", backdrop=0, exposures="off"), said.append)
    assert off.fades is None and start(capture, Still({}), chosen, said.append).fades is None


def test_too_little_to_see_tells_no_change_of_exposure():
    """A few moments, a dark picture, and a camera that moves."""
    rates = {"cam02": np.full(3, 0.2)}
    assert not fades_of(toy_capture(frames=4, views=5)[0], Still(rates), settings()).any()
    capture, dark = toy_capture(frames=8, views=5)[0], Still(rates)
    moved = replace(capture, shots=[replace(s, camera=replace(s.camera, world_to_camera=s.camera.world_to_camera + 0.01 * s.frame * np.eye(
        4, k=3))) for s in capture.shots])
    assert fades_of(capture, dark, settings())[1] == pytest.approx(rates["cam02"], abs=0.01) and not fades_of(moved, dark, settings()).any()
    dark.wall *= 0.05
    assert not fades_of(capture, dark, settings()).any()

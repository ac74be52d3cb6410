# SPDX-License-Identifier: GPL-3.0-or-later
"""Training that begins with a model gives its motion as many coefficients as it needs."""
from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from toy_captures import toy_capture, write_capture

import fastgs_blender as fg
from fastgs_blender.model.fitting import Fit
from fastgs_blender.training.core.model import motion_basis
from fastgs_blender.training.core.settings import settings
from fastgs_blender.training.initial.warm_start import following
from fastgs_blender.training.run.plan import read_plan, suited


@pytest.fixture(scope="module")
def swinging(tmp_path_factory):
    """A capture of 16 frames with a model of a card that swings and turns faster than the usual number of coefficients follows."""
    capture, _, _ = toy_capture(frames=16, views=4)
    corners = np.array([(-0.5, 0, -0.5), (0.5, 0, -0.5), (0.5, 0, 0.5), (-0.5, 0, 0.5)])
    frames = []
    for k in np.arange(64) / 4:
        angle = 0.9 * np.sin(0.7 * k)
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        frames.append(corners @ turn.T + (0.8 * np.sin(1.1 * k), 0, 0.3 * np.cos(0.9 * k)))
    model, _ = fg.bake(np.stack(frames), [[0, 1, 2], [0, 2, 3]], count=500)
    path = tmp_path_factory.mktemp("swing") / "bake.safetensors"
    fg.save(replace(model, axes=capture.axes, clip=capture.clip), path)
    return replace(capture, model=path), fg.load(path)


def test_motion_that_is_known_is_followed(swinging):
    """Between frames too; without a model, or with an order that was asked for, nothing changes."""
    capture, model = swinging
    usual = settings()
    chosen = following(capture, usual)
    assert chosen.rotation_degree > usual.rotation_degree and following(capture, chosen) == chosen
    rest = {"order", "rotation_degree"}
    assert {k: v for k, v in chosen.to_dict().items() if k not in rest} == {k: v for k, v in usual.to_dict().items() if k not in rest}

    def off(with_these):
        basis, t = motion_basis("cosine", with_these.order, capture.clip), np.linspace(0, 15 / 16, 61)
        places = np.stack([fg.slice_model(model, moment).position for moment in t])
        return np.linalg.norm(Fit.of(basis, t[::2])(places[::2])[1] - places[::2], axis=-1).max()

    assert off(chosen) < 0.3 * off(usual) and chosen.order < 16
    still = replace(model, motion=np.zeros_like(model.motion))
    fg.save(still, capture.model.parent / "still.safetensors")
    for options, given in ((dict(order=5), capture), (dict(init="random"), capture), ({}, replace(capture, model=None)),
                           (dict(motion="paper"), capture), ({}, replace(capture, model=capture.model.parent / "still.safetensors"))):
        assert following(given, settings(**options)) == settings(**options)


def test_a_run_follows_its_capture_s_model_and_goes_on_without_it(swinging, tmp_path):
    """Its record says with how many coefficients and steps, whatever becomes of the model; what was asked for by name stays."""
    capture, _ = swinging
    source = write_capture(tmp_path / "capture", frames=16, views=4)
    shutil.copy(capture.model, source / "bake.safetensors")
    opened, draft = fg.open_capture(source), settings("draft")
    chosen = suited(draft, opened)
    assert chosen.order == following(opened, draft).order > 0 and chosen.iterations < draft.iterations
    assert suited(draft, opened, ("order", "iterations", "rotation_degree", "warm_up")) == draft
    plain = replace(opened, model=None)
    assert replace(suited(draft, plain), slope_floor=draft.slope_floor) == draft
    assert suited(settings(), opened).iterations == settings().iterations
    parts = suited(settings(segment_frames=8, segment_overlap=2), opened)
    assert 0 < parts.order < chosen.order and parts.rotation_degree > 1

    few = dict(iterations=3, max_gaussians=200, init_points=100, warm_up=(), preview_every=0, exposures="off", clocks="off", device="cpu")
    model = fg.train(source, tmp_path / "run", preset="draft", **few)
    assert model.basis.terms == chosen.order and model.rotation_basis.degree == chosen.rotation_degree
    assert json.loads(model.provenance["settings"])["order"] == chosen.order
    assert read_plan(tmp_path / "run").settings.order == chosen.order

    (source / "bake.safetensors").unlink()
    (tmp_path / "run" / "model.safetensors").unlink()
    assert fg.train(None, tmp_path / "run", resume=True, device="cpu").basis.terms == chosen.order

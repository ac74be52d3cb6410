# SPDX-License-Identifier: GPL-3.0-or-later
"""What was written can be read: every model that save() accepts, in every format, is loaded again."""
from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from random_models import APPEARANCES, random_model

import fastgs_blender as fg
from fastgs_blender.formats import STATIC, writable
from fastgs_blender.model.gaussians import AXES
from fastgs_blender.model.surroundings import Backdrop, Surroundings, Viewpoint

SMALL = st.floats(-2, 2, width=32)
SERIES = st.one_of(
    st.builds(fg.Fourier, st.integers(0, 4), SMALL, SMALL, st.booleans()), st.builds(fg.Cosine, st.integers(0, 7), SMALL, SMALL))
TIMES = st.lists(st.integers(-3, 12), min_size=2, max_size=6, unique=True).map(lambda found: tuple(x / 7 for x in sorted(found)))
KEYS = st.builds(fg.Keyframes, TIMES, st.sampled_from(["linear", "catmull-rom"]))
BASIS = st.one_of(st.just(fg.Static()), SERIES, st.builds(fg.Polynomial, st.integers(0, 6)), KEYS)
STRAIGHT = fg.Fourier(0, 1.0, 0.0, linear=True)
"""What a bake writes of an object that moves along a straight line."""


SIDE, FOCAL = st.integers(1, 4000), st.floats(1, 1e4)
VIEW = st.builds(Viewpoint, width=SIDE, height=SIDE, fx=FOCAL, fy=FOCAL, name=st.text(max_size=5))
SURROUNDINGS = st.builds(Surroundings, st.one_of(st.none(), st.builds(Backdrop, st.tuples(SMALL, SMALL, SMALL), st.floats(1e-3, 1e3))),
                         st.lists(VIEW, max_size=3).map(tuple), st.one_of(st.none(), VIEW))
NEVER = {"changing rgb", "changing sh1"}
"""Appearances that change, so that no model with them is still."""


@st.composite
def models(draw, still: bool = False) -> fg.GaussianModel:
    rng = np.random.default_rng(draw(st.integers(0, 999)))
    kinds = dict(basis=draw(BASIS), rotation_basis=draw(BASIS),
                 temporal=draw(st.sampled_from(["always", "radial", "window", "radial-window"])),
                 appearance=draw(st.sampled_from(APPEARANCES)))
    if still:
        kinds = dict(appearance=draw(st.sampled_from([name for name in APPEARANCES if name not in NEVER])))
    model = random_model(
        rng, draw(st.sampled_from([40, 3, 1, 0])), **kinds, surroundings=draw(SURROUNDINGS),
        extent=draw(st.sampled_from([1e-12, 1e-3, 1.0, 1e4, 1e12])), clip=fg.Clip(draw(st.integers(1, 300)), draw(st.floats(0.01, 500)),
                                                                             draw(st.integers(-99, 10**9))),
        axes=draw(st.sampled_from(AXES)), colour_space=draw(st.sampled_from(["srgb", "linear"])),
        provenance=draw(st.dictionaries(st.text(max_size=5), st.text(max_size=9), max_size=2)))
    model.opacity *= np.float32(draw(st.sampled_from([0, 1, 1e4])))
    model.rotation *= np.float32(draw(st.sampled_from([0, 1, 1e-30])))
    return model


def saved(model, path, compress=None) -> list[str]:
    """Save a model; returns what is lost."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        fg.save(model, path, compress)
    return [str(each.message) for each in caught]


@pytest.mark.parametrize(("extension", "compress"), [
    *((extension, None) for extension in writable() if extension != ".html"),  # web pages are played, and not read
    (".safetensors", "fine"), pytest.param(".safetensors", "small", marks=pytest.mark.slow)])
def test_every_model_that_is_saved_is_loaded_again(tmp_path, pxr, few_pictures, extension, compress):
    path, accepted = tmp_path / f"round trip{extension}", []

    still = models(still=True)

    @settings(max_examples=2 if compress else 15)  # compression renders each model many times
    @example(model=random_model(np.random.default_rng(1), 40, appearance="sh1"))
    @given(model=still if any(extension in known.extensions for known in STATIC) else st.one_of(models(), still))
    def holds(model):
        for left in (path, path.with_suffix(".pt")):
            left.unlink(missing_ok=True)
        try:
            saved(model, path, compress)
        except fg.FastGSError:
            return  # said before anything is written
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", fg.LossWarning)
            loaded = fg.load(path)
        assert len(loaded) <= len(model)
        accepted.append(len(loaded))

    holds()
    assert any(accepted), "nothing was written, so the test shows nothing"


@pytest.mark.slow
@settings(max_examples=40)
@pytest.mark.parametrize("extension", [".safetensors", ".ply"])
@given(model=models(), t=st.floats(0, 1))
@example(model=random_model(np.random.default_rng(1), 5, basis=STRAIGHT), t=0.75)
@example(model=random_model(np.random.default_rng(1), 5, basis=fg.Cosine(0), temporal="radial"), t=0.5)
def test_what_a_format_holds_without_loss_is_where_it_was(tmp_path_factory, extension, model, t):
    path = tmp_path_factory.getbasetemp() / f"held{extension}"
    if not len(model) or saved(model, path):
        return
    loaded = fg.load(path)
    before, after = (fg.slice_model(each, t, cull=False) for each in (model, loaded))
    np.testing.assert_allclose(after.position, before.position, rtol=1e-5, atol=1e-6 * np.abs(before.position).max())
    np.testing.assert_allclose(after.opacity, before.opacity, atol=1e-6)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of a model: through cutting, joining and files."""
from __future__ import annotations

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.formats.native import KEY
from fastgs_blender.util.tensor_files import open_tensors, write_tensors


@pytest.fixture
def model(rng):
    made = random_model(rng, 203, "paper", "line", "radial", motion=0.1)
    return replace(made, parts=fg.Parts.of({"Ball": np.arange(203) % 3 == 0, "Höhe": np.arange(203) < 50}))


def test_parts_follow_their_gaussians(model, tmp_path):
    """Each Gaussian's place tells which it is."""
    def known(other):
        row = np.array([np.abs(model.position - place).max(1).argmin() for place in other.position], int)
        return other.parts.names == model.parts.names and np.array_equal(other.parts.bits, model.parts.bits[row])

    for index in (slice(5, 90, 2), np.arange(203)[::-1], np.arange(203) > 120, []):
        part = model.take(index)
        assert part.parts.bits.shape == (len(part), 2) and known(part)
    still = fg.slice_model(model, 0.3)
    np.testing.assert_array_equal(fg.freeze(model, 0.3).parts["Ball"], model.parts["Ball"][still.index])
    fg.save(model, tmp_path / "a.safetensors")
    again = fg.load(tmp_path / "a.safetensors")
    assert again.parts.names == ("Ball", "Höhe") and known(again)
    fg.save(replace(model, parts=fg.Parts()), tmp_path / "b.safetensors")
    assert (tmp_path / "b.safetensors").stat().st_size < (tmp_path / "a.safetensors").stat().st_size
    assert fg.load(tmp_path / "b.safetensors").parts.names == ()


def test_parts_of_several_models(model):
    other = replace(model, parts=fg.Parts.of({"Ball": np.ones(203, bool), "Hat": np.zeros(203, bool)}))
    both = fg.concatenate([model, other, replace(model, parts=fg.Parts())])
    assert both.parts.names == ("Ball", "Höhe", "Hat")
    np.testing.assert_array_equal(both.parts["Ball"], np.concatenate([model.parts["Ball"], np.ones(203, bool), np.zeros(203, bool)]))
    plain = replace(model, parts=fg.Parts())
    assert len(fg.concatenate([plain, plain])) == 406 and not fg.concatenate([plain, plain]).parts.names


@pytest.mark.slow
def test_compressed_files_keep_parts(model, tmp_path, few_pictures):
    """Their Gaussians come in another order: a part that is a half of space stays one."""
    half = replace(model, parts=fg.Parts.of({"Left": model.position[:, 0] < 0.0}))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fg.save(half, tmp_path / "c.safetensors", compress=0.05)
    again = fg.load(tmp_path / "c.safetensors")
    clear = np.abs(again.position[:, 0]) > 0.05
    assert np.mean(again.parts["Left"][clear] == (again.position[clear, 0] < 0)) > 0.95 and clear.sum() > 50  # places are rounded


def test_other_formats_say_that_parts_are_lost(model, tmp_path):
    with pytest.warns(fg.LossWarning, match="Ball, Höhe"):
        fg.save(fg.freeze(model, 0.2), tmp_path / "a.ply")


@pytest.mark.parametrize(("header", "array"), [
    (["A"], np.zeros((3, 1), np.uint8)), ({"A": 1}, np.zeros((26, 1), np.uint8)), (["A", "A"], np.zeros((26, 2), np.uint8)),
    ([3], np.zeros((26, 1), np.uint8)), (["A"], np.zeros((26, 1), np.float32)), (["A"], None)])
def test_damaged_parts_are_refused(model, tmp_path, header, array):
    fg.save(replace(model, parts=fg.Parts()), tmp_path / "a.safetensors")
    with open_tensors(tmp_path / "a.safetensors") as file:
        arrays = {name: file.read(name) for name in file.entries} | ({} if array is None else {"parts": array})
        about = json.loads(file.metadata[KEY]) | {"parts": header}
    write_tensors(tmp_path / "b.safetensors", arrays, {KEY: json.dumps(about)})
    with pytest.raises(fg.FastGSError, match="b.safetensors"):
        fg.load(tmp_path / "b.safetensors")


@pytest.mark.parametrize(("names", "bits"), [(("a",), np.zeros((4, 2), bool)), (("a", "a"), np.zeros((4, 2), bool)),
                                             (("",), np.zeros((4, 1), bool)), (("a",), np.zeros((4, 1)))])
def test_what_is_no_parts(names, bits):
    with pytest.raises(fg.FastGSError):
        fg.Parts(names, bits)


def test_parts_have_as_many_gaussians_as_the_model(model):
    with pytest.raises(fg.FastGSError, match="203"):
        replace(model, parts=fg.Parts.of({"a": np.ones(5, bool)}))
    with pytest.raises(fg.FastGSError, match="Ball, Höhe"):
        model.parts["Hat"]

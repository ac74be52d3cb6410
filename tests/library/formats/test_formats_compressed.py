# SPDX-License-Identifier: GPL-3.0-or-later
"""The compressed variant of our own file: errors within their bounds, segments, damage, and what pruning leaves out."""
from __future__ import annotations

import json
from dataclasses import replace

import mutations
import numpy as np
import pytest
from random_models import BASES, TEMPORALS, random_model

import fastgs_blender as fg
from fastgs_blender.formats import compressed
from fastgs_blender.model.pruning import pruned, scores
from fastgs_blender.util.tensor_files import open_tensors

pytestmark = pytest.mark.filterwarnings("ignore::fastgs_blender.LossWarning")
CAMERA = fg.Camera(96, 72, 90.0, 90.0, 48.0, 36.0, np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 6], [0, 0, 0, 1]]))


def psnr(a: fg.GaussianModel, b: fg.GaussianModel, t: float) -> float:
    one, two = (np.clip(fg.render(m, CAMERA, t)["rgb"], 0, 1) for m in (a, b))
    return -10 * np.log10(max(np.mean((one - two) ** 2), 1e-12))


@pytest.mark.parametrize(("basis", "rotation_basis", "temporal", "appearance"), [
    *((basis, "line", "radial", "rgb") for basis in BASES), ("cubic", "keys", "window", "sh3"), ("static", "static", "always", "sh4"),
    ("paper", "line", "radial-window", "sigmoid"), ("line", "cosine", "always", "changing sh1")])
def test_every_kind_looks_as_before(tmp_path, basis, rotation_basis, temporal, appearance):
    model = random_model(np.random.default_rng(1), 400, basis, rotation_basis, temporal, appearance, extent=2.0,
                         clip=fg.Clip(40, 25.0, 3), axes="RUB", provenance={"from": "a test"})
    fg.save(model, tmp_path / "m.safetensors", compress=4)
    again = fg.load(tmp_path / "m.safetensors")
    for kind in ("basis", "rotation_basis", "temporal_kind", "clip", "raster", "axes", "colour_space", "provenance"):
        assert getattr(again, kind) == getattr(model, kind)
    assert len(again) == len(model)
    for t in (0.1, 0.6):
        assert psnr(model, again, t) > 33, (psnr(model, again, t), t)


def test_finer_files_are_larger_and_nearer(tmp_path):
    model = random_model(np.random.default_rng(2), 3000, "paper", "line", "radial", "sh1", extent=2.0)
    found = []
    for fineness in (0.5, 2, 8):
        fg.save(model, tmp_path / "m.safetensors", compress=fineness)
        found.append(((tmp_path / "m.safetensors").stat().st_size, psnr(model, fg.load(tmp_path / "m.safetensors"), 0.4)))
    assert found == sorted(found) and found[2][1] > found[0][1] + 12
    assert found[0][0] < model.nbytes / 6
    first = (tmp_path / "m.safetensors").read_bytes()
    fg.save(model, tmp_path / "m.safetensors", compress=8)
    assert first == (tmp_path / "m.safetensors").read_bytes()


def test_windows_keep_their_edges_to_the_bit(tmp_path):
    model = random_model(np.random.default_rng(3), 50, temporal="window")
    fg.save(model, tmp_path / "m.safetensors", compress=1)
    again = fg.load(tmp_path / "m.safetensors")
    assert set(map(tuple, again.temporal[:, :2])) == set(map(tuple, model.temporal[:, :2]))


def test_segments_can_be_read_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(compressed, "SEGMENT", 100)
    model = random_model(np.random.default_rng(4), 250, "cubic", appearance="sh1")
    fg.save(model, tmp_path / "m.safetensors", compress=1)
    whole = fg.load(tmp_path / "m.safetensors")
    assert len(whole) == 250
    with open_tensors(tmp_path / "m.safetensors") as file:
        about = json.loads(file.metadata["fast-gs"])["compressed"]
        part = compressed.unpacked(file, about, whole.take(slice(0, 0)), range(1, 2))
    for name, array in part.arrays.items():
        np.testing.assert_array_equal(array, getattr(whole, name)[100:200])


def test_damage_is_found_by_the_checksum(tmp_path):
    path = tmp_path / "m.safetensors"
    fg.save(random_model(np.random.default_rng(5), 300, "cubic"), path, compress=1)
    data = bytearray(path.read_bytes())
    data[-40] ^= 1
    path.write_bytes(data)
    with pytest.raises(fg.FastGSError, match=r"m\.safetensors.*checksum"):
        fg.load(path)


def test_mutated_files(tmp_path):
    def seed(**kinds):
        fg.save(random_model(np.random.default_rng(6), 9, **kinds), tmp_path / "m.safetensors", compress=1)
        return {"m.safetensors": (tmp_path / "m.safetensors").read_bytes()}

    def read(folder):
        model = fg.load(folder / "m.safetensors")
        assert all(np.isfinite(array).all() for array in model.arrays.values())

    seeds = {"cubic": seed(basis="cubic", rotation_basis="line", temporal="radial"),
             "keys": seed(basis="keys", rotation_basis="keys", temporal="window", appearance="clamp")}
    (tmp_path / "seeds").mkdir()
    told = mutations.campaign("compressed", read, seeds, tmp_path / "seeds")
    assert min(told.values(), default=1) > 0


def test_what_cannot_be_compressed_is_said(tmp_path):
    model = random_model(np.random.default_rng(7), 5)
    with pytest.raises(fg.FastGSError, match=r"m\.ply.*compressed variant"):
        fg.save(model, tmp_path / "m.ply", compress=1)
    with pytest.raises(fg.FastGSError, match="fineness"):
        fg.save(model, tmp_path / "m.safetensors", compress=0)
    model.position[2] = np.nan
    with pytest.warns(fg.LossWarning, match="1 Gaussians whose numbers are not finite; its numbers are quantised"):
        fg.save(model, tmp_path / "m.safetensors", compress=1)
    assert len(fg.load(tmp_path / "m.safetensors")) == 4


@pytest.mark.parametrize("temporal", TEMPORALS)
def test_pruning_leaves_out_what_is_never_drawn(temporal):
    model = random_model(np.random.default_rng(8), 300, "cubic", temporal=temporal, extent=2.0)
    model = replace(model, opacity=np.where(np.arange(300) % 3 == 0, np.float32(-9), model.opacity))
    left = pruned(model)
    assert 0 < len(left) <= 200
    for t in (0, 0.35, 1):
        np.testing.assert_array_equal(fg.render(model, CAMERA, t)["rgb"], fg.render(left, CAMERA, t)["rgb"])
    fewer = pruned(model, 0.25)
    assert len(fewer) == pytest.approx(0.75 * len(left), abs=1)
    assert scores(fewer).min() >= np.quantile(scores(left), 0.2)
    with pytest.raises(fg.FastGSError, match="share"):
        pruned(model, 1.0)

# SPDX-License-Identifier: GPL-3.0-or-later
"""`.splat` of antimatter15: records of 32 bytes."""
from __future__ import annotations

import struct
import warnings

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.formats import identify

pytestmark = pytest.mark.filterwarnings("error")


def record(position=(1, 2, 3), scale=(0.1, 0.2, 0.3), colour=(255, 128, 0, 200), rotation=(255, 128, 128, 128)) -> bytes:
    """One Gaussian by the format's description."""
    return struct.pack("<6f", *position, *scale) + bytes(colour) + bytes(rotation)


@pytest.fixture
def load_bytes(tmp_path):
    """load() of a file with this content."""
    def load(data: bytes, name="m.splat"):
        (tmp_path / name).write_bytes(data)
        return fg.load(tmp_path / name)
    return load


def test_one_record_field_by_field(load_bytes):
    model = load_bytes(record(rotation=(192, 64, 230, 100)))
    s = fg.slice_model(model, 0)
    np.testing.assert_allclose(s.position, [[1, 2, 3]], rtol=1e-7)
    np.testing.assert_allclose(s.scale, [[0.1, 0.2, 0.3]], rtol=1e-6)
    np.testing.assert_allclose(s.opacity, [200 / 255], rtol=1e-6)
    np.testing.assert_allclose(s.features, [[1, 128 / 255, 0]], rtol=1e-6)
    q = (np.array([192, 64, 230, 100]) - 128) / 128
    np.testing.assert_allclose(s.rotation[0], q / np.linalg.norm(q), rtol=1e-6)
    assert (model.axes, model.appearance, model.raster) == ("RDF", fg.RGB(), fg.Raster())


def test_known_by_content_whatever_the_name(load_bytes, tmp_path):
    data = b"".join(record(position=(i, -i, 0.5), rotation=(128, 255, 128, 128)) for i in range(100))
    assert len(load_bytes(data, "m.bin")) == 100
    assert identify(tmp_path / "m.bin").name == ".splat"
    with pytest.raises(fg.FastGSError, match="known formats"):
        load_bytes(np.random.default_rng(1).bytes(3200), "noise.bin")


def test_exporters_that_do_not_normalise_are_read_by_the_name(load_bytes):
    model = load_bytes(record(rotation=(160, 128, 128, 128)) * 3)
    np.testing.assert_allclose(fg.slice_model(model, 0).rotation, [[1, 0, 0, 0]] * 3, atol=1e-7)


def test_what_follows_the_last_whole_record(load_bytes):
    """As viewers do it, no file is refused for its tail; one that lost something says so."""
    with pytest.warns(fg.LossWarning, match="1 whole record"):
        assert len(load_bytes((record() * 2)[:50])) == 1
    for tail in (bytes(7), b"\n"):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert len(load_bytes(record() * 2 + tail)) == 2


def test_wholly_opaque_and_transparent(load_bytes):
    model = load_bytes(record(colour=(0, 0, 0, 255)) + record(colour=(0, 0, 0, 0)))
    np.testing.assert_allclose(fg.slice_model(model, 0, cull=False).opacity, [1, 0], atol=1e-9)


def test_round_trip(rng, make_model, tmp_path):
    model = make_model(rng, 500, appearance="rgb")
    path = tmp_path / "m.splat"
    with pytest.warns(fg.LossWarning, match="rounded to 8 bits") as said:
        fg.save(model, path)
    assert len(said) == 1
    assert path.stat().st_size == 500 * 32
    back = fg.load(path)
    opacity = 1 / (1 + np.exp(-model.opacity.astype(np.float64)))
    order = np.argsort(-np.exp(model.scale.sum(1, dtype=np.float64)) * opacity, kind="stable")
    np.testing.assert_array_equal(back.position, model.position[order])
    a, b = fg.slice_model(model, 0, cull=False), fg.slice_model(back, 0, cull=False)
    np.testing.assert_allclose(b.scale, a.scale[order], rtol=1e-6)
    np.testing.assert_allclose(b.opacity, a.opacity[order], atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(b.features, a.features[order], atol=0.5 / 255 + 1e-6)
    assert np.abs((a.rotation[order] * b.rotation).sum(1)).min() > 1 - 2e-4


def test_the_bytes_are_those_of_the_viewers_own_converter(tmp_path):
    """Transcribed: exp(scale), 255 (0.5 + C0 f_dc), 255 sigmoid, 128 q + 128."""
    model = fg.GaussianModel(position=[[1, 2, 3]], rotation=[[0, 2, 0, 0]], scale=[[-1, -2, -3]], opacity=[0.0],
                             features=[[1.0, 0.25, -1.0]], appearance=fg.SH(0))
    with pytest.warns(fg.LossWarning):
        fg.save(model, tmp_path / "m.splat")
    values = struct.unpack("<6f8B", (tmp_path / "m.splat").read_bytes())
    np.testing.assert_allclose(values[:6], [1, 2, 3, *np.exp([-1, -2, -3])], rtol=1e-6)
    colour = 255 * (0.5 + 0.28209479177387814 * np.array([1.0, 0.25, -1.0]))
    assert np.abs(np.array(values[6:9]) - colour).max() <= 0.5
    assert values[9:] == (128, 128, 255, 128, 128)


def test_what_is_lost_is_said(rng, make_model, tmp_path):
    model = make_model(rng, 20, appearance="sh3", raster=fg.Raster(blur=0.1, antialiased=True), colour_space="linear",
                       provenance={"by": "me"}, features=np.full((20, 48), 9.0))
    with pytest.warns(fg.LossWarning) as said:
        fg.save(model, tmp_path / "m.splat")
    for clause in ("degree 3 are cut to degree 0", "antialiased", "constants", "linear", "provenance", "above 1", "8 bits"):
        assert clause in str(said[0].message)


@pytest.mark.parametrize("kinds", [{"basis": "cubic"}, {"rotation_basis": "line"}, {"temporal": "window"}])
def test_what_moves_is_refused_with_advice(rng, make_model, tmp_path, kinds):
    with pytest.raises(fg.FastGSError, match="--at FRAME"):
        fg.save(make_model(rng, 5, **kinds), tmp_path / "m.splat")
    assert not list(tmp_path.iterdir())


def test_other_axes_are_turned(rng, make_model, tmp_path):
    model = make_model(rng, 1, axes="RUB", appearance="rgb", position=[[1, 2, 3]])
    with pytest.warns(fg.LossWarning):
        fg.save(model, tmp_path / "m.splat")
    np.testing.assert_array_equal(fg.load(tmp_path / "m.splat").position, [[1, -2, -3]])


def test_gaussians_that_are_no_numbers_stay_out_and_an_empty_model_is_refused(rng, make_model, tmp_path):
    model = make_model(rng, 3)
    model.position[1] = np.nan
    with pytest.warns(fg.LossWarning, match="1 Gaussians.*finite"):
        fg.save(model, tmp_path / "m.splat")
    assert len(fg.load(tmp_path / "m.splat")) == 2
    with pytest.raises(fg.FastGSError, match="no Gaussians"):
        fg.save(make_model(rng, 0), tmp_path / "none.splat")


def test_what_lies_too_far_away_is_left_out_or_refused(rng, make_model, tmp_path):
    """The format has no mark: records are recognised by plausible numbers."""
    model = make_model(rng, 20)
    model.position[3] = 2e7
    with pytest.warns(fg.LossWarning, match="1 Gaussians.*farther"):
        fg.save(model, tmp_path / "a.splat")
    assert len(fg.load(tmp_path / "a.splat")) == 19
    model.position[:] = 2e7
    with pytest.raises(fg.FastGSError, match="smaller"):
        fg.save(model, tmp_path / "b.splat")

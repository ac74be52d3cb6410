# SPDX-License-Identifier: GPL-3.0-or-later
"""Spacetime Gaussians: full, lite, and with Fourier motion.

Transcribed from oppo-us-research/SpacetimeGaussians@427abfc: thirdparty/gaussian_splatting/renderer/__init__.py, test_ours_full, lines
157-174; scene/oursfull.py, get_rotation, 124-127 (the sum is normalised, zeros stay zeros), get_features, 139, and save_ply, 380-411;
trbfunction, helper_train.py, 390; scaling, opacity: scene/oursfull.py, 33-41.
"""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import ply_files
import pytest
from ply_files import FORMATS, STG, STG_FULL
from random_models import BASES

import fastgs_blender as fg
from fastgs_blender.formats import identify, torch_zip

pytestmark = pytest.mark.filterwarnings("error")
TIMES = (0.0, 0.13, 0.5, 0.98)


@pytest.fixture
def model_folder(tmp_path):
    """The folder of a trained model, as STG lays it out: where point_cloud.ply goes."""
    folder = tmp_path / "scene" / "point_cloud" / "iteration_25000"
    folder.mkdir(parents=True)
    return folder


def write_decoder(path, rng, scale=1.0):
    """A decoder, and its two weights."""
    weights = {"mlp1.weight": rng.normal(0, scale, (6, 12, 1, 1)), "mlp2.weight": rng.normal(0, scale, (3, 6, 1, 1))}
    torch_zip.write(path, weights)
    return [w.astype(np.float32)[..., 0, 0] for w in weights.values()]


def expected(table, t, offset):
    """Position, unnormalised rotation and opacity at t by STG's formulas; offset(delta) is the motion, [N, 3]."""
    dt = t - table["trbf_center"].astype(np.float64)
    rotation = np.stack([table[f"rot_{i}"] + table[f"omega_{i}"] * dt for i in range(4)], 1)
    opacity = 1 / (1 + np.exp(-table["opacity"].astype(np.float64))) * np.exp(-(dt / np.exp(table["trbf_scale"].astype(np.float64))) ** 2)
    return np.stack([table[k] for k in "xyz"], 1) + offset(dt), rotation, opacity


def cubic(table):
    m = [table[f"motion_{i}"].astype(np.float64) for i in range(9)]
    return lambda dt: np.stack([m[a] * dt + m[3 + a] * dt**2 + m[6 + a] * dt**3 for a in range(3)], 1)


def check_slices(model, table, offset):
    for t in TIMES:
        s = fg.slice_model(model, t, cull=False)
        position, rotation, opacity = expected(table, t, lambda dt, t=t: offset(dt, t))
        np.testing.assert_allclose(s.position, position, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(s.rotation, rotation / np.linalg.norm(rotation, axis=1, keepdims=True), atol=1e-5)
        np.testing.assert_allclose(s.opacity, opacity, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("kind", FORMATS)
def test_lite(rng, tmp_path, kind):
    table = ply_files.columns(rng, list(rng.permutation(STG)), 50)
    (tmp_path / "m").write_bytes(ply_files.ply(table, kind))
    model = fg.load(tmp_path / "m")
    check_slices(model, table, lambda dt, t: cubic(table)(dt))
    np.testing.assert_array_equal(model.features, np.stack([table[f"f_dc_{i}"] for i in range(3)], 1))
    assert model.appearance == fg.RGB()
    assert (model.basis, model.rotation_basis, model.clip) == (fg.Polynomial(3), fg.Polynomial(1), fg.Clip(50))
    assert model.raster == fg.Raster()
    assert identify(tmp_path / "m").name == "Spacetime Gaussians PLY"


def test_full(rng, model_folder):
    table = ply_files.columns(rng, STG_FULL, 30)
    (model_folder / "point_cloud.ply").write_bytes(ply_files.ply(table))
    w1, w2 = write_decoder(model_folder / "point_cloud.pt", rng)
    with pytest.warns(fg.LossWarning, match="no cfg_args.*sigmoid"):  # Technicolor's decoders end otherwise, and no weight tells
        model = fg.load(model_folder / "point_cloud.ply")
    check_slices(model, table, lambda dt, t: cubic(table)(dt))
    f = fg.slice_model(model, 0.3, cull=False).features
    np.testing.assert_array_equal(f[:, :6].astype(np.float32), np.stack([table[f"f_dc_{i}"] for i in range(6)], 1))
    time = np.stack([table[f"f_t_{i}"] * (0.3 - table["trbf_center"].astype(np.float64)) for i in range(3)], 1)
    np.testing.assert_allclose(f[:, 6:], time, rtol=1e-6)
    np.testing.assert_array_equal(model.appearance.w1, w1)
    np.testing.assert_array_equal(model.appearance.w2, w2)
    assert (model.appearance.activation, model.clip.frame_count) == ("sigmoid", 50)
    assert model.appearance.decode == "premultiplied", "rendering/test_premultiplied.py says by which lines of STG's"


@pytest.mark.parametrize(("function", "activation"), [("sandwich", "sigmoid"), ("sandwichnoact", "clamp"), ("sandwichnoactss", "none")])
def test_cfg_args_tell_activation_and_duration(rng, model_folder, function, activation):
    (model_folder / "point_cloud.ply").write_bytes(ply_files.ply(ply_files.columns(rng, STG_FULL)))
    write_decoder(model_folder / "point_cloud.pt", rng)
    (model_folder.parents[1] / "cfg_args").write_text(
        f"Namespace(sh_degree=3, source_path='/a, duration=7', duration=300, white=False, x=[1, 2], rgbfunction={function!r})")
    model = fg.load(model_folder / "point_cloud.ply")
    assert (model.appearance.activation, model.clip.frame_count) == (activation, 300)


@pytest.mark.parametrize("text", [
    "", "Namespace(", "Namespace(duration=0)", "Namespace(duration='many')", "Namespace(duration=True)",
    "__import__('os').system('touch pwned')", "(" * 5000, "-" * 50_000 + "1", "Namespace(" + "[" * 150 + "]" * 150 + ")", "x" * 100_000,
    "\0", "Namespace(1)", "Other(duration=5)"])
def test_broken_cfg_args_are_said_and_passed_over(rng, model_folder, text, monkeypatch):
    monkeypatch.chdir(model_folder)
    (model_folder / "point_cloud.ply").write_bytes(ply_files.ply(ply_files.columns(rng, STG)))
    (model_folder.parents[1] / "cfg_args").write_text(text)
    with pytest.warns(fg.LossWarning, match="cfg_args.*50 frames"):
        assert fg.load(model_folder / "point_cloud.ply").clip.frame_count == 50
    assert not (model_folder / "pwned").exists()


def test_settings_that_are_no_literals_are_as_if_not_there(rng, model_folder):
    (model_folder / "point_cloud.ply").write_bytes(ply_files.ply(ply_files.columns(rng, STG)))
    (model_folder.parents[1] / "cfg_args").write_text("Namespace(duration=open('/etc/passwd'), x=" + "[" * 100 + "]" * 100 + ")")
    assert fg.load(model_folder / "point_cloud.ply").clip.frame_count == 50


@pytest.mark.parametrize("function", ["'club'", "['club']", "{}"])
def test_an_unknown_output_function_is_said(rng, model_folder, function):
    (model_folder / "point_cloud.ply").write_bytes(ply_files.ply(ply_files.columns(rng, STG_FULL)))
    write_decoder(model_folder / "point_cloud.pt", rng)
    (model_folder.parents[1] / "cfg_args").write_text(f"Namespace(duration=20, rgbfunction={function})")
    with pytest.warns(fg.LossWarning, match="unknown.*sigmoid"):
        model = fg.load(model_folder / "point_cloud.ply")
    assert (model.appearance.activation, model.clip.frame_count) == ("sigmoid", 20)


def fourier_table(rng, order, constant, n=20):
    """A table with axis-major Fourier columns, and its motion by the printed formula."""
    width = 2 * order + constant
    names = [n for n in STG if not n.startswith("motion_")] + [f"motion_{i}" for i in range(3 * width)]
    table = ply_files.columns(rng, names, n)

    def offset(dt, t):
        out = np.zeros((n, 3))
        for axis in range(3):
            w = [table[f"motion_{axis * width + i}"].astype(np.float64) for i in range(width)]
            if constant:
                out[:, axis] += w.pop(0)
            for k in range(1, order + 1):
                out[:, axis] += w[2 * k - 2] * np.sin(2 * np.pi * k * t) + w[2 * k - 1] * np.cos(2 * np.pi * k * t)
        return out

    return table, offset


@pytest.mark.parametrize(("order", "constant"), [(5, True), (5, False), (1, False), (2, True), (7, True), (3, False)])
def test_fourier_columns_of_others(rng, tmp_path, order, constant):
    table, offset = fourier_table(rng, order, constant)
    (tmp_path / "m.ply").write_bytes(ply_files.ply(table))
    model = fg.load(tmp_path / "m.ply")
    assert model.basis == fg.Fourier(order)
    check_slices(model, table, offset)


def test_nine_columns_are_a_cubic_unless_our_comment_says_otherwise(rng, tmp_path):
    table, offset = fourier_table(rng, 1, True)
    (tmp_path / "a.ply").write_bytes(ply_files.ply(table))
    assert fg.load(tmp_path / "a.ply").basis == fg.Polynomial(3)
    (tmp_path / "b.ply").write_bytes(ply_files.ply(table, comments=['fastgs basis {"name": "fourier", "order": 1}']))
    check_slices(fg.load(tmp_path / "b.ply"), table, offset)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 8, 10, 31])
def test_numbers_of_motion_columns_that_fit_nothing(rng, tmp_path, count):
    names = [n for n in STG if not n.startswith("motion_")] + [f"motion_{i}" for i in range(count)]
    (tmp_path / "m.ply").write_bytes(ply_files.ply(ply_files.columns(rng, names)))
    with pytest.raises(fg.FastGSError, match=f"{count} columns motion_"):
        fg.load(tmp_path / "m.ply")


@pytest.mark.parametrize("comment", [
    'basis {"name": "fourier", "order": 4}', 'basis {"name": "fourier", "order": 1000000000}', "basis {", 'basis {"name": "x"}', "basis",
    'clip {"frame_count": 1e9}', 'axes "UP"', 'raster {"blur": NaN}', "provenance 3"])
def test_comments_that_make_no_sense(rng, tmp_path, comment):
    (tmp_path / "m.ply").write_bytes(ply_files.ply(ply_files.columns(rng, STG), comments=[f"fastgs {comment}"]))
    with pytest.raises(fg.FastGSError):
        fg.load(tmp_path / "m.ply")


@pytest.mark.slow
@pytest.mark.parametrize("appearance", ["rgb", "sigmoid", "clamp", "none"])
@pytest.mark.parametrize("temporal", ["always", "radial"])
@pytest.mark.parametrize(("basis", "rotation"), [("cubic", "line"), ("line", "static"), ("paper", "line"), ("fourier", "line"),
                                                 ("cosine", "static"), ("static", "line"), (fg.Fourier(1, linear=True), "line")])
def test_round_trip_of_what_the_layout_holds(rng, make_model, tmp_path, basis, rotation, temporal, appearance):
    model = make_model(rng, basis=basis, rotation_basis=rotation, temporal=temporal, appearance=appearance, axes="RUB",
                       clip=fg.Clip(81, 24.0, 3), raster=fg.Raster(antialiased=True), provenance={"a": "b"})
    if appearance != "rgb":
        model = replace(model, appearance=replace(model.appearance, decode="premultiplied"))
    fg.save(model, tmp_path / "m.ply")
    back = fg.load(tmp_path / "m.ply")
    for name, array in model.arrays.items():
        np.testing.assert_array_equal(back.arrays[name], array, err_msg=name)
    for name in ("basis", "rotation_basis", "temporal_kind", "raster", "clip", "axes", "provenance"):
        assert getattr(back, name) == getattr(model, name)
    if appearance != "rgb":
        np.testing.assert_array_equal(back.appearance.w1, model.appearance.w1)
        assert (back.appearance.activation, back.appearance.decode) == (appearance, "premultiplied")


def test_a_decoder_of_means_comes_back_and_what_others_show_is_said(rng, make_model, tmp_path):
    """Without our comments it is one of STG's, and so STG's own programs show it."""
    model = make_model(rng, basis="cubic", rotation_basis="line", temporal="radial", appearance="clamp")
    with pytest.warns(fg.LossWarning, match="alpha"):
        fg.save(model, tmp_path / "m.ply")
    assert fg.load(tmp_path / "m.ply").appearance.decode == "normalised"
    head, body = (tmp_path / "m.ply").read_bytes().split(b"end_header\n", 1)
    head = b"".join(line for line in head.splitlines(True) if not line.startswith(b"comment fastgs"))
    (tmp_path / "m.ply").write_bytes(head + b"end_header\n" + body)
    (tmp_path / "cfg_args").write_text("Namespace(rgbfunction='sandwich')")
    assert fg.load(tmp_path / "m.ply").appearance.decode == "premultiplied"


@pytest.mark.parametrize(("appearance", "names"), [("rgb", STG), ("stg", STG_FULL)])
def test_columns_stand_in_stgs_order(rng, make_model, tmp_path, appearance, names):
    fg.save(make_model(rng, basis="cubic", rotation_basis="line", temporal="radial", appearance=appearance), tmp_path / "m.ply")
    header = (tmp_path / "m.ply").read_bytes().partition(b"end_header")[0].decode().splitlines()
    assert [line.split()[2] for line in header if line.startswith("property float")] == names
    assert (tmp_path / "m.pt").exists() == (appearance != "rgb")


def test_a_file_of_ours_without_its_comments(rng, make_model, tmp_path):
    """Other tools drop comments; what they keep must still move and fade alike."""
    model = make_model(rng, basis="paper", rotation_basis="line", temporal="always")
    fg.save(model, tmp_path / "m.ply")
    data = (tmp_path / "m.ply").read_bytes()
    head, body = data.split(b"end_header\n", 1)
    head = b"".join(line for line in head.splitlines(True) if not line.startswith(b"comment fastgs"))
    (tmp_path / "m.ply").write_bytes(head + b"end_header\n" + body)
    back = fg.load(tmp_path / "m.ply")
    for t in TIMES:
        a, b = fg.slice_model(model, t, cull=False), fg.slice_model(back, t, cull=False)
        np.testing.assert_allclose(b.position, a.position, atol=1e-6)
        np.testing.assert_allclose(b.opacity, a.opacity, rtol=1e-9)


def sliced_error(a, b, t):
    """RMS distance of the positions of Gaussians that can be seen at t."""
    s = fg.slice_model(a, t)
    other = fg.slice_model(b, t, cull=False)
    return np.sqrt(np.mean(np.sum((other.position[s.index] - s.position) ** 2, 1)))


@pytest.mark.parametrize("basis", ["keys", "smooth keys", fg.Polynomial(5)])
def test_other_motion_becomes_a_cubic_and_the_error_is_said(rng, make_model, tmp_path, basis):
    model = make_model(rng, 200, basis=basis, temporal="always", motion=0.2, clip=fg.Clip(100))
    with pytest.warns(fg.LossWarning) as said:
        fg.save(model, tmp_path / "m.ply")
    assert len(said) == 1
    rms = float(str(said[0].message).split("RMS error ")[1].split()[0])
    back = fg.load(tmp_path / "m.ply")
    assert back.basis == fg.Polynomial(3)
    measured = np.sqrt(np.mean([sliced_error(model, back, t) ** 2 for t in np.linspace(0, 1, 41)]))
    assert measured == pytest.approx(rms, rel=0.1)


def test_short_lives_are_fitted_closely(rng, make_model, tmp_path):
    """A Gaussian that lives for a tenth of the clip needs no more than a cubic, whatever it does outside."""
    model = make_model(rng, 200, basis="keys", temporal="radial", motion=0.2, clip=fg.Clip(100))
    model.temporal[:] = np.log(5000)
    with pytest.warns(fg.LossWarning, match="RMS"):
        fg.save(model, tmp_path / "m.ply")
    back = fg.load(tmp_path / "m.ply")
    extent = np.ptp(model.motion)
    for t in (0.1, 0.4, 0.7):
        assert sliced_error(model, back, t) < 0.02 * extent


def test_rotation_becomes_linear_and_the_error_is_said(rng, make_model, tmp_path):
    with pytest.warns(fg.LossWarning, match=r"rotation \(keyframes, 4 terms\) becomes linear.*RMS error [\d.]+ degrees"):
        fg.save(make_model(rng, rotation_basis="keys"), tmp_path / "m.ply")


@pytest.mark.parametrize("basis", ["static", "cubic", "paper"])
def test_windows_become_bells(rng, make_model, tmp_path, basis):
    model = make_model(rng, 100, basis=basis, rotation_basis="line", temporal="window")
    with pytest.warns(fg.LossWarning, match="bell curves") as said:
        fg.save(model, tmp_path / "m.ply")
    assert "RMS" not in str(said[0].message)  # the motion is the same, around another moment
    back = fg.load(tmp_path / "m.ply")
    times = np.linspace(-2, 3, 2001)
    a, b = (np.array([m.temporal_kind.factor(t, m.mu_tau, m.temporal) for t in times]) for m in (model, back))
    np.testing.assert_allclose(b.sum(0), a.sum(0), rtol=1e-3)
    np.testing.assert_allclose((times[:, None] * b).sum(0) / b.sum(0), (times[:, None] * a).sum(0) / a.sum(0), atol=1e-3)
    for t in (0.0, 0.4, 1.0):
        s, r = fg.slice_model(model, t, cull=False), fg.slice_model(back, t, cull=False)
        np.testing.assert_allclose(r.position, s.position, atol=2e-5)
        np.testing.assert_allclose(r.rotation, s.rotation, atol=1e-4)


def test_view_dependent_colour_is_said_to_be_lost(rng, make_model, tmp_path):
    model = make_model(rng, basis="cubic", appearance="sh3")
    with pytest.warns(fg.LossWarning, match="SH degree 3"):
        fg.save(model, tmp_path / "m.ply")
    np.testing.assert_allclose(fg.load(tmp_path / "m.ply").features, np.maximum(0, 0.5 + 0.28209479 * model.features[:, :3]), atol=1e-6)


def test_missing_decoder(rng, tmp_path):
    (tmp_path / "cfg_args").write_text("Namespace(rgbfunction='sandwich')")
    (tmp_path / "m.ply").write_bytes(ply_files.ply(ply_files.columns(rng, STG_FULL)))
    with pytest.raises(fg.FastGSError, match=r"m\.pt.*missing"):
        fg.load(tmp_path / "m.ply")


@pytest.mark.parametrize("tensors", [
    {"mlp1.weight": np.zeros((6, 12, 1, 1))}, {"mlp1.weight": np.zeros((12, 6)), "mlp2.weight": np.zeros((3, 6))}, {},
    {"mlp1.weight": np.full((6, 12), np.nan), "mlp2.weight": np.zeros((3, 6))}])
def test_decoders_of_another_kind(rng, tmp_path, tensors):
    (tmp_path / "cfg_args").write_text("Namespace(rgbfunction='sandwich')")
    (tmp_path / "m.ply").write_bytes(ply_files.ply(ply_files.columns(rng, STG_FULL)))
    torch_zip.write(tmp_path / "m.pt", tensors)
    with pytest.raises(fg.FastGSError, match=r"decoder m\.pt.*used"):
        fg.load(tmp_path / "m.ply")


def test_a_decoder_never_replaces_another_file(rng, make_model, tmp_path):
    (tmp_path / "m.pt").write_bytes(b"weeks of training")
    with pytest.raises(fg.FastGSError, match=r"m\.pt.*something else"):
        fg.save(make_model(rng, basis="cubic", appearance="sigmoid"), tmp_path / "m.ply")
    assert (tmp_path / "m.pt").read_bytes() == b"weeks of training"
    assert [p.name for p in tmp_path.iterdir()] == ["m.pt"]


@pytest.mark.parametrize("missing", ["trbf_scale", "omega_3", "rot_0", "f_dc_1"])
def test_missing_columns_are_named(rng, tmp_path, missing):
    (tmp_path / "m.ply").write_bytes(ply_files.ply(ply_files.columns(rng, [n for n in STG if n != missing])))
    with pytest.raises(fg.FastGSError, match=missing):
        fg.load(tmp_path / "m.ply")


def test_half_a_feature_vector(rng, tmp_path):
    (tmp_path / "m.ply").write_bytes(ply_files.ply(ply_files.columns(rng, STG_FULL[:-1])))
    with pytest.raises(fg.FastGSError, match="not all"):
        fg.load(tmp_path / "m.ply")


@pytest.mark.parametrize("basis", BASES)
def test_what_is_lost_is_known_before_writing(rng, make_model, tmp_path, basis):
    from fastgs_blender.formats import WRITERS

    model = make_model(rng, basis=basis, rotation_basis="line", temporal="radial")
    writer = next(w for w in WRITERS if w.name == "Spacetime Gaussians PLY")
    assert bool(writer.losses(model)) == (basis in ("keys", "smooth keys"))

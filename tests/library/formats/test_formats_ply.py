# SPDX-License-Identifier: GPL-3.0-or-later
"""PLY in general, and INRIA's."""
from __future__ import annotations

import tracemalloc

import numpy as np
import ply_files
import pytest
from ply_files import FORMATS, INRIA

import fastgs_blender as fg
from fastgs_blender.formats import identify
from fastgs_blender.model.appearance import sh_basis

pytestmark = pytest.mark.filterwarnings("error")


@pytest.fixture
def load_bytes(tmp_path):
    """load() of a file with this content, under a name that says nothing."""
    def load(data: bytes):
        path = tmp_path / "content"
        path.write_bytes(data)
        return fg.load(path)
    return load


def check_inria(model, table):
    """The model has the table's values: position, SH in channel-major order, and so on."""
    parts = {"position": "xyz", "scale": ["scale_0", "scale_1", "scale_2"], "rotation": ["rot_0", "rot_1", "rot_2", "rot_3"]}
    for name, keys in parts.items():
        np.testing.assert_array_equal(getattr(model, name), np.stack([table[k] for k in keys], 1))
    np.testing.assert_array_equal(model.opacity, table["opacity"])
    rest = sum(k.startswith("f_rest_") for k in table) // 3
    colour = model.features.reshape(len(model), 1 + rest, 3)
    for channel in range(3):
        np.testing.assert_array_equal(colour[:, 0, channel], table[f"f_dc_{channel}"])
        for b in range(rest):
            np.testing.assert_array_equal(colour[:, 1 + b, channel], table[f"f_rest_{channel * rest + b}"])
    assert model.appearance == fg.SH({0: 0, 3: 1, 8: 2, 15: 3, 24: 4}[rest])


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("degree", range(5))
def test_inria_in_any_order_and_encoding(rng, load_bytes, kind, degree):
    names = [*INRIA, *(f"f_rest_{i}" for i in range(3 * ((degree + 1) ** 2 - 1))), "nx", "ny", "nz", "unknown"]
    table = ply_files.columns(rng, list(rng.permutation(names)))
    model = load_bytes(ply_files.ply(table, kind))
    check_inria(model, table)
    assert model.raster == fg.Raster(0.3, 0.99, 1 / 255, 0.2, False)
    assert model.axes == "RDF"
    assert len(model) == 6


@pytest.mark.parametrize("kind", FORMATS)
def test_types_comments_other_elements_and_line_ends(rng, load_bytes, kind):
    table = ply_files.columns(rng, INRIA)
    table["opacity"] = np.arange(6).astype(np.float32)
    table["label"] = np.arange(6).astype(np.float32)
    types = {"x": "double", "opacity": "uchar", "label": "int", "rot_0": "double"}
    camera = ply_files.element("camera", {"f": np.array([1.5, 2.5])}, FORMATS[kind], {"f": "double"})
    faces, strips = ply_files.faces(FORMATS[kind]), ply_files.faces(FORMATS[kind], "strips")
    data = ply_files.ply(table, kind, ["element vertex 9", "obj_info end_header not"], types, [camera, faces], [strips], "\r\n")
    check_inria(load_bytes(data), table)


def test_colours_as_nerfstudio_writes_them(rng, load_bytes):
    """ns-export gaussian-splat --ply-color-mode rgb: bytes instead of coefficients; other programs have floats, or 16 bits."""
    for kind, most in (("uchar", 255), ("ushort", 65535), ("float", 1)):
        table = ply_files.columns(rng, [name for name in INRIA if not name.startswith("f_dc")])
        shown = rng.random((6, 3)) if kind == "float" else rng.integers(0, most + 1, (6, 3))
        table |= {name: shown[:, i].astype(np.float32) for i, name in enumerate(("red", "green", "blue"))}
        model = load_bytes(ply_files.ply(table, types=dict.fromkeys(("red", "green", "blue"), kind)))
        np.testing.assert_allclose(0.5 + 0.28209479177387814 * model.features, shown / most, atol=1e-6)
        np.testing.assert_array_equal(model.scale[:, 2], table["scale_2"])
    both = ply_files.columns(rng, [*INRIA, "red", "green", "blue"])
    check_inria(load_bytes(ply_files.ply(both)), {name: both[name] for name in INRIA})


@pytest.mark.parametrize(("settings", "blur"), [
    (None, 0.1), ("Namespace(kernel_size=0.0, sh_degree=3)", 0.0), ("Namespace(kernel_size=0.3)", 0.3), ("Namespace(sh_degree=3)", 0.1),
    ("Namespace(kernel_size=-1)", 0.1), ("Namespace(kernel_size=1e400)", 0.1), ("rubbish", 0.1)])
def test_the_3d_filter_of_mip_splatting(rng, tmp_path, settings, blur):
    """scene/gaussian_model.py of autonomousvision/mip-splatting, get_scaling_with_3D_filter and get_opacity_with_3D_filter:

        scales = torch.sqrt(torch.square(scales) + torch.square(self.filter_3D))
        det1 = scales_square.prod(dim=1); det2 = scales_after_square.prod(dim=1); opacity * torch.sqrt(det1 / det2)
    """
    table = ply_files.columns(rng, [*INRIA, "filter_3D"], 40)
    table["filter_3D"] = np.abs(table["filter_3D"])
    table["filter_3D"][3] = 0
    table["opacity"][:2] = -20, 20
    path = tmp_path / "point_cloud" / "iteration_30000" / "point_cloud.ply"
    path.parent.mkdir(parents=True)
    path.write_bytes(ply_files.ply(table))
    if settings:
        (tmp_path / "cfg_args").write_text(settings)
    with pytest.warns(fg.LossWarning, match="filter_3D.*Mip-Splatting.*fused"):
        model = fg.load(path)
    s = np.exp(np.stack([table[f"scale_{i}"] for i in range(3)], 1).astype(np.float64))
    after = s**2 + np.square(table["filter_3D"].astype(np.float64))[:, None]
    opacity = 1 / (1 + np.exp(-table["opacity"].astype(np.float64))) * np.sqrt((s**2).prod(1) / after.prod(1))
    shown = fg.slice_model(model, 0, cull=False)
    np.testing.assert_allclose(shown.scale, np.sqrt(after), rtol=1e-6)
    np.testing.assert_allclose(shown.opacity, opacity, rtol=2e-5, atol=1e-7)
    assert model.scale[3].tolist() == [table[f"scale_{i}"][3] for i in range(3)] and model.opacity[3] == table["opacity"][3]
    assert model.raster == fg.Raster(blur=blur, antialiased=True)


def test_a_3d_filter_that_is_no_number_is_blamed_by_its_name(rng, load_bytes):
    """It leaves out its Gaussian; a negative one is squared as their renderer does it."""
    table = ply_files.columns(rng, [*INRIA, "filter_3D"])
    table["filter_3D"][:3] = 0.1, np.nan, -0.1
    with pytest.warns(fg.LossWarning) as told:
        model = load_bytes(ply_files.ply(table))
    said = [str(each.message) for each in told if "left out" in str(each.message)]
    assert len(model) == 5 and len(said) == 1 and "1 of 6 Gaussians" in said[0] and "filter_3D" in said[0]
    for row, source in enumerate((0, 2)):
        scale = np.array([table[f"scale_{i}"][source] for i in range(3)], np.float64)
        np.testing.assert_allclose(np.exp(2 * model.scale[row].astype(np.float64)), np.exp(2 * scale) + 0.01, rtol=1e-5)
    table["filter_3D"][:] = np.inf
    with pytest.raises(fg.FastGSError, match="filter_3D") as error:
        load_bytes(ply_files.ply(table))
    assert "diverged" not in str(error.value)


def test_round_gaussians_have_one_scale(rng, load_bytes):
    table = ply_files.columns(rng, [name for name in INRIA if name not in ("scale_1", "scale_2")])
    model = load_bytes(ply_files.ply(table))
    np.testing.assert_array_equal(model.scale, np.repeat(table["scale_0"][:, None], 3, 1))


@pytest.mark.parametrize("prefix", ["scalar_", "scal_", "scalar_scal_"])
def test_what_cloudcompare_saved(rng, load_bytes, prefix):
    """It puts a word before columns that no plain point cloud has; 3dgsconverter does so itself, to be kept by it."""
    table = ply_files.columns(rng, [*INRIA, *(f"f_rest_{i}" for i in range(9))])
    saved = {name if name in "xyz" else prefix + name: values for name, values in table.items()}
    check_inria(load_bytes(ply_files.ply(saved, types=dict.fromkeys("xyz", "double"))), table)
    mine = table | {f"{prefix}opacity": table["x"], prefix: table["y"]}
    check_inria(load_bytes(ply_files.ply(mine)), table)  # a column's own name comes first


def test_harmonics_of_no_whole_degree(rng, load_bytes):
    """What a degree needs is read, channel by channel; what is left over is told."""
    for count, degree in ((15, 1), (27, 2), (3, 0), (44, 0)):
        table = ply_files.columns(rng, [*INRIA, *(f"f_rest_{i}" for i in range(count))])
        with pytest.warns(fg.LossWarning, match=f"{count} columns .* degree {degree} is read"):
            model = load_bytes(ply_files.ply(table))
        each, terms = count // 3, (degree + 1) ** 2 - 1
        wanted = {f"f_rest_{c * terms + b}": table[f"f_rest_{c * each + b}"] for c in range(3) for b in range(terms)}
        check_inria(model, {name: table[name] for name in INRIA} | wanted)
    table = ply_files.columns(rng, [*INRIA, *(f"f_rest_{i}" for i in range(1, 10))])
    with pytest.warns(fg.LossWarning, match="9 columns .* degree 0 is read"):
        check_inria(load_bytes(ply_files.ply(table)), {name: table[name] for name in INRIA})


@pytest.mark.parametrize("kind", FORMATS)
def test_many_blocks(rng, load_bytes, kind):
    table = ply_files.columns(rng, INRIA, 30_000 if kind == "ascii" else 120_000)
    check_inria(load_bytes(ply_files.ply(table, kind)), table)


def test_comments_of_others_are_passed_over(rng, load_bytes):
    table = ply_files.columns(rng, INRIA)
    said = ["fastgs", "fastgs trained for {", "fastgs basis {", "FastGS axes RFU", "fastgs-axes 1"]
    assert load_bytes(ply_files.ply(table, comments=said)).axes == "RDF"
    assert load_bytes(ply_files.ply(table, comments=['fastgs axes "RFU"'])).axes == "RFU"
    with pytest.raises(fg.FastGSError, match="JSON"):
        load_bytes(ply_files.ply(table, comments=["fastgs axes RFU"]))


def test_a_prefix_is_not_a_name(rng, load_bytes):
    table = ply_files.columns(rng, ["f_dc_00", "rot_01", "xx", "scale", *INRIA])
    check_inria(load_bytes(ply_files.ply(table)), table)


@pytest.mark.parametrize(("comment", "antialiased"), [
    ("SplatRenderMode: mip", True), ("SplatRenderMode: default", False), ("antialiased 1", True), ("antialiased 0", False)])
def test_render_mode(rng, load_bytes, comment, antialiased):
    model = load_bytes(ply_files.ply(ply_files.columns(rng, INRIA), comments=[comment]))
    assert model.raster == fg.Raster(antialiased=antialiased)


@pytest.mark.parametrize("appearance", ["sh0", "sh2", "sh4"])
def test_inria_round_trip(rng, make_model, tmp_path, appearance):
    model = make_model(rng, appearance=appearance, axes="RFU", raster=fg.Raster(0.1, 0.999, 1 / 300, 0.01, True),
                       clip=fg.Clip(1, 25.0, 7), colour_space="linear", provenance={"trainer": "müller\n\"x\""})
    fg.save(model, tmp_path / "a.ply")
    back = fg.load(tmp_path / "a.ply")
    for name, array in model.arrays.items():
        if name != "mu_tau":  # means nothing where nothing depends on time
            np.testing.assert_array_equal(back.arrays[name], array)
    for name in ("raster", "axes", "clip", "colour_space", "provenance", "appearance"):
        assert getattr(back, name) == getattr(model, name)
    assert identify(tmp_path / "a.ply").name == "INRIA PLY"
    assert b"comment SplatRenderMode: mip\n" in (tmp_path / "a.ply").read_bytes()


def test_inria_is_written_as_other_tools_expect(rng, make_model, tmp_path):
    fg.save(make_model(rng, appearance="sh3"), tmp_path / "a.ply")
    header = (tmp_path / "a.ply").read_bytes().partition(b"end_header")[0].decode().splitlines()
    names = [line.split()[2] for line in header if line.startswith("property float")]
    assert names == ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(45)), "opacity",
                     "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]


def test_rgb_becomes_the_same_colour_as_sh(rng, make_model, tmp_path):
    model = make_model(rng)
    fg.save(model, tmp_path / "a.ply")
    back = fg.load(tmp_path / "a.ply")
    colour = np.maximum(0, 0.5 + back.features * sh_basis(np.array([0.0, 0, 1]), 0))
    np.testing.assert_allclose(colour, model.features, atol=1e-6)


def test_negative_colours_are_said_to_be_lost(rng, make_model, tmp_path):
    with pytest.warns(fg.LossWarning, match="negative colours"):
        fg.save(make_model(rng, features=np.full((40, 3), -0.5)), tmp_path / "a.ply")


def test_real_scan(shared_data, tmp_path):
    model = fg.load(shared_data / "scan" / "leica-sofort.ply")
    assert (len(model), model.appearance) == (8192, fg.SH(3))
    assert np.isfinite(model.features).all()
    assert 0.5 < np.mean(np.abs(np.linalg.norm(model.rotation, axis=1))) < 2
    fg.save(model, tmp_path / "again.ply")
    again = fg.load(tmp_path / "again.ply")
    assert all(np.array_equal(again.arrays[k], a) for k, a in model.arrays.items())


def without(*names):
    return [n for n in INRIA if n not in names]


@pytest.mark.parametrize(("names", "text"), [
    (without("scale_2"), "2DGS"),
    (["x", "y", "z", "red", "green", "blue"], "point cloud.*no opacity, f_dc_0"),
    (without("rot_3", "opacity"), "incomplete.*no opacity, rot_3"),
    ([*INRIA, "motion_0", "motion_1", "motion_2"], "4D model"),
])
def test_other_ply_files_are_named(rng, load_bytes, names, text):
    with pytest.raises(fg.FastGSError, match=text):
        load_bytes(ply_files.ply(ply_files.columns(rng, names)))


def test_a_mesh_is_called_a_mesh(rng, load_bytes):
    with pytest.raises(fg.FastGSError, match="a mesh"):
        load_bytes(ply_files.ply(ply_files.columns(rng, "xyz"), after=[ply_files.faces("<")]))


def test_surfels_by_comment(rng, load_bytes):
    with pytest.raises(fg.FastGSError, match="2DGS"):
        load_bytes(ply_files.ply(ply_files.columns(rng, INRIA), comments=["SplatRenderMode: 2dgs"]))


HOSTILE = {
    "no format": ("format binary_little_endian 1.0\n", ""),
    "two formats": ("format binary_little_endian 1.0\n", "format ascii 1.0\nformat ascii 1.0\n"),
    "unknown format": ("binary_little_endian", "binary_middle_endian"),
    "unknown type": ("property float y", "property quad y"),
    "twice the same name": ("property float y", "property float x"),
    "a name is missing": ("property float y", "property float"),
    "negative count": ("vertex 6", "vertex -6"),
    "no count": ("vertex 6", "vertex"),
    "count too large": ("vertex 6", "vertex 7"),
    "count far too large": ("vertex 6", "vertex 99999999999999999"),
    "endless count": ("vertex 6", "vertex " + "9" * 10_000),
    "count too small": ("vertex 6", "vertex 5"),
    "two vertex elements": ("element vertex", "element vertex 0\nelement vertex"),
    "a property of nothing": ("element vertex", "property float x\nelement vertex"),
    "lists in vertices": ("property float y", "property list uchar float y2\nproperty float y"),
    "lists counted in floats": ("property float y", "property list float float y2\nproperty float y"),
    "a huge element before": ("element vertex", "element camera 999999999999999999\nproperty double f\nelement vertex"),
    "huge lists before": ("element vertex", "element face 999999999999999999\nproperty list uchar int f\nelement vertex"),
    "many lists before": ("element vertex", "element face 4000000\nproperty list uchar int f\nelement vertex"),
    "a huge element after": ("end_header", "element camera 999999999999999999\nproperty double f\nend_header"),
    "no end": ("end_header\n", ""),
    "unknown keyword": ("end_header", "whatever\nend_header"),
    "endless header": ("end_header", f"comment {'x' * 91}\n" * 20_000 + "end_header"),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_headers_cost_one_sentence_and_no_memory(rng, load_bytes, kind, case):
    old, new = HOSTILE[case]
    data = ply_files.ply(ply_files.columns(rng, INRIA), kind)
    bad = data.replace(old.replace("binary_little_endian", kind).encode(), new.encode(), 1)
    assert bad != data
    tracemalloc.start()
    try:
        with pytest.raises(fg.FastGSError) as error:
            load_bytes(bad)
        assert tracemalloc.get_traced_memory()[1] < 64 << 20
    finally:
        tracemalloc.stop()
    assert str(error.value).count("\n") == 0


@pytest.mark.parametrize("kind", FORMATS)
def test_truncation_anywhere(rng, load_bytes, kind):
    data = ply_files.ply(ply_files.columns(rng, INRIA, 3), kind)
    for length in range(0, len(data) - (20 if kind == "ascii" else 1), 7):
        with pytest.raises(fg.FastGSError):
            load_bytes(data[:length])


@pytest.mark.parametrize("kind", FORMATS)
def test_rubbish_at_the_end_is_refused_and_space_is_not(rng, load_bytes, kind):
    table = ply_files.columns(rng, INRIA)
    data = ply_files.ply(table, kind)
    check_inria(load_bytes(data + b"\n\n"), table)
    with pytest.raises(fg.FastGSError, match="more.*header"):
        load_bytes(data + b"12345")


@pytest.mark.parametrize("junk", [b"1.0 x", b"9" * 5000, b"\xff\xfe"])
def test_ascii_junk(rng, load_bytes, junk):
    data = ply_files.ply(ply_files.columns(rng, INRIA), "ascii")
    head, body = data.split(b"end_header\n")
    with pytest.raises(fg.FastGSError):
        load_bytes(head + b"end_header\n" + junk + b" " + body)


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize(("name", "value"), [("x", np.nan), ("f_dc_1", np.inf), ("rot_0", -np.inf), ("scale_2", np.inf),
                                             ("opacity", np.nan), ("z", 1e30), ("scale_0", 1e6)])
def test_unusable_gaussians_are_left_out_and_said(rng, load_bytes, kind, name, value):
    table = ply_files.columns(rng, INRIA)
    table[name][[1, 4]] = value
    if kind == "ascii":
        table = {k: np.asarray(v, np.float64) for k, v in table.items()}
    with pytest.warns(fg.LossWarning, match="2 of 6 Gaussians"):
        model = load_bytes(ply_files.ply(table, kind))
    check_inria(model, {k: v[[0, 2, 3, 5]].astype(np.float32) for k, v in table.items()})


def test_nothing_but_nan_is_refused(rng, load_bytes):
    table = {k: np.full_like(v, np.nan) for k, v in ply_files.columns(rng, INRIA).items()}
    with pytest.raises(fg.FastGSError, match="none.*6 Gaussians"):
        load_bytes(ply_files.ply(table))


def test_infinities_with_a_meaning_stay(rng, load_bytes):
    table = ply_files.columns(rng, INRIA)
    table["opacity"][:2], table["scale_2"][:] = (np.inf, -np.inf), -np.inf
    model = load_bytes(ply_files.ply(table))
    assert len(model) == 6
    np.testing.assert_allclose(fg.slice_model(model, 0, cull=False).opacity[:2], (1, 0), atol=1e-12)
    assert (np.exp(model.scale[:, 2]) < 1e-15).all()


def test_doubles_beyond_float_are_unusable(rng, load_bytes):
    table = {k: v.astype(np.float64) for k, v in ply_files.columns(rng, INRIA).items()}
    table["y"][0] = 1e300
    with pytest.warns(fg.LossWarning, match="1 of 6.*position"):
        assert len(load_bytes(ply_files.ply(table, types={"y": "double"}))) == 5


def test_no_gaussians_at_all(rng, load_bytes):
    assert len(load_bytes(ply_files.ply(ply_files.columns(rng, INRIA, 0)))) == 0


def test_a_million_gaussians_are_read_block_by_block(rng, tmp_path):
    """Peak memory is the model and one block, never the file beside the model."""
    model = fg.GaussianModel(np.zeros((100_000, 3)), np.ones((100_000, 4)), np.zeros((100_000, 3)), np.zeros(100_000),
                             np.zeros((100_000, 48)), appearance=fg.SH(3))
    fg.save(model, tmp_path / "a.ply")
    tracemalloc.start()
    fg.load(tmp_path / "a.ply")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1.7 * model.nbytes

# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenUSD's ParticleField3DGaussianSplat, by the library that Blender brings along: written and read, still and with time samples."""
from __future__ import annotations

import io
import zipfile
from dataclasses import replace

import mutations
import numpy as np
import pytest
from claims import liars
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.formats import usd

pytestmark = [pytest.mark.usefixtures("pxr"), pytest.mark.filterwarnings("ignore::fastgs_blender.LossWarning")]


def same(a: fg.GaussianModel, b: fg.GaussianModel) -> None:
    """Two static models show the same."""
    a, b = (fg.slice_model(m, 0, cull=False) for m in (a, b))
    np.testing.assert_allclose(a.position, b.position, atol=1e-5)
    np.testing.assert_allclose(a.scale, b.scale, rtol=1e-5)
    np.testing.assert_allclose(a.opacity, b.opacity, atol=1e-6)
    np.testing.assert_allclose(np.abs(np.sum(a.rotation * b.rotation, 1)), 1, atol=1e-6)
    np.testing.assert_allclose(a.features, b.features, atol=1e-5)


@pytest.mark.parametrize("extension", [".usdc", ".usda"])
@pytest.mark.parametrize("degree", [0, 2, 3])
def test_what_is_written_is_read(tmp_path, extension, degree):
    model = random_model(np.random.default_rng(1), 20, appearance=f"sh{degree}", axes="RFU")
    fg.save(model, tmp_path / f"m{extension}")
    again = fg.load(tmp_path / f"m{extension}")
    assert again.axes == "RFU" and again.appearance == fg.SH(degree)
    same(model, again)


EXAMPLE = """#usda 1.0
( upAxis = "Y" )
def Xform "Root" {
    double3 xformOp:translate = (10, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def ParticleField3DGaussianSplat "Splat" (
        prepend references = @missing.usda@
    ) {
        point3f[] positions.timeSamples = { 10: [(0, 0, 0), (1, 2, 3)], 11: [(2, 0, 0), (3, 2, 3)], 13: [(6, 0, 0), (7, 2, 3)] }
        float3[] scales = [(1, 1, 1), (0.5, 1, 2)]
        quath[] orientationsh = [(1, 0, 0, 0), (0.5, 0.5, 0.5, 0.5)]
        float[] opacities = [0.5, 1]
        int radiance:sphericalHarmonicsDegree = 0
        float3[] radiance:sphericalHarmonicsCoefficients = [(0.1, 0.2, 0.3), (1, 0, -1)]
    }
}
"""


def test_a_file_by_hand(tmp_path):
    """Time samples with a gap, half precision, a parent's transform, a reference that leads nowhere."""
    (tmp_path / "m.usda").write_text(EXAMPLE)
    source = fg.open_source(tmp_path / "m.usda")
    assert (source.clip.frame_count, source.clip.fps, source.axes) == (4, 24.0, "RUB")
    for frame, x in ((0, 10), (1, 12), (3, 16)):
        shown = source.moment(source.clip.t_of_frame(frame))[0]
        np.testing.assert_allclose(shown.position, [(x, 0, 0), (x + 1, 2, 3)], atol=1e-5)
    s = fg.slice_model(shown, 0, cull=False)
    np.testing.assert_allclose(s.scale[1], (0.5, 1, 2), rtol=1e-5)
    np.testing.assert_allclose(s.rotation[1], (0.5, 0.5, 0.5, 0.5), atol=1e-6)
    np.testing.assert_allclose(s.opacity, (0.5, 1), atol=1e-6)
    np.testing.assert_allclose(s.features[1], (1, 0, -1))


def test_frames_are_time_samples(tmp_path):
    models = [random_model(np.random.default_rng(i), 5 + i, appearance="sh1", axes="RFU") for i in range(3)]
    usd.write_frames(tmp_path / "m.usdc", ".usdc", [(float(i), model) for i, model in enumerate(models)], 30.0)
    source = fg.open_source(tmp_path / "m.usdc")
    assert source.clip == fg.Clip(3, 30.0)
    for i, model in enumerate(models):
        same(model, source.moment(i / 3)[0])


@pytest.mark.parametrize("extension", [".usdc", ".usda"])
def test_parts_are_prims(tmp_path, extension):
    """One for each, and one for what belongs to none; their names come back as far as USD allows them."""
    from pxr import Usd

    model = random_model(np.random.default_rng(2), 9, appearance="sh1", axes="RFU")
    bits = {"Red ball": np.arange(9) % 3 == 0, "Red_ball": np.arange(9) % 3 == 1}
    fg.save(replace(model, parts=fg.Parts.of(bits)), tmp_path / f"m{extension}")
    stage = Usd.Stage.Open(str(tmp_path / f"m{extension}"))
    assert {prim.GetName() for prim in stage.GetDefaultPrim().GetChildren()} == {"Red_ball", "Red_ball_1", "Gaussians"}
    back = fg.load(tmp_path / f"m{extension}")
    assert len(back) == 9
    same(back.take(back.parts["Red_ball"]), model.take(bits["Red ball"]))
    same(back.take(back.parts["Red_ball_1"]), model.take(bits["Red_ball"]))


def test_a_part_may_be_shown_for_some_frames_alone(tmp_path):
    model = random_model(np.random.default_rng(4), 6, appearance="sh0", axes="RFU")
    with_parts = replace(model, parts=fg.Parts.of({"Late": np.arange(6) >= 4}))
    usd.write_frames(tmp_path / "m.usdc", ".usdc", [(0.0, model.take(np.arange(4))), (1.0, with_parts), (2.0, model.take(np.arange(4)))])
    source = fg.open_source(tmp_path / "m.usdc")
    assert [len(source.moment(i / 3)[0]) for i in range(3)] == [4, 6, 4]


def test_other_files_are_told_apart(tmp_path):
    (tmp_path / "mesh.usda").write_text('#usda 1.0\ndef Mesh "Cube" {}\n')
    with pytest.raises(fg.FastGSError, match=r"mesh\.usda.*without Gaussians"):
        fg.load(tmp_path / "mesh.usda")
    (tmp_path / "broken.usda").write_text("#usda 1.0\ndef {")
    with pytest.raises(fg.FastGSError, match=r"broken\.usda.*damaged"):
        fg.load(tmp_path / "broken.usda")


def test_no_other_file_is_opened(tmp_path):
    """Neither a reference nor a payload nor clips of values lead out of the file, in variants as little as elsewhere."""
    other = f"@{tmp_path / 'other.usda'}@"
    (tmp_path / "other.usda").write_text(EXAMPLE)
    clips = f"clips = {{ dictionary default = {{ asset[] assetPaths = [{other}]; string primPath = '/Root' }} }}"
    for outside in (f"references = {other}</Root>", f"payload = {other}</Root>", clips):
        inner = f'def Xform "Inner" (\n{outside}\n) {{\n}}\n'
        variants = f'variantSet "v" = {{\n"a" (\n{outside}\n) {{\n{inner}}}\n}}\n'
        for said, held in ((outside, inner), ('variants = {\nstring v = "a"\n}\nprepend variantSets = "v"', variants)):
            (tmp_path / "m.usda").write_text(f'#usda 1.0\ndef Xform "A" (\n{said}\n) {{\n{held}}}\n')
            with pytest.raises(fg.FastGSError, match="without Gaussians"):
                fg.load(tmp_path / "m.usda")


@pytest.mark.parametrize("typed", [True, False])
def test_a_file_in_the_place_of_numbers_is_not_looked_for(tmp_path, typed):
    """USD asks the system for a path as soon as such a value is read, whatever type the attribute says that it has."""
    from pxr import Sdf

    usd.write_frames(tmp_path / "m.usdc", ".usdc", [(None, random_model(np.random.default_rng(3), 2, appearance="sh0"))])
    layer = Sdf.Layer.OpenAsAnonymous(str(tmp_path / "m.usdc"))
    prim = layer.GetPrimAtPath("/Splats/Gaussians")
    if typed:
        prim.RemoveProperty(prim.attributes["positions"])
        Sdf.AttributeSpec(prim, "positions", Sdf.ValueTypeNames.Asset)
    prim.attributes["positions"].SetInfo("default", Sdf.AssetPath("//host/share/a.usd"))
    layer.Export(str(tmp_path / "forged.usdc"))
    with pytest.raises(fg.FastGSError, match=r"forged\.usdc.*/Splats/Gaussians\.positions.*file"):
        fg.load(tmp_path / "forged.usdc")


@pytest.mark.slow
@pytest.mark.parametrize("extension", [".usda", ".usdc", ".usdz"])
def test_mutated_files(tmp_path, extension):
    inner = extension.replace("usdz", "usdc")
    fg.save(random_model(np.random.default_rng(2), 3, appearance="sh1"), tmp_path / f"still{inner}")
    models = [random_model(np.random.default_rng(i), 2, appearance="sh0", axes="RFU") for i in range(2)]
    usd.write_frames(tmp_path / f"frames{inner}", inner, [(float(i), model) for i, model in enumerate(models)], 30.0)
    seeds = {name: {"m" + extension: (tmp_path / f"{name}{inner}").read_bytes()} for name in ("still", "frames")}
    seeds |= {"by hand": {"m.usda": EXAMPLE.encode()}} if extension == ".usda" else {}
    if extension == ".usdz":
        seeds = {name: {"m.usdz": packaged(files["m.usdz"])} for name, files in seeds.items()}
    told = mutations.campaign(f"usd {extension}", mutations.shows(f"m{extension}"), seeds, tmp_path / "seeds")
    assert min(told.values(), default=1) > 0


def packaged(layer: bytes) -> bytes:
    """A .usdz: a zip file of plain members that begin at multiples of 64 bytes."""
    name, out = "scene.usdc", io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        info = zipfile.ZipInfo(name)
        info.extra = b"\x86\x19" + (64 - 30 - len(name) - 4).to_bytes(2, "little") + bytes(64 - 30 - len(name) - 4)
        archive.writestr(info, layer)
    return out.getvalue()


def test_a_model_of_no_gaussians_is_loaded_again(rng, tmp_path):
    for name in ("none.usdc", "none.usda"):
        fg.save(random_model(rng, 0), tmp_path / name)
        assert len(fg.load(tmp_path / name)) == 0


def test_no_memory_on_the_word_of_a_file(tmp_path):
    """Pixar's library makes its arrays in C++, unseen by tracemalloc: so the process may take 64 MB; the claimed positions are 96 MB."""
    count = 211
    for extension in (".usdc", ".usda"):
        fg.save(random_model(np.random.default_rng(3), count, appearance="sh0"), tmp_path / f"m{extension}")
        whole = (tmp_path / f"m{extension}").read_bytes()
        lies = {f"{extension} {what}": {f"m{extension}": data} for what, data in liars(whole, count, len(whole))}
        told = mutations.attacks("usd", lambda folder, name=f"m{extension}": fg.load(folder / name), lies, tmp_path / extension,
                                 memory=64 << 20)
        assert told["refused"], extension

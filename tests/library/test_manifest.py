# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's manifest and zip, checked by Blender's own tool (it comes with bpy, and is not Blender itself)."""
from __future__ import annotations

import importlib.util
import tomllib
import zipfile
from pathlib import Path

import pytest

import fastgs_blender as fg

ROOT = Path(__file__).resolve().parents[2]
TAGS = {"3D View", "Animation", "Bake", "Camera", "Import-Export", "Material", "Mesh", "Node", "Object", "Pipeline", "Render", "Scene"}


@pytest.fixture(scope="module")
def builder():
    """tools/build_extension.py"""
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("the extension tool comes with bpy, which is not installed")
    spec = importlib.util.spec_from_file_location("build_extension", ROOT / "tools" / "build_extension.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def manifest():
    return tomllib.loads((ROOT / "blender_manifest.toml").read_text("utf-8"))


def test_blender_accepts_the_repository_as_it_stands(builder):
    builder.blender_ext("validate", str(ROOT))


def test_blender_refuses_a_spoilt_manifest(builder, tmp_path):
    (tmp_path / "__init__.py").write_text("")
    text = (ROOT / "blender_manifest.toml").read_text("utf-8")
    (tmp_path / "blender_manifest.toml").write_text(text.replace('id = "fastgs_blender"', 'id = "fastgs-blender"'))
    with pytest.raises(SystemExit, match="id"):
        builder.blender_ext("validate", str(tmp_path))


def test_manifest_says_what_the_library_says(manifest):
    assert manifest["version"] == fg.__version__
    assert manifest["blender_version_min"] == "4.2.0"
    assert manifest["license"] == ["SPDX:GPL-3.0-or-later"]
    assert set(manifest["tags"]) <= TAGS
    assert not {"wheels", "platforms"} & set(manifest)


def test_zip_holds_the_extension_and_nothing_else(builder, tmp_path, capsys):
    (path,) = builder.main(["--no-wheels", "--out", str(tmp_path)])
    with zipfile.ZipFile(path) as file:
        names = {name for name in file.namelist() if not name.endswith("/")}
    wanted = {"__init__.py", "blender_manifest.toml", "LICENSE", "README.md"}
    wanted |= {str(p.relative_to(ROOT)) for package in ("fastgs_blender", "engine", "operators", "ui")
               for p in (ROOT / package).rglob("*.py")}
    assert names == wanted
    assert str(path) in capsys.readouterr().out


def test_wheels_are_named_in_the_staged_manifest_alone(builder, manifest):
    text = (ROOT / "blender_manifest.toml").read_text("utf-8")
    staged = tomllib.loads(builder.with_wheels(text, "linux-x64", [Path("/x/numba-1-cp311-cp311-linux_x86_64.whl")]))
    added = {"platforms": ["linux-x64"], "wheels": ["./wheels/numba-1-cp311-cp311-linux_x86_64.whl"]}
    assert staged == manifest | added

# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's manifest and zip, checked by Blender's own tool (it comes with bpy, and is not Blender itself)."""
from __future__ import annotations

import hashlib
import importlib
import importlib.metadata
import importlib.util
import json
import os
import re
import tomllib
import zipfile
from pathlib import Path
from types import SimpleNamespace

import pytest

import fastgs_blender as fg

ROOT = Path(__file__).resolve().parents[2]
TAGS = {"3D View", "Animation", "Bake", "Camera", "Import-Export", "Material", "Mesh", "Node", "Object", "Pipeline", "Render", "Scene"}


@pytest.fixture(scope="module")
def wheels():
    """tools/wheels.py"""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "tools")
        yield importlib.import_module("wheels")


@pytest.fixture(scope="module")
def builder(wheels):
    """tools/build_extension.py"""
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("the extension tool comes with bpy, which is not installed")
    return importlib.import_module("build_extension")


@pytest.fixture
def wheel(tmp_path):
    """wheel(name): a wheel with nothing in it but its metadata and licence."""
    def make(name, requires=(), licence="Do what you like."):
        package, version = name.split("-")[:2]
        path = tmp_path / f"{name}.whl"
        with zipfile.ZipFile(path, "w") as file:
            lines = ["Metadata-Version: 2.1", f"Name: {package}", f"Version: {version}", *(f"Requires-Dist: {r}" for r in requires)]
            file.writestr(f"{package}-{version}.dist-info/METADATA", "\n".join([*lines, "", ""]))
            if licence:
                file.writestr(f"{package}-{version}.dist-info/licenses/LICENSE", licence)
        return path

    return make


@pytest.fixture
def numbas(wheel):
    """numbas(python="3.11"): the wheels of one platform and Python, so to speak."""
    def make(python="3.11"):
        tag = f"cp{python.replace('.', '')}"
        return [wheel(f"numba-0.68.1-{tag}-{tag}-win_amd64", ["llvmlite<0.51,>=0.50.0dev0", "numpy<2.6,>=1.22"]),
                wheel(f"llvmlite-0.50.0-{tag}-{tag}-win_amd64", licence="LLVM's terms"),
                wheel("tqdm-4.70.1-py3-none-any"), wheel("safetensors-0.8.0-cp310-abi3-win_amd64")]

    return make


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
    assert set(manifest["permissions"]) == {"files", "network"} and "Make an Environment" in manifest["permissions"]["network"]


def test_zip_holds_the_extension_and_nothing_else(builder, tmp_path, capsys):
    (path,) = builder.main(["--no-wheels", "--out", str(tmp_path)])
    with zipfile.ZipFile(path) as file:
        names = {name for name in file.namelist() if not name.endswith("/")}
    wanted = {"__init__.py", "blender_manifest.toml", "LICENSE", "README.html", "examples/fireside.safetensors",
              "examples/capture_train_render.py", "examples/cameras.json"}
    wanted |= {str(p.relative_to(ROOT)) for package in ROOT.glob("*/__init__.py")
               for suffix in ("py", "wgsl") for p in package.parent.rglob(f"*.{suffix}")}
    player = ROOT / "fastgs_blender" / "formats" / "web" / "player"
    wanted |= {str(p.relative_to(ROOT)) for p in player.rglob("*") if p.is_file()}
    wanted |= {"CHANGELOG.html", *(f"docs/{page.stem}.html" for page in (ROOT / "docs").glob("*.md"))}
    wanted |= {f"docs/{name}" for page in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
               for name in re.findall(r"\]\((?:docs/)?([\w.-]+\.(?:png|webp))\)", page.read_text("utf-8"))}
    assert {"scene/__init__.py", "engine/__init__.py"} <= wanted
    assert names == wanted
    assert str(path) in capsys.readouterr().out


def test_the_zips_pages_lead_to_one_another(builder, tmp_path):
    """Every link of every page ends at a file of the zip and, where it names one, at a heading of it."""
    stage = tmp_path / "stage"
    builder.copy_content(stage)
    pages = {page: page.read_text("utf-8") for page in stage.rglob("*.html")}
    headings = {page: set(re.findall(r'<h\d id="([^"]+)"', text)) for page, text in pages.items()}
    links = {(page, link) for page, text in pages.items() for link in re.findall(r'(?:href|src)="([^"]+)"', text)
             if not re.match(r"\w+:", link)}
    for page, link in links:
        name, _, heading = link.partition("#")
        target = Path(os.path.normpath(page.parent / name)) if name else page
        assert target.exists() and (not heading or heading in headings[target]), (page.name, link)
    readme = pages[stage / "README.html"]
    assert "<h1" in readme and "<table>" in readme and '<img src="docs/first-light.webp"' in readme
    assert (stage / "README.html", "docs/colour.html") in links
    assert (stage / "docs" / "README.html", "captures.html#check-my-capture") in links
    assert "CONTRIBUTING.md" in readme and "CONTRIBUTING.html" not in readme  # a name, where the file is not there


def test_wheels_and_website_are_named_in_the_staged_manifest_alone(builder, manifest, tmp_path):
    text = (ROOT / "blender_manifest.toml").read_text("utf-8")
    staged = tomllib.loads(builder.completed(text, "linux-x64", [Path("/x/numba-1-cp311-cp311-linux_x86_64.whl")], "https://a.example/b"))
    added = {"platforms": ["linux-x64"], "wheels": ["./wheels/numba-1-cp311-cp311-linux_x86_64.whl"], "website": "https://a.example/b"}
    assert staged == manifest | added
    (path,) = builder.main(["--no-wheels", "--website", "https://a.example/b", "--out", str(tmp_path)])
    with zipfile.ZipFile(path) as file:
        assert tomllib.loads(file.read("blender_manifest.toml").decode())["website"] == "https://a.example/b"


def test_wheels_that_fit_together(wheels, wheel, numbas):
    assert not wheels.problems(numbas())
    assert wheels.problems([wheel("numpy-2.1.0-cp311-cp311-win_amd64")]) == ["numpy is Blender's own."]
    assert wheels.problems(numbas()[:1]) == ["numba-0.68.1-cp311-cp311-win_amd64.whl needs llvmlite<0.51,>=0.50.0dev0, which is not there."]
    assert not wheels.problems([wheel("x-1-py3-none-any", ["pytest; extra == 'test'", "requests>2"])])
    for requirement, python, numpy in ("numpy>=1.26", "3.11", "1.24.3"), ("numpy<2.5", "3.13", "2.5.5"):
        found = wheels.problems([wheel("x-1-cp310-abi3-win_amd64", [requirement])])
        assert f"x-1-cp310-abi3-win_amd64.whl does not go with numpy {numpy} of Blenders with Python {python}." in found


def test_what_the_tests_run_with_goes_with_every_blender(wheels, wheel):
    """The zip gets the installed versions: what their makers say they need is there in each Blender."""
    made = [wheel(f"{name}-{importlib.metadata.version(name)}-cp310-abi3-win_amd64", importlib.metadata.requires(name) or ())
            for name in wheels.PACKAGES]
    assert not wheels.problems(made)
    shipped = {line.split("<")[0].split(">")[0].split("=")[0].strip() for line in importlib.metadata.requires("bpy") or ()}
    assert shipped <= wheels.SHIPPED


def test_licences_are_told(wheels, wheel, numbas):
    text = wheels.notices([*numbas(), wheel("numba-0.68.1-cp313-cp313-win_amd64")])
    assert text.count("| numba | 0.68.1 | BSD-2-Clause |") == 1
    assert "| llvmlite | 0.50.0 | BSD-2-Clause AND Apache-2.0 WITH LLVM-exception |" in text
    assert "## llvmlite: LICENSE\n\nLLVM's terms" in text
    with pytest.raises(ValueError, match="numba-1-py3-none-any.whl brings no text of its licence"):
        wheels.notices([wheel("numba-1-py3-none-any", licence="")])


def test_what_finds_poses_comes_along_where_there_is_room(wheels, tmp_path, monkeypatch, capsys):
    sizes = {"llvmlite": 90, "pycolmap": 20}

    def run(command, **options):
        wanted, folder = command[-1], next(Path(part.removeprefix("--dest=")) for part in command if part.startswith("--dest="))
        package = wanted.partition("==")[0]
        if package in sizes:
            with (folder / f"{package}-1-py3-none-any.whl").open("wb") as file:
                file.truncate(sizes[package] * 1_000_000)
        return SimpleNamespace(returncode=int(package == "pycolmap" and package not in sizes), stderr="ERROR: no")

    monkeypatch.setattr(wheels.subprocess, "run", run)
    found = [path.name.partition("-")[0] for path in wheels.download("linux-x64", "3.13", tmp_path / "a")]
    assert found == ["llvmlite", "pycolmap"] and not capsys.readouterr().out
    sizes["llvmlite"] = 110
    assert [path.name.partition("-")[0] for path in wheels.download("linux-x64", "3.13", tmp_path / "b")] == ["llvmlite"]
    assert "goes without pycolmap: the zip would have 130 MB of wheels" in capsys.readouterr().out
    del sizes["pycolmap"]
    assert len(wheels.download("linux-x64", "3.13", tmp_path / "c")) == 1 and "no wheel of it" in capsys.readouterr().out


def test_a_repository_of_zips(builder, wheels, numbas, tmp_path, monkeypatch, capsys):
    """A zip for each platform and Python, and Blender's index of them; one whose wheels are not to be had is told, the others are built."""
    def download(platform, python, folder):
        if platform == "macos-arm64" and python == "3.13":
            raise wheels.Missing("macos-arm64 with Python 3.13 is left out: no such wheel.")
        return numbas(python)

    monkeypatch.setattr(wheels, "download", download)
    out = tmp_path / "dist"
    with pytest.raises(SystemExit, match="macos-arm64 with Python 3.13 is left out"):
        builder.main(["--python", "3.11", "--python", "3.13", "--out", str(out)])
    kinds = [("linux-x64", "3.11"), ("linux-x64", "3.13"), ("macos-arm64", "3.11"), ("windows-x64", "3.11"), ("windows-x64", "3.13")]
    zips = {kind: out / f"fastgs_blender-{fg.__version__}-{kind[0]}-python{kind[1]}.zip" for kind in kinds}
    assert sorted(out.iterdir()) == sorted([*zips.values(), out / "index.json"])
    for (_, python), path in zips.items():
        with zipfile.ZipFile(path) as file:
            names = {name.removeprefix("wheels/") for name in file.namelist() if name.startswith("wheels/") and name != "wheels/"}
            assert "THIRD-PARTY.md" in file.namelist() and names == {wheel.name for wheel in numbas(python)}
    entries = json.loads((out / "index.json").read_text("utf-8"))["data"]
    found = {(*entry["platforms"], *entry["python_versions"]): entry for entry in entries}
    assert found.keys() == zips.keys()  # Blender takes the one that fits its own platform and Python
    for kind, path in zips.items():
        entry = found[kind]
        assert entry["archive_url"] == f"./{path.name}"
        assert entry["archive_size"] == path.stat().st_size
        assert entry["archive_hash"] == f"sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}"
        assert entry["id"] == "fastgs_blender"
    printed = capsys.readouterr().out
    assert f"{zips['windows-x64', '3.11']}: " in printed
    assert "numba-0.68.1-cp311-cp311-win_amd64.whl: 0.0 MB, BSD-2-Clause" in printed

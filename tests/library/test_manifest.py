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
import subprocess
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
    assert set(manifest["permissions"]) == {"files", "clipboard", "network"}
    assert "Make an Environment" in manifest["permissions"]["network"]


def test_zip_holds_the_extension_and_nothing_else(builder, tmp_path, capsys):
    (path,) = builder.main(["--no-wheels", "--out", str(tmp_path)])
    with zipfile.ZipFile(path) as file:
        names = {name for name in file.namelist() if not name.endswith("/")}
    wanted = {"__init__.py", "blender_manifest.toml", "LICENSE", "README.html", "sbom.cdx.json", "examples/LICENSE.txt",
              "examples/fireside.safetensors", "examples/capture_train_render.py", "examples/cameras.json"}
    wanted |= {str(p.relative_to(ROOT)) for package in ROOT.glob("*/__init__.py")
               for p in package.parent.rglob("*") if p.is_file() and p.suffix != ".pyc"}
    wanted |= {"CHANGELOG.html", *(f"docs/{page.stem}.html" for page in (ROOT / "docs").glob("*.md"))}
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
    assert "<h1" in readme and "<table>" in readme and not any("<img" in text for text in pages.values())
    assert (stage / "README.html", "docs/colour.html") in links
    assert (stage / "docs" / "README.html", "captures.html#check-my-capture") in links
    assert "CONTRIBUTING.md" in readme and "CONTRIBUTING.html" not in readme  # a name, where the file is not there


def test_wheels_and_website_are_named_in_the_staged_manifest_alone(builder, manifest, tmp_path):
    text = (ROOT / "blender_manifest.toml").read_text("utf-8")
    staged = tomllib.loads(builder.completed(text, "linux-x64", [Path("/x/numba-1-cp311-cp311-linux_x86_64.whl")], "https://a.example/b"))
    added = {"platforms": ["linux-x64"], "wheels": ["./wheels/numba-1-cp311-cp311-linux_x86_64.whl"], "website": "https://a.example/b"}
    assert staged == manifest | added | {"copyright": [*manifest["copyright"], "2012-2026 Anaconda, Inc. (numba)"]}
    (path,) = builder.main(["--no-wheels", "--website", "https://a.example/b", "--out", str(tmp_path)])
    with zipfile.ZipFile(path) as file:
        assert tomllib.loads(file.read("blender_manifest.toml").decode())["website"] == "https://a.example/b"
        sentences = {}
        exec(file.read("fastgs_blender/util/documentation.py"), sentences)  # noqa: S102
        assert sentences["page"]("formats") == "https://a.example/b/docs/formats.html"
        page, guide = (file.read(f"docs/{name}.html").decode() for name in ("README", "guide"))
        assert 'href="https://a.example/b/docs/notes/index.html"' in page and 'href="https://a.example/b/CONTRIBUTING.html"' in page
        assert 'href="https://a.example/b/docs/blender-5.2-f12.png"' in guide and 'src="http' not in guide and 'href="colour.html"' in guide


@pytest.mark.slow
def test_the_same_commit_builds_the_same_zip(builder, numbas, tmp_path, monkeypatch):
    zips, bundled = [], numbas()
    for umask in 0o022, 0o077:  # files of other modes and times
        old = os.umask(umask)
        try:
            zips.append(builder.build("windows-x64", bundled, tmp_path / f"{umask}", "https://a.example/b"))
        finally:
            os.umask(old)
    first, second = (path.read_bytes() for path in zips)
    assert first == second
    with zipfile.ZipFile(zips[0]) as file:
        names = file.namelist()
        assert names == sorted(names) and len({(entry.date_time, entry.external_attr) for entry in file.infolist()}) == 1
        told = file.infolist()[0].date_time
    commit = subprocess.run(["git", "log", "-1", "--format=%cd", "--date=format-local:%Y %m %d %H %M"], cwd=ROOT, check=True, text=True,
                            capture_output=True, env={**os.environ, "TZ": "UTC"}).stdout
    assert told[:5] == tuple(map(int, commit.split()))
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1000000000")
    assert builder.made().isoformat() == "2001-09-09T01:46:40+00:00"


@pytest.mark.slow
def test_the_zip_lists_what_is_inside(builder, numbas, tmp_path):
    path = builder.build("windows-x64", numbas(), tmp_path)
    with zipfile.ZipFile(path) as file:
        told = json.loads(file.read("sbom.cdx.json"))
        others = [name for name in file.namelist() if name.endswith((".whl", ".safetensors", "cameras.json"))]
        inside = {Path(name).name: file.read(name) for name in others}
    assert told["bomFormat"] == "CycloneDX" and told["metadata"]["component"]["name"] == "fastgs_blender"
    hashes = {part["bom-ref"]: part["hashes"] for part in told["components"]}
    assert hashes == {name: [{"alg": "SHA-256", "content": hashlib.sha256(content).hexdigest()}] for name, content in inside.items()}
    llvmlite = next(part for part in told["components"] if part["name"] == "llvmlite")
    assert llvmlite["licenses"] == [{"expression": "BSD-2-Clause AND Apache-2.0 WITH LLVM-exception"}]
    assert "Anaconda" in llvmlite["copyright"] and llvmlite["purl"].startswith("pkg:pypi/llvmlite@0.50.0")
    example = next(part for part in told["components"] if part["name"] == "fireside.safetensors")
    assert example["licenses"][0]["license"]["id"] == "CC0-1.0"


def test_wheels_that_fit_together(wheels, wheel, numbas):
    assert not wheels.problems(numbas())
    assert wheels.problems([wheel("numpy-2.1.0-cp311-cp311-win_amd64")]) == ["numpy is Blender's own."]
    assert wheels.problems(numbas()[:1]) == ["numba-0.68.1-cp311-cp311-win_amd64.whl needs llvmlite<0.51,>=0.50.0dev0, which is not there."]
    assert not wheels.problems([wheel("x-1-py3-none-any", ["pytest; extra == 'test'", "requests>2"])])
    for requirement, python, numpy in ("numpy>=1.26", "3.11", "1.24.3"), ("numpy<2.5", "3.13", "2.5.5"):
        found = wheels.problems([wheel("x-1-cp310-abi3-win_amd64", [requirement])])
        assert any(all(name in text for name in ("x-1-cp310-abi3-win_amd64.whl ", f"numpy {numpy} ", f"Python {python}")) for text in found)


def test_what_the_tests_run_with_goes_with_every_blender(wheels, wheel):
    """The zip gets the installed versions: what their makers say they need is there in each Blender."""
    installed = {name: importlib.metadata.version(name) for name in wheels.PACKAGES}
    made = [wheel(f"{name}-{version}-cp310-abi3-win_amd64", importlib.metadata.requires(name) or ()) for name, version in installed.items()]
    assert not wheels.problems(made)
    locked = {name: re.match("[^=]+==([^ ]+)", line)[1] for name, line in wheels.locks().items()}
    assert installed.items() <= locked.items()
    assert locked.keys() == {*wheels.PACKAGES, *wheels.OPTIONAL, *(name for more in wheels.FOR_ONE.values() for name in more)}
    shipped = {line.split("<")[0].split(">")[0].split("=")[0].strip() for line in importlib.metadata.requires("bpy") or ()}
    assert shipped <= wheels.SHIPPED


def test_licences_are_told(wheels, wheel, numbas):
    text = wheels.notices([*numbas(), wheel("numba-0.68.1-cp313-cp313-win_amd64")])
    assert text.count("| numba | 0.68.1 | BSD-2-Clause |") == 1
    assert "| llvmlite | 0.50.0 | BSD-2-Clause AND Apache-2.0 WITH LLVM-exception |" in text
    assert "## llvmlite: LICENSE\n\nLLVM's terms" in text
    with pytest.raises(ValueError, match="numba-1-py3-none-any.whl.*licence"):
        wheels.notices([wheel("numba-1-py3-none-any", licence="")])


def test_what_finds_poses_comes_along_where_there_is_room(wheels, tmp_path, monkeypatch, capsys):
    sizes, asked = {"llvmlite": 90, "pycolmap": 20}, []

    def run(command, **options):
        asked.append(Path(command[-1]).read_text("utf-8"))
        wanted = re.findall("^([a-z]+)==", asked[-1], re.MULTILINE)
        folder = next(Path(part.removeprefix("--dest=")) for part in command if part.startswith("--dest="))
        python = next(part.rpartition("=")[2] for part in command if part.startswith("--python-version="))
        for package in set(wanted) & sizes.keys():
            with (folder / f"{package}-1-cp{python.replace('.', '')}-none-any.whl").open("wb") as file:
                file.truncate(sizes[package] * 1_000_000)
        return SimpleNamespace(returncode=int("pycolmap" in wanted and "pycolmap" not in sizes), stderr="ERROR: no")

    def names(folder, name="linux-x64-python3.14"):
        return [path.name.partition("-")[0] for path in wheels.download(name, tmp_path / folder)]

    monkeypatch.setattr(wheels.subprocess, "run", run)
    assert names("a") == ["llvmlite", "pycolmap"] and not capsys.readouterr().out
    assert all("--hash=sha256:" in line for text in asked for line in text.splitlines())  # pip takes no other file
    assert names("b", "macos-arm64") == ["llvmlite", "llvmlite"]  # for both Pythons, and not pycolmap for one of them
    assert re.search("without pycolmap: .*220 MB", capsys.readouterr().out)
    assert "rubicon-objc==" in asked[-3] and "rubicon-objc" not in asked[0]
    del sizes["pycolmap"]
    assert names("c") == ["llvmlite"] and "no wheel" in capsys.readouterr().out


@pytest.mark.slow
def test_a_repository_of_zips(builder, wheels, numbas, tmp_path, monkeypatch, capsys):
    """A zip for each system, and Blender's index of them; one whose wheels are not to be had is told, the others are built."""
    def download(name, folder):
        if name == "macos-arm64":
            raise wheels.Missing("macos-arm64 with Python 3.13 is left out: no such wheel.")
        return list(dict.fromkeys(wheel for python in wheels.ZIPS[name] for wheel in numbas(python)))

    monkeypatch.setattr(wheels, "download", download)
    out = tmp_path / "dist"
    with pytest.raises(SystemExit, match="macos-arm64.*3.13"):
        builder.main(["--out", str(out)])
    kinds = {"linux-x64": ("3.11", "3.13"), "windows-x64": ("3.11", "3.13"), "linux-x64-python3.14": ("3.14",)}
    zips = {name: out / f"fastgs_blender-{fg.__version__}-{name}.zip" for name in kinds}
    assert sorted(out.iterdir()) == sorted([*zips.values(), out / "index.json"])
    for name, path in zips.items():
        with zipfile.ZipFile(path) as file:
            names = {name.removeprefix("wheels/") for name in file.namelist() if name.startswith("wheels/")}
            assert "THIRD-PARTY.md" in file.namelist() and names == {wheel.name for wheel in download(name, None)}
            manifest = tomllib.loads(file.read("blender_manifest.toml").decode())
            assert "2012-2026 Anaconda, Inc. (numba)" in manifest["copyright"] and "2003-2026 LLVM contributors" in manifest["copyright"]
    entries = json.loads((out / "index.json").read_text("utf-8"))["data"]
    found = {entry["archive_url"]: entry for entry in entries}
    for name, path in zips.items():
        entry = found.pop(f"./{path.name}")
        assert entry["platforms"] == [wheels.platform_of(name)]
        assert tuple(entry["python_versions"]) == kinds[name]  # Blender takes the one that fits its own Python
        assert entry["archive_size"] == path.stat().st_size
        assert entry["archive_hash"] == f"sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}"
        assert entry["id"] == "fastgs_blender"
    printed = capsys.readouterr().out
    assert not found and f"{zips['windows-x64']}: " in printed
    assert "numba-0.68.1-cp311-cp311-win_amd64.whl: 0.0 MB, BSD-2-Clause" in printed


@pytest.mark.slow
def test_the_zip_for_the_store_downloads_nothing(builder, wheels, numbas, tmp_path, monkeypatch):
    """No pip, no permission for the network, and one zip a system; the other modules import none of what is left out."""
    monkeypatch.setattr(wheels, "download", lambda name, folder: numbas())
    (path,) = builder.main(["--store", "--zip", "linux-x64", "--zip", "linux-x64-python3.14", "--out", str(tmp_path)])
    with zipfile.ZipFile(path) as file:
        sources = {name: file.read(name).decode() for name in file.namelist() if name.endswith(".py")}
        manifest = tomllib.loads(file.read("blender_manifest.toml").decode())
    assert set(manifest["permissions"]) == {"files", "clipboard"}
    assert "operators/maintenance.py" in sources and "operators/make_environment.py" not in sources
    assert not [name for name, text in sources.items() if re.search(r"[\"']pip[\"']", text)]
    assert not [name for name, text in sources.items() if "jobs.maker import" in text or "from .maker" in text]

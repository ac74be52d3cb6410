# SPDX-License-Identifier: GPL-3.0-or-later
"""Streamed SOG: levels of detail in chunks, laid out as splat-transform's write-lod.ts does, read as PlayCanvas' engine reads them.

gsplat-octree.js: `if (node.lods) { leafNodes.push(...) } else if (node.children) ...`; a leaf shows count Gaussians from offset on of the
file of a level, and nothing where it has no entry for it.  gsplat-octree-instance.js: the environment is placed whatever the level.
"""
from __future__ import annotations

import json
import shutil
import warnings
import zipfile
from pathlib import Path

import mutations
import numpy as np
import pytest
from test_formats_sog import contents, zipped
from test_fuzz_static import usable

import fastgs_blender as fg
from fastgs_blender.formats import fingerprint, identify
from fastgs_blender.formats.sequences import stored_bytes, title

pytestmark = pytest.mark.filterwarnings("error")
CHUNKS = {"0_0": 7, "0_1": 9, "1_0": 5, "env": 4}
"""Gaussians in each."""
PLACES = [{"0": ("0_0", 0, 4), "1": ("1_0", 0, 2)}, {"0": ("0_1", 0, 6), "1": ("1_0", 2, 3)}, {"0": ("0_0", 4, 3)}, {"0": ("0_1", 6, 3)}]
"""Of four leaves, the last two without a coarse level: chunk, offset, count."""


def files_of(rng, environment=True, bundled=False) -> dict[str, bytes]:
    """{path: content} of a scene of two levels."""
    made = {name: contents(rng, n, 1 if name[0] == "0" else 0, 2)[0] for name, n in CHUNKS.items() if environment or name != "env"}
    files = {f"{name}.sog": zipped(each) for name, each in made.items()} if bundled else {
        f"{name}/{file}": content for name, each in made.items() for file, content in each.items()}
    names = [f"{name}{'.sog' if bundled else '/meta.json'}" for name in ("1_0", "0_0", "0_1")]
    leaves = [{"bound": {}, "lods": {level: {"file": [n[:3] for n in names].index(name), "offset": first, "count": count}
                                     for level, (name, first, count) in lods.items()}} for lods in PLACES]
    tree = {"bound": {}, "children": [{"bound": {}, "children": leaves[:2]}, {"bound": {}, "children": leaves[2:]}]}
    meta = {"version": 1, "count": 21, "counts": [16, 5], "lodLevels": 2, "filenames": names, "tree": tree}
    if environment:
        meta["environment"] = "env.sog" if bundled else "env/meta.json"
    return files | {"lod-meta.json": json.dumps(meta).encode()}


@pytest.fixture
def scene(tmp_path):
    """A function that writes a scene and returns its folder."""
    def write(files, name="town.v2"):
        for file, content in files.items():
            (tmp_path / name / file).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name / file).write_bytes(content)
        return tmp_path / name
    return write


def alone(folder, name) -> fg.GaussianModel:
    """A chunk by itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fg.LossWarning)
        return fg.load(folder / f"{name}.sog" if (folder / f"{name}.sog").is_file() else folder / name)


def assert_is(model, parts):
    """The model's Gaussians are those of the parts, in their order; harmonics that a part lacks are 0."""
    for name in ("position", "rotation", "scale", "opacity"):
        np.testing.assert_array_equal(getattr(model, name), np.concatenate([getattr(p, name) for p in parts]))
    width = model.features.shape[1]
    features = [np.pad(part.features, ((0, 0), (0, width - part.features.shape[1]))) for part in parts]
    np.testing.assert_array_equal(model.features, np.concatenate(features))


@pytest.mark.parametrize("bundled", [False, True])
@pytest.mark.parametrize("environment", [False, True])
def test_levels_and_the_environment(rng, scene, bundled, environment):
    folder = scene(files_of(rng, environment, bundled))
    env = [alone(folder, "env")] if environment else []
    for path in (folder, folder / "lod-meta.json", folder / "lod-meta[0].json"):
        assert identify(path).name == "streamed SOG"
        assert_is(fg.load(path), [alone(folder, "0_0"), alone(folder, "0_1"), *env])
    coarse = folder / "lod-meta[1].json"
    assert_is(fg.load(coarse), [alone(folder, "1_0"), *env])
    assert len(fg.open_source(coarse)) == 5 + 4 * environment and fingerprint(coarse) == fingerprint(folder)
    with pytest.raises(fg.FastGSError, match=r"levels 0 to 1"):
        fg.load(folder / "lod-meta[2].json")


def test_a_part_of_a_chunk(rng, scene):
    """What no leaf names of a chunk is not shown."""
    folder = scene(files_of(rng, False))
    meta = json.loads((folder / "lod-meta.json").read_text())
    meta["tree"]["children"][0]["children"][0]["lods"]["0"]["count"] = 2
    (folder / "lod-meta.json").write_text(json.dumps(meta))
    assert_is(fg.load(folder), [alone(folder, "0_0").take([0, 1, 4, 5, 6]), alone(folder, "0_1")])


def test_in_a_zip(rng, scene, tmp_path):
    folder = scene(files_of(rng))
    shutil.make_archive(str(tmp_path / "scene"), "zip", tmp_path, folder.name)
    assert identify(tmp_path / "scene.zip").name == "streamed SOG"
    assert_is(fg.load(tmp_path / "scene.zip"), [fg.load(folder)])


def test_a_chunk_alone_is_said_to_be_one(rng, scene):
    folder = scene(files_of(rng))
    with pytest.warns(fg.LossWarning, match="one chunk.*lod-meta.json"):
        assert len(fg.load(folder / "0_0" / "meta.json")) == 7


def test_commands_take_a_level(rng, scene, run, tmp_path):
    folder = scene(files_of(rng))
    code, _, errors = run("convert", folder / "lod-meta[1].json", tmp_path / "coarse.ply")
    assert (code, len(fg.load(tmp_path / "coarse.ply"))) == (0, 9), errors
    code, out, errors = run("info", "--json", folder / "lod-meta[1].json")
    assert code == 0, errors
    assert json.loads(out)["file_bytes"] == sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


def test_names_and_sizes(rng, scene, tmp_path):
    """Of SOG in a folder: the folder's name, and all bytes of the files that belong to it."""
    folder = scene(files_of(rng))
    names = [title(folder / name) for name in ("lod-meta.json", "lod-meta[1].json", "0_0/meta.json")]
    assert names == ["town.v2", "town.v2 level 1", "0_0"]
    one = folder / "0_1"
    (one / "film.mp4").write_bytes(bytes(5000))
    assert stored_bytes(one / "meta.json") == sum(file.stat().st_size for file in one.iterdir()) - 5000
    (tmp_path / "m.ply").write_bytes(bytes(77))
    assert stored_bytes(tmp_path / "m.ply") == 77


def test_broken_files(rng, scene):
    files = files_of(rng)
    folder = scene(files)

    def refused(match, change):
        meta = json.loads(files["lod-meta.json"])
        change(meta, meta["tree"]["children"][0]["children"][0]["lods"]["0"])
        (folder / "lod-meta.json").write_text(json.dumps(meta))
        with pytest.raises(fg.FastGSError, match=match):
            fg.load(folder)

    refused("version", lambda meta, place: meta.update(version=2))
    refused("levels", lambda meta, place: meta.update(lodLevels="3"))
    refused("more Gaussians", lambda meta, place: place.update(count=8))
    refused("lod-meta.json.*copy.*export", lambda meta, place: place.update(file=3))
    refused("offset", lambda meta, place: place.update(offset=-1))
    refused("damaged", lambda meta, place: meta["tree"].update(children=[7]))
    refused("0_7/meta.json is missing", lambda meta, place: meta["filenames"].__setitem__(1, "0_7/meta.json"))
    refused("no Gaussians", lambda meta, place: meta["tree"].update(children=[]))
    for name in ("../0_0/meta.json", "/etc/passwd", "http://a/meta.json", "0_0\\meta.json", "0_0//meta.json", "", 5):
        refused("beside.*below", lambda meta, place, name=name: meta["filenames"].__setitem__(1, name))


def test_chunks_that_are_named_again_and_again_are_read_once(rng, scene, monkeypatch):
    folder = scene(files_of(rng, False))
    meta = json.loads((folder / "lod-meta.json").read_text())
    leaves = meta["tree"]["children"]
    meta["filenames"] += ["./0_0/meta.json"] * 5000
    leaves += [{"lods": {"0": {"file": 3 + i, "offset": 0, "count": 7}}} for i in range(5000)]
    (folder / "lod-meta.json").write_text(json.dumps(meta))
    assert len(fg.load(folder)) == 16


def test_mutated_files(tmp_path):
    rng = np.random.default_rng(4)
    seeds = {"folders": files_of(rng), "bundled": files_of(rng, False, True)}
    told = mutations.campaign("lod-meta.json", lambda folder: usable(folder / "lod-meta.json"), seeds, tmp_path)
    assert min(told.values(), default=1) > sum(told.values()) / 30


@pytest.mark.slow
def test_mutated_zips(tmp_path):
    with zipfile.ZipFile(tmp_path / "m.zip", "w") as archive:
        for name, content in files_of(np.random.default_rng(5)).items():
            archive.writestr(name, content)
    told = mutations.campaign("lod-meta.json in a zip", lambda folder: usable(folder / "m.zip"),
                              {"zip": {"m.zip": (tmp_path / "m.zip").read_bytes()}}, tmp_path / "seeds")
    assert min(told.values(), default=1) > sum(told.values()) / 30


def test_a_real_file_of_that_name_is_that_file(rng, scene, tmp_path):
    """Only a name that is no file is a level of another one."""
    folder = scene(files_of(rng))
    shutil.copy(Path(folder, "lod-meta.json"), folder / "lod-meta[1].json")
    assert len(fg.load(folder / "lod-meta[1].json")) == 20

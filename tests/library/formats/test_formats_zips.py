# SPDX-License-Identifier: GPL-3.0-or-later
"""Zip files of models and trainers' folders: which model is opened, what is said of the others, and where remarks come from."""
from __future__ import annotations

import tempfile
import warnings
import zipfile
from pathlib import Path

import mutations
import numpy as np
import pytest
from test_formats_sequences import COUNT, all_frames, frame, write

import fastgs_blender as fg
from fastgs_blender import cli
from fastgs_blender.formats import fingerprint, identify
from fastgs_blender.util import stated_paths

pytestmark = pytest.mark.filterwarnings("ignore::fastgs_blender.LossWarning")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write(tmp_path_factory.mktemp("sequence") / "take", range(1, 9))


@pytest.mark.parametrize("extension", ["spz", "sog"])
def test_spz_and_sog_in_a_zip(tmp_path, extension):
    files = write(tmp_path / "frames", range(3), "f{:d}." + extension)
    with zipfile.ZipFile(tmp_path / "frames.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(files.iterdir()):
            archive.write(file, f"inner/{file.name}")
        archive.writestr("__MACOSX/inner/._f0." + extension, b"x")
        archive.writestr("readme.txt", b"x")
    source = fg.open_source(tmp_path / "frames.zip")
    for i in range(3):
        shown, loaded = source.moment(source.clip.t_of_frame(i))[0], fg.load(files / f"f{i}.{extension}")
        np.testing.assert_array_equal(shown.position, loaded.position)
        np.testing.assert_array_equal(shown.features, loaded.features)


@pytest.mark.parametrize(("name", "kinds"), [
    ("m.spz", {}), ("m.compressed.ply", {}), ("m.sog", {}), ("m.glb", {}), ("m.splat", {}), ("m.safetensors", {"basis": "cubic"}),
    ("m.splatv", {"basis": "cubic", "rotation_basis": "line", "temporal": "radial"}),
    ("m.ply", {"basis": "cubic", "rotation_basis": "line", "temporal": "radial", "appearance": "sigmoid"})])
def test_load_reads_the_only_model_of_a_zip(make_model, rng, tmp_path, name, kinds):
    """With what lies around it: a Spacetime Gaussians .ply has its decoder beside it, and pictures are no models."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fg.LossWarning)
        fg.save(make_model(rng, 30, **kinds), tmp_path / name)
    with zipfile.ZipFile(tmp_path / "one.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(tmp_path.glob("m.*")):
            archive.write(file, f"a folder/{file.name}")
        for other in ("__MACOSX/a folder/._" + name, "a folder/read me.txt", "a folder/1.jpg", "a folder/cameras.json"):
            archive.writestr(other, b"x")
    want = fg.load(tmp_path / name)
    for model in (fg.load(tmp_path / "one.zip"), fg.open_source(tmp_path / "one.zip")):
        for key, array in want.arrays.items():
            np.testing.assert_array_equal(getattr(model, key), array)
    if name.endswith(".splat"):  # two of them are a sequence, which has no single model
        with zipfile.ZipFile(tmp_path / "two.zip", "w") as archive:
            for i in range(2):
                archive.write(tmp_path / name, f"f{i}.splat")
        with pytest.raises(fg.FastGSError, match="open_source"):
            fg.load(tmp_path / "two.zip")


def zipped(folder: Path) -> Path:
    """A folder in a zip file, with the folder's name."""
    with zipfile.ZipFile(folder.with_suffix(".zip"), "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(folder.rglob("*")):
            archive.write(file, file.relative_to(folder.parent))
    return folder.with_suffix(".zip")


@pytest.mark.parametrize("earlier", ["iteration_7000", "coarse_iteration_3000"])
def test_a_trainer_s_folder_is_its_last_model_as_its_zip_is(make_model, rng, tmp_path, earlier, capsys):
    """INRIA's: the points that it began with, two states, cameras and settings; 4DGaussians calls its first state coarse."""
    run = tmp_path / "out"
    for state, count in ((earlier, 7), ("iteration_30000", 30)):
        (run / "point_cloud" / state).mkdir(parents=True)
        fg.save(make_model(rng, count), run / "point_cloud" / state / "point_cloud.ply")
    (run / "input.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n")
    (run / "cfg_args").write_text("Namespace(sh_degree=3)")
    fg.save_cameras([fg.Camera(8, 8, 8, 8, 4, 4, np.eye(4))], run / "cameras.json")
    file = run / "point_cloud" / "iteration_30000" / "point_cloud.ply"
    want = fg.load(file)
    for path in (run, run / "point_cloud", zipped(run)):
        for model in (fg.load(path), fg.open_source(path)):
            np.testing.assert_array_equal(model.position, want.position)
    assert identify(run).name == "INRIA PLY" and fingerprint(run) == fingerprint(file)
    assert cli.main(["info", str(run)]) == 0
    assert "30" in capsys.readouterr().out
    fg.save(make_model(rng, 5), run / "point_cloud" / "other.ply")
    with pytest.raises(fg.FastGSError, match="numbered"):
        fg.load(run)


def test_other_models_in_a_zip_are_told(make_model, rng, tmp_path):
    models = {name: make_model(rng, count) for name, count in (("b.ply", 4), ("a.splat", 5), ("c.safetensors", 6))}
    (tmp_path / "in").mkdir()
    for name, model in models.items():
        fg.save(model, tmp_path / "in" / name)
    path = zipped(tmp_path / "in")
    for read in (fg.load, fg.open_source):
        with pytest.warns(fg.LossWarning, match="in.zip.* in/c.safetensors .*; in/a.splat, in/b.ply") as told:
            assert len(read(path)) == 6
        assert len([each for each in told if "opened" in str(each.message)]) == 1
    (tmp_path / "in" / "c.safetensors").unlink()
    with pytest.warns(fg.LossWarning, match="in/b.ply .*; in/a.splat"):
        assert len(fg.load(zipped(tmp_path / "in"))) == 4
    write(tmp_path / "in", (1, 2))
    with pytest.warns(fg.LossWarning, match="take_0001.ply to in/take_0002.ply .*; in/a.splat, in/b.ply"):
        assert len(fg.open_source(zipped(tmp_path / "in")).at) == 2
    write(tmp_path / "in", (1, 2), "more_{:d}.ply")
    with pytest.raises(fg.FastGSError, match="2 sequences.*unpack it"):
        fg.open_source(zipped(tmp_path / "in"))


@pytest.mark.parametrize(("numbers", "frames"), [((6999, 29999), 0), ((99,), 0), ((98, 99, 100, 199), 102), ((6998, 6999), 2)])
def test_of_gsplat_s_ply_folder_the_last_step_counts(make_model, rng, tmp_path, numbers, frames):
    """examples/simple_trainer.py of gsplat at 00877bf: ply/point_cloud_{step}.ply at `step in [i - 1 for i in cfg.ply_steps]`.

    Of other numbers the files are frames.
    """
    (tmp_path / "out" / "ply").mkdir(parents=True)
    (tmp_path / "out" / "cfg.yml").write_text("antialiased: false\n")
    for number in numbers:
        fg.save(make_model(rng, number % 90 + 1, appearance="rgb"), tmp_path / "out" / "ply" / f"point_cloud_{number}.ply")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fg.LossWarning)  # of missing frames
        for path in (tmp_path / "out", tmp_path / "out" / "ply", zipped(tmp_path / "out")):
            found = fg.open_source(path)
            assert found.clip.frame_count == frames if frames else len(found) == len(fg.load(path)) == numbers[-1] % 90 + 1


@pytest.mark.parametrize("count", [1, 2])
def test_what_is_said_of_a_model_in_a_zip_names_both(make_model, rng, tmp_path, count):
    """And never the folder that it is unpacked into, which is gone by then."""
    model = make_model(rng, 9)
    model.position[3] = np.nan
    for i in range(count):
        (tmp_path / "in" / "deep").mkdir(parents=True, exist_ok=True)
        fg.save(model, tmp_path / "in" / "deep" / f"m{i}.ply")
    member = f"{tmp_path / 'in.zip'}: {Path('in/deep/m0.ply')}"
    with pytest.warns(fg.LossWarning) as told:
        fg.open_source(zipped(tmp_path / "in")).moment(0.0)
    assert any(str(each.message).startswith(f"{member}: 1 of 9") for each in told), [str(each.message) for each in told]
    file = tmp_path / "in" / "deep" / "m0.ply"
    file.write_bytes(file.read_bytes()[:-20])
    with pytest.raises(fg.FastGSError) as error:
        fg.open_source(zipped(tmp_path / "in")).moment(0.0)
    assert str(error.value).startswith(f"cannot read {member}: ")
    said = [str(error.value), *(str(each.message) for each in told)]
    assert not any(str(Path(tempfile.gettempdir(), "fastgs-")) in text for text in said)


@pytest.mark.parametrize("points", ["input.ply", "sparse/0/points3D.ply", "sparse_pc.ply"])
def test_a_zipped_training_is_its_model_and_not_its_first_points(make_model, rng, tmp_path, points):
    """INRIA's trainer copies the points that it began with, input.ply, into the folder of each model."""
    fg.save(make_model(rng, 30), tmp_path / "m.ply")
    with zipfile.ZipFile(tmp_path / "out.zip", "w") as archive:
        archive.write(tmp_path / "m.ply", "out/point_cloud/iteration_30000/point_cloud.ply")
        archive.writestr(f"out/{points}", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n")
    assert len(fg.load(tmp_path / "out.zip")) == len(fg.open_source(tmp_path / "out.zip")) == 30


@pytest.mark.posix
def test_a_zip_writes_nothing_outside_of_its_folder(make_model, rng, tmp_path, monkeypatch):
    fg.save(make_model(rng, 5), tmp_path / "m.ply")
    monkeypatch.setattr(stated_paths, "WINDOWS", True)  # there, aux.ply is a device
    for name in ("../../m.ply", "a/../../../m.ply", "c:\\m.ply", "a/aux.ply"):
        with zipfile.ZipFile(tmp_path / "m.zip", "w") as archive:
            archive.write(tmp_path / "m.ply", name)
        with pytest.raises(fg.FastGSError, match="outside"):
            fg.load(tmp_path / "m.zip")


def test_a_zip_with_one_model_is_that_model(folder, tmp_path):
    with zipfile.ZipFile(tmp_path / "one.zip", "w") as archive:
        archive.write(folder / "take_0001.ply", "point_cloud.ply")
    model = fg.open_source(tmp_path / "one.zip")
    assert isinstance(model, fg.GaussianModel) and len(model) == COUNT


@pytest.mark.slow
def test_mutated_zips(tmp_path):
    small = write(tmp_path / "small", range(2), model=lambda i: frame(i).take(np.arange(3)))
    with zipfile.ZipFile(tmp_path / "small.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(small.iterdir()):
            archive.write(file, file.name)
    with zipfile.ZipFile(tmp_path / "models.zip", "w") as archive:
        for name in ("point_cloud/iteration_7/a.ply", "point_cloud/iteration_9/a.ply", "b.ply", "ckpts/ckpt_9_rank0.pt", "cfg_args"):
            archive.write(small / "take_0000.ply", name)
    (tmp_path / "seeds").mkdir()
    told = mutations.campaign("zip of frames", lambda folder: all_frames(folder / "m.zip"),
                              {"two frames": {"m.zip": (tmp_path / "small.zip").read_bytes()},
                               "models": {"m.zip": (tmp_path / "models.zip").read_bytes()}}, tmp_path / "seeds")
    assert min(told.values(), default=1) > 0


def test_a_bomb_in_a_zip_is_not_unpacked(tmp_path):
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for i in (1, 2):
            archive.writestr(f"f{i}.ply", b"\0" * (64 << 20))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(fg.FastGSError, match="far larger"):
            fg.open_source(tmp_path / "bomb.zip")

# SPDX-License-Identifier: GPL-3.0-or-later
"""load() and save(): every error is one sentence, and nothing that was there is lost."""
from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

import numpy as np
import pytest
from random_models import BASES, TEMPORALS

import fastgs_blender as fg
from fastgs_blender.formats import FORMATS, identify, writable, written_files
from fastgs_blender.util import outputs

pytestmark = pytest.mark.filterwarnings("error")
EXTENSIONS = (".safetensors", ".ply", ".splatv")


@pytest.fixture
def model(rng, make_model):
    """A model that every format holds, splatv with roundings."""
    return make_model(rng, basis="cubic", rotation_basis="line", temporal="radial", appearance="stg")


@pytest.fixture
def quiet(recwarn):
    """Losses are not the matter here."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fg.LossWarning)
        yield


def listing(folder: Path) -> dict[str, bytes]:
    """All files and their bytes."""
    return {p.name: p.read_bytes() for p in folder.iterdir()}


@pytest.mark.slow
@pytest.mark.usefixtures("quiet")
@pytest.mark.parametrize("extension", EXTENSIONS)
@pytest.mark.parametrize("appearance", ["rgb", "sh0", "sh2", "sigmoid"])
@pytest.mark.parametrize("basis", BASES)
def test_models_without_gaussians(rng, make_model, tmp_path, basis, appearance, extension):
    for temporal in TEMPORALS:
        model = make_model(rng, 0, basis=basis, rotation_basis=basis, temporal=temporal, appearance=appearance)
        fg.save(model, tmp_path / f"m{extension}")
        assert len(fg.load(tmp_path / f"m{extension}")) == 0


@pytest.mark.usefixtures("quiet")
@pytest.mark.parametrize("extension", EXTENSIONS)
def test_saving_leaves_no_other_files(model, tmp_path, extension):
    fg.save(model, tmp_path / f"m{extension}")
    assert set(listing(tmp_path)) == {f"m{extension}"} | ({"m.pt"} if extension == ".ply" else set())
    assert [p.name for p in written_files(model, tmp_path / f"m{extension}")][-1] == f"m{extension}"


@pytest.mark.parametrize("name", ["m.SAFETENSORS", "m.Ply"])
def test_extensions_may_be_capitals(model, tmp_path, name):
    fg.save(model, str(tmp_path / name))
    assert len(fg.load(str(tmp_path / name))) == 40


@pytest.mark.parametrize("name", ["m", "m.obj", "m.ply.gz", ".ply"])
def test_unknown_extensions_name_the_known(model, tmp_path, name):
    with pytest.raises(fg.FastGSError, match=", ".join(sorted(writable())).replace(".", r"\.")):
        fg.save(model, tmp_path / name)
    assert not listing(tmp_path)


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_bad_targets(model, tmp_path, extension):
    (tmp_path / f"folder{extension}").mkdir()
    for target, text in ((tmp_path / f"folder{extension}", "folder"), (tmp_path / "none" / f"m{extension}", "folder.*exist"),
                         (tmp_path / f"{'n' * 300}{extension}", "cannot write"), (f"{tmp_path}/a\0b{extension}", "cannot write")):
        with pytest.raises(fg.FastGSError, match=text) as error:
            fg.save(model, target)
        assert "\n" not in str(error.value)
    assert [p.name for p in tmp_path.iterdir()] == [f"folder{extension}"]


@pytest.mark.posix
def test_devices_are_not_replaced(model, tmp_path):
    os.mkfifo(tmp_path / "pipe.ply")
    with pytest.raises(fg.FastGSError, match="ordinary file"):
        fg.save(model, tmp_path / "pipe.ply")
    with pytest.raises(fg.FastGSError, match="ordinary file"):
        fg.load(tmp_path / "pipe.ply")
    assert stat.S_ISFIFO((tmp_path / "pipe.ply").stat().st_mode)


def test_what_is_no_model(tmp_path):
    with pytest.raises(fg.FastGSError, match="NoneType.*GaussianModel"):
        fg.save(None, tmp_path / "m.ply")


@pytest.mark.usefixtures("quiet")
@pytest.mark.parametrize("failing", ["writing", "renaming", "renaming the second file"])
@pytest.mark.parametrize("extension", EXTENSIONS)
def test_a_failure_changes_nothing(model, tmp_path, monkeypatch, extension, failing):
    """A full disk, whenever it shows: the old files are whole, no others appear, one sentence says why."""
    target = tmp_path / f"m{extension}"
    fg.save(model, target)
    before = listing(tmp_path)
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    if failing == "writing":
        def fsync(number):
            raise full
        monkeypatch.setattr(outputs.os, "fsync", fsync)
    else:
        really = os.replace

        def replace(source, to):
            if (failing == "renaming" or Path(to) == target) and not Path(source).read_bytes() == before.get(Path(to).name):
                raise full
            really(source, to)
        monkeypatch.setattr(outputs.os, "replace", replace)
    with pytest.raises(fg.FastGSError, match="No space left") as error:
        fg.save(model.take(slice(0, 9)), target)
    assert str(target) in str(error.value)
    monkeypatch.undo()
    assert listing(tmp_path) == before


@pytest.mark.usefixtures("quiet")
@pytest.mark.parametrize("extension", EXTENSIONS)
@pytest.mark.posix
def test_a_disk_that_takes_no_more(rng, make_model, tmp_path, extension):
    import resource

    fg.save(make_model(rng), tmp_path / f"m{extension}")
    before, limits = listing(tmp_path), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, limits[1]))
    try:
        with pytest.raises(fg.FastGSError, match="too large; check.*space"):
            fg.save(make_model(rng, 2000), tmp_path / f"m{extension}")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert listing(tmp_path) == before


def test_a_folder_that_may_not_be_written(model, tmp_path, monkeypatch):
    def touch(self, **_):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(outputs.Path, "touch", touch)
    with pytest.raises(fg.FastGSError, match=r"Permission denied.*folder"):
        fg.save(model, tmp_path / "m.ply")


@pytest.mark.posix
def test_links_and_permissions_stay(rng, make_model, tmp_path):
    (tmp_path / "real").mkdir()
    target, link = tmp_path / "real" / "m.safetensors", tmp_path / "m.safetensors"
    fg.save(make_model(rng), target)
    target.chmod(0o640)
    link.symlink_to(target)
    fg.save(make_model(rng, 3), link)
    assert link.is_symlink()
    assert len(fg.load(target)) == 3
    assert stat.S_IMODE(target.stat().st_mode) == 0o640


def test_new_files_have_the_usual_permissions(rng, make_model, tmp_path):
    (tmp_path / "usual").write_bytes(b"")
    fg.save(make_model(rng), tmp_path / "m.ply")
    assert (tmp_path / "m.ply").stat().st_mode == (tmp_path / "usual").stat().st_mode


@pytest.mark.parametrize(("content", "text"), [
    (b"", "empty"), (b"PK\x03\x04rest", "zip archive"), (b"\x1f\x8b\x08", "spz"), (b"glTF\2\0\0\0", "glTF"),
    (b"\x93NUMPY\1\0", "numpy"), (b"\x80\x02}.", "pickle"), (b"BLENDER-v500", "Blender"), (b"hello, this is a text", "none.*known"),
    (b"ply", "PLY header.*short"), (b"plywood\nend_header\n", "line 1 .*PLY header"), (b"\0" * 100, "none.*known"),
    (b"\x02\0\0\0\0\0\0\0{}", "FAST-GS model")])
def test_files_of_other_kinds(tmp_path, content, text):
    (tmp_path / "m.ply").write_bytes(content)
    for read in (fg.load, identify):
        if read is identify and content.endswith(b"{}"):
            continue  # it is safetensors, which load() looks into
        with pytest.raises(fg.FastGSError, match=text) as error:
            read(tmp_path / "m.ply")
        assert str(tmp_path / "m.ply") in str(error.value)


def test_files_that_are_not_there(tmp_path):
    for path, text in ((tmp_path / "m.ply", "no such file"), (tmp_path, "folder"), (tmp_path / ("n" * 300), "cannot read"),
                       (f"{tmp_path}/a\0b.ply", "cannot read")):
        for read in (fg.load, identify):
            with pytest.raises(fg.FastGSError, match=text):
                read(path)


def test_a_file_that_may_not_be_read(model, tmp_path, monkeypatch):
    fg.save(model, tmp_path / "m.ply")

    def forbidden(*_, **__):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(os, "open", forbidden)
    with pytest.raises(fg.FastGSError, match="Permission denied"):
        fg.load(tmp_path / "m.ply")


def test_too_little_memory_is_a_sentence(model, tmp_path, monkeypatch):
    fg.save(model, tmp_path / "m.ply")
    monkeypatch.setattr(FORMATS[1].__class__, "load", lambda self, path: np.empty(1 << 62, np.uint8))
    with pytest.raises(fg.FastGSError, match="memory"):
        fg.load(tmp_path / "m.ply")


@pytest.mark.usefixtures("quiet")
@pytest.mark.parametrize("extension", EXTENSIONS)
def test_loading_does_not_touch_the_file(model, tmp_path, extension):
    path = tmp_path / f"m{extension}"
    fg.save(model, path)
    before, stamp = listing(tmp_path), path.stat().st_mtime_ns
    path.chmod(0o444)
    loaded = fg.load(path)
    loaded.position[:] = 0
    assert (listing(tmp_path), path.stat().st_mtime_ns) == (before, stamp)


def test_foreign_files_tell_where_they_came_from(rng, make_model, tmp_path):
    fg.save(make_model(rng), tmp_path / "scan.ply")
    model = fg.load(tmp_path / "scan.ply")
    assert model.provenance == {"source": "scan.ply", "format": "INRIA PLY"}
    fg.save(model, tmp_path / "m.safetensors")
    assert fg.load(tmp_path / "m.safetensors").provenance == model.provenance


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_a_model_with_nan_is_written_without_complaint_of_numpy(model, tmp_path, extension):
    import warnings

    model.scale[3] = np.nan
    model.mu_tau[5] = np.inf
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fg.LossWarning)
        fg.save(model, tmp_path / f"m{extension}")
        assert len(fg.load(tmp_path / f"m{extension}")) in (38, 39)


@pytest.mark.usefixtures("quiet")
@pytest.mark.parametrize("extension", [".ply", ".safetensors"])
@pytest.mark.parametrize("weight", [3e38, -1e19])
def test_decoders_that_have_diverged_are_refused(rng, make_model, tmp_path, extension, weight):
    model = make_model(rng, temporal="radial", appearance="stg")
    model.appearance.w2[1, 2] = weight
    fg.save(model, tmp_path / f"m{extension}")
    with pytest.raises(fg.FastGSError, match="decoder.* 1e\\+18.*diverged"):
        fg.load(tmp_path / f"m{extension}")


def test_a_long_provenance_is_left_out_of_ply_and_said(rng, make_model, tmp_path):
    model = make_model(rng, provenance={"log": "x" * 100_000})
    with pytest.warns(fg.LossWarning, match="provenance"):
        fg.save(model, tmp_path / "m.ply")
    assert len(fg.load(tmp_path / "m.ply")) == 40


def test_columns_beyond_what_readers_take(rng, make_model, tmp_path):
    with pytest.raises(fg.FastGSError, match=r"\.safetensors"):
        fg.save(make_model(rng, 2, basis=fg.Fourier(9000)), tmp_path / "m.ply")
    assert not listing(tmp_path)


def test_a_still_of_features_is_a_standard_ply_without_a_decoder(rng, make_model, tmp_path):
    """The columns of INRIA's trainer at degree 0, in its order, and the loss told; a dynamic PLY still has its decoder beside it."""
    model = make_model(rng, 30, basis=fg.Polynomial(3), rotation_basis=fg.Polynomial(1), temporal="radial", appearance="stg")
    with pytest.warns(fg.LossWarning, match="features.*decoder"):
        fg.save(fg.freeze(model, 0.5), tmp_path / "still.ply")
    assert [path.name for path in tmp_path.iterdir()] == ["still.ply"]
    header = (tmp_path / "still.ply").read_bytes().partition(b"end_header")[0].decode()
    columns = [line.split()[2] for line in header.splitlines() if line.startswith("property")]
    assert columns == ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
                       "rot_0", "rot_1", "rot_2", "rot_3"]
    assert isinstance(fg.load(tmp_path / "still.ply").appearance, fg.SH)
    fg.save(model, tmp_path / "moving.ply")
    assert (tmp_path / "moving.pt").exists()

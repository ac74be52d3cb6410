# SPDX-License-Identifier: GPL-3.0-or-later
"""No reader takes memory on the word of a file: at most four times its size before what it claims is verified."""
from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from claims import COUNT, liars, lying_zips, refused
from random_models import random_model

import fastgs_blender as fg

KINDS = {
    "m.safetensors": {"basis": "paper", "rotation_basis": "line", "temporal": "radial", "appearance": "sh1"},
    "packed.safetensors": {"basis": "cubic", "temporal": "radial", "appearance": "sh1"},
    "inria.ply": {"appearance": "sh3"}, "stg.ply": {"basis": "cubic", "rotation_basis": "line", "temporal": "radial"},
    "m.ftgs.ply": {"basis": "line", "temporal": "radial", "appearance": "sh1"},
    "m.4dgs": {"basis": "line", "temporal": "radial", "appearance": "sh1"},
    "m.splatv": {"basis": "cubic", "rotation_basis": "line", "temporal": "radial"}, "m.compressed.ply": {"appearance": "sh2"},
    "m.spz": {"appearance": "sh2"}, "m.sog": {"appearance": "sh1"}, "m.splat": {}, "m.glb": {"appearance": "sh1"},
}


def made_elsewhere(rng) -> dict[str, bytes]:
    """Files of formats that are only read, from the tests that assemble them."""
    import test_formats_ksplat
    import test_formats_sog4d
    import test_formats_splats4d
    import test_formats_spz
    import test_formats_straight
    import test_formats_tsog

    arrays = test_formats_spz.packed(rng, 4, COUNT, 1)
    return {
        "m.ksplat": test_formats_ksplat.file([test_formats_ksplat.gaussians(rng, COUNT, 2)], 1)[0],
        "v4.spz": test_formats_spz.file(4, COUNT, 1, arrays), "m.splats4d": test_formats_splats4d.file(test_formats_splats4d.clip(rng)),
        "m.sog4d": test_formats_sog4d.zipped(test_formats_sog4d.moving(rng)[0]),
        "frames.sog4d": test_formats_sog4d.zipped(test_formats_sog4d.frames(rng)[0]),
        "m.tsog": test_formats_tsog.package(rng, {"type": 1, "mins": [0, 0.1], "maxs": [1, 0.5]})[0],
        "m.splat4d": test_formats_straight.records(rng, COUNT).tobytes()}


COUNTS = {"packed.safetensors": 211, "m.splats4d": 21, "m.sog4d": 13, "frames.sog4d": 13, "m.tsog": 14}


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, bytes]:
    rng, folder = np.random.default_rng(11), tmp_path_factory.mktemp("claims")
    for name, kinds in KINDS.items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", fg.LossWarning)
            model = random_model(rng, COUNTS.get(name, COUNT), **kinds)
            fg.save(model, folder / name, compress="fine" if name.startswith("packed") else None)
    return {name: (folder / name).read_bytes() for name in KINDS} | made_elsewhere(rng)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*KINDS, "m.ksplat", "v4.spz", "m.splats4d", "m.sog4d", "frames.sog4d", "m.tsog", "m.splat4d"])
def test_no_memory_on_the_word_of_a_file(files, tmp_path, name):
    path, told = tmp_path / Path(name).name.removeprefix("packed."), 0
    for what, data in liars(files[name], COUNTS.get(name, COUNT)):
        path.write_bytes(data)
        told += refused(lambda: fg.open_source(path), len(data), what)
    assert told or name in ("m.splat", "m.splat4d"), "none of its claims is refused"


def read_first_moment(path: Path):
    """Open a model and compute what it shows first: checkpoints beside a model are read no earlier."""
    return lambda: fg.open_source(path).moment(0.0)


@pytest.mark.parametrize("write", [np.savez, np.savez_compressed])
def test_no_memory_on_the_word_of_npz_files(tmp_path, rng, write):
    import test_formats_dynamic3d
    import test_formats_straight

    for arrays in (test_formats_dynamic3d.params(rng), test_formats_straight.raw(rng) | {"n_frames": np.int64(31)}):
        path, told = tmp_path / "params.npz", 0
        write(path, **arrays)
        fg.load(path)
        for what, data in list(lying_zips(path.read_bytes())):
            path.write_bytes(data)
            told += refused(read_first_moment(path), len(data), what)
        assert told > len(arrays)


def checkpoints(folder: Path, rng) -> dict[str, tuple[Path, Path]]:
    """name -> the pickled file that lies, and the file that is opened."""
    import test_formats_deformed
    import test_formats_realtime4dgs
    import test_formats_research
    import test_formats_splat_checkpoints
    import test_formats_straight

    made = {name: (folder / name,) * 2 for name in ("freetime.pt", "realtime.pth", "rotor.ckpt", "gsplat.pt", "nerfstudio.ckpt")}
    test_formats_splat_checkpoints.gsplat(folder / "gsplat.pt", test_formats_splat_checkpoints.raw(rng))
    test_formats_splat_checkpoints.nerfstudio(folder / "nerfstudio.ckpt", test_formats_splat_checkpoints.raw(rng))
    test_formats_straight.checkpoint(folder / "freetime.pt", test_formats_straight.raw(rng))
    test_formats_realtime4dgs.saved(folder / "realtime.pth", test_formats_realtime4dgs.raw(rng))
    test_formats_research.saved(folder / "rotor.ckpt", test_formats_research.rotor(rng))
    _, cloud, _ = test_formats_deformed.hexplane(folder / "deformed", rng)
    return made | {"deformation.pth": (cloud.with_name("deformation.pth"), cloud)}


@pytest.mark.slow
def test_no_memory_on_the_word_of_pickles(tmp_path, rng):
    for name, (lying, opened) in checkpoints(tmp_path, rng).items():
        told, whole = 0, lying.read_bytes()
        read_first_moment(opened)()
        lies = list(lying_zips(whole))
        for what, data in lies[::len(lies) // 25]:
            lying.write_bytes(data)
            told += refused(read_first_moment(opened), len(data), f"{name}, {what}")
        assert told > 5, name

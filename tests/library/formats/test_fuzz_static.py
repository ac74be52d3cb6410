# SPDX-License-Identifier: GPL-3.0-or-later
"""Mutated files of the static formats: a model of finite numbers, or one FastGSError."""
from __future__ import annotations

import json
import warnings
from pathlib import Path

import mutations
import numpy as np
import ply_files
import pytest
from ply_files import INRIA
from random_models import random_model

import fastgs_blender as fg


def usable(path: Path) -> None:
    """Load the file; whatever comes of it must be usable."""
    model = fg.load(path)
    assert all(np.isfinite(array).all() and array.dtype == np.float32 for array in model.arrays.values())
    s = fg.slice_model(model, 0, cull=False)
    assert all(np.isfinite(v).all() for v in (s.position, s.rotation, s.scale, s.opacity, s.features))


def saved(folder: Path, name: str, **kinds) -> bytes:
    """What save() writes of a small random model under this name."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fg.LossWarning)
        fg.save(random_model(np.random.default_rng(3), 7, **kinds), folder / name)
    return (folder / name).read_bytes()


def splat(folder):
    return {"records": {"m.splat": saved(folder, "m.splat")}}


def spz(folder):
    from test_formats_spz import file, packed

    rng = np.random.default_rng(5)
    written = {f"v{v}-{d}": {"m.spz": file(v, 6, d, packed(rng, v, 6, d))} for v, d in ((1, 0), (2, 1), (3, 3), (3, 4), (4, 0), (4, 2))}
    return {"written": {"m.spz": saved(folder, "m.spz", appearance="sh2")}, **written}


def plys(folder):
    """Compressed ones, and one of Mip-Splatting."""
    table = ply_files.columns(np.random.default_rng(4), [*INRIA, "filter_3D"], 9)
    compressed = {f"sh{degree}": {"m.ply": saved(folder, "m.compressed.ply", appearance=f"sh{degree}")} for degree in (0, 1, 3)}
    return {"filter_3D": {"m.ply": ply_files.ply(table)}, **compressed}


def ksplat(folder):
    from test_formats_ksplat import file, gaussians

    rng = np.random.default_rng(5)
    return {f"level{level}": {"m.ksplat": file([gaussians(rng, 9, degree), gaussians(rng, 4, 1)], level)[0]}
            for level, degree in ((0, 1), (1, 2), (2, 2))}


def sog(folder):
    from test_formats_sog import contents, zipped

    rng = np.random.default_rng(5)
    made = {f"v{version}-{degree}": {"m.sog": zipped(contents(rng, 9, degree, version)[0])} for version, degree in ((1, 0), (1, 2), (2, 1))}
    return {"written": {"m.sog": saved(folder, "m.sog", appearance="sh2")}, **made}


def sog_folder(folder):
    from test_formats_sog import contents

    rng = np.random.default_rng(6)
    return {f"v{version}": contents(rng, 9, 1, version)[0] for version in (1, 2)}


def glb(folder):
    from test_formats_gltf import assumed_file, random_file

    return {"written": {"m.glb": saved(folder, "m.glb", appearance="sh1")}, "packed": {"m.glb": random_file(packed=True)[0]},
            "short": {"m.glb": random_file(short=True)[0]}, "assumed": {"m.glb": assumed_file()}}


def gltf(folder):
    """A .gltf whose numbers lie in a file beside it."""
    data = saved(folder, "m.glb", appearance="sh1")
    size = int.from_bytes(data[12:16], "little")
    values = json.loads(data[20:20 + size])
    values["buffers"][0]["uri"] = "m.bin"
    return {"beside": {"m.gltf": json.dumps(values).encode(), "m.bin": data[28 + size:]}}


SEEDS = {"m.glb": glb, "m.gltf": gltf, "m.sog": sog, "meta.json": sog_folder, "m.ksplat": ksplat, "m.ply": plys, "m.splat": splat,
         "m.spz": spz}


@pytest.mark.slow
@pytest.mark.parametrize("name", SEEDS)
def test_mutated_files(name, tmp_path):
    (tmp_path / "seeds").mkdir()
    seeds = SEEDS[name](tmp_path / "seeds")
    told = mutations.campaign(name, lambda folder: usable(folder / name), seeds, tmp_path)
    assert not told or min(told.values()) > 10

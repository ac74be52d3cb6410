# SPDX-License-Identifier: GPL-3.0-or-later
"""No reader takes memory on the word of a file: at most four times its size before what it claims is verified."""
from __future__ import annotations

import re
import struct
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest
from random_models import random_model

import fastgs_blender as fg

COUNT = 3989
"""Gaussians; a number that nothing else in a file is likely to be."""
BIG = 1999 * COUNT
TIMES, SLACK = 4, 1 << 20
"""How many times its size a file may take, and bytes that any reading takes: buffers, tables, JSON."""
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


def liars(data: bytes, count: int):
    """The file cut short, and with every number of its Gaussians, in text or in binary, made large."""
    yield "cut short", data[:int(0.6 * len(data))]
    for code in ("<I", "<Q", ">I"):
        raw = struct.pack(code, count)
        for found in list(re.finditer(re.escape(raw), data[:8192]))[:6]:
            yield f"{code} at {found.start()}", data[:found.start()] + struct.pack(code, BIG) + data[found.end():]
    text = str(count).encode()
    for found in list(re.finditer(rb"(?<!\d)" + text + rb"(?!\d)", data[:8192]))[:8]:
        yield f"text at {found.start()}", data[:found.start()] + str(BIG).encode()[:len(text)].ljust(len(text), b"9") + data[found.end():]
        yield f"long text at {found.start()}", data[:found.start()] + str(BIG).encode() + data[found.end():]


@pytest.mark.parametrize("name", [*KINDS, "m.ksplat", "v4.spz", "m.splats4d", "m.sog4d", "frames.sog4d", "m.tsog", "m.splat4d"])
def test_no_memory_on_the_word_of_a_file(files, tmp_path, name):
    path, told = tmp_path / Path(name).name.removeprefix("packed."), 0
    for what, data in liars(files[name], COUNTS.get(name, COUNT)):
        path.write_bytes(data)
        tracemalloc.start()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", fg.LossWarning)
                fg.open_source(path)
        except fg.FastGSError:
            told += 1
            peak = tracemalloc.get_traced_memory()[1]
            assert peak <= TIMES * len(data) + SLACK, f"{what}: {peak} bytes for a file of {len(data)}"
        finally:
            tracemalloc.stop()
    assert told or name in ("m.splat", "m.splat4d"), "none of its claims is refused"

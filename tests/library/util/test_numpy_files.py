# SPDX-License-Identifier: GPL-3.0-or-later
"""NumPy's files: what NumPy wrote comes back; anything else is one sentence, within bounds."""
from __future__ import annotations

import io
import zipfile

import mutations
import numpy as np
import pytest

from fastgs_blender.util.errors import FastGSError
from fastgs_blender.util.numpy_files import read_array

ARRAYS = [np.arange(24.0).reshape(2, 3, 4), np.asfortranarray(np.arange(6, dtype=">i2").reshape(2, 3)), np.float32(3).reshape(()),
          np.zeros((0, 5), np.uint8)]


def npz(**arrays) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def npy(array) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


@pytest.mark.parametrize("array", ARRAYS)
def test_what_numpy_wrote_comes_back(tmp_path, array):
    (tmp_path / "a.npy").write_bytes(npy(array))
    (tmp_path / "a.npz").write_bytes(npz(data=array, other=np.ones(3)))
    for found in (read_array(tmp_path / "a.npy"), read_array(tmp_path / "a.npz", "data")):
        assert found.dtype == array.dtype and found.flags.writeable
        np.testing.assert_array_equal(found, array)


def read(folder):
    if (folder / "a.npz").exists():
        assert read_array(folder / "a.npz", "data").dtype.kind in "fiu"
    else:
        assert read_array(folder / "a.npy").dtype.kind in "fiu"


def test_mutations(tmp_path):
    seeds = {"npy": {"a.npy": npy(ARRAYS[0])}, "fortran": {"a.npy": npy(ARRAYS[1])}, "npz": {"a.npz": npz(data=ARRAYS[0], more=ARRAYS[3])}}
    told = mutations.campaign("numpy", read, seeds, tmp_path)
    assert min(told.values()) > 0


def claiming(shape: str) -> bytes:
    """An .npy file of ten numbers whose header claims another shape."""
    return npy(np.zeros(10)).replace(b"(10,), }   " + b" " * (len(shape) - 5), f"({shape}), }}   ".encode(), 1)


def lzma() -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("data.npy", npy(np.zeros(100)))
    return stream.getvalue()


@pytest.mark.slow
def test_files_that_take_more_than_they_hold(tmp_path):
    seeds = {
        "unpacks to 0.8 GB": {"a.npz": npz(data=np.zeros(10**8))}, "claims an exabyte": {"a.npy": claiming("1000000, 1000000, 1000000")},
        "claims 2 GB": {"a.npy": claiming("250000000, ")}, "claims -1": {"a.npy": claiming("-1, 5, -2")}, "lzma": {"a.npz": lzma()},
        "text": {"a.npy": npy(np.array(["a"]))}, "objects": {"a.npy": npy(np.array([{}], object))}, "no such name": {"a.npz": npz(other=1)},
    }
    assert mutations.attacks("numpy", read, seeds, tmp_path, memory=256 << 20) == {"accepted": 0, "refused": len(seeds)}


def test_the_refusal_names_file_and_array(tmp_path):
    (tmp_path / "a.npz").write_bytes(npz(data=np.zeros(10**7)))
    with pytest.raises(FastGSError, match=r"a\.npz.* 80000128 bytes.*100 times.*'data'"):
        read_array(tmp_path / "a.npz", "data")

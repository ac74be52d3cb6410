# SPDX-License-Identifier: GPL-3.0-or-later
"""Zip files that would take more memory than they hold are refused before it is taken."""
from __future__ import annotations

import contextlib
import io
import tracemalloc
import zipfile

import pytest

import fastgs_blender as fg
from fastgs_blender.util.zip_files import opened_zip, read_member


def many(count: int, content: bytes = b"") -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for i in range(count):
            archive.writestr(zipfile.ZipInfo(f"{i:05}"), content)
    return out.getvalue()


def test_a_table_of_contents_that_is_a_bomb(tmp_path):
    data = many(20_000)
    (tmp_path / "m.zip").write_bytes(data)
    tracemalloc.start()
    try:
        with pytest.raises(fg.FastGSError):
            fg.load(tmp_path / "m.zip")
        assert tracemalloc.get_traced_memory()[1] < 4 * len(data)
        with pytest.raises(fg.FastGSError, match="table of contents"), opened_zip(tmp_path / "m.zip"):
            pass
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(("count", "content"), [(3000, b""), (20_000, bytes(600))])
def test_archives_of_many_files_are_read(tmp_path, count, content):
    (tmp_path / "m.zip").write_bytes(many(count, content))
    with opened_zip(tmp_path / "m.zip") as archive:
        assert len(archive.namelist()) == count


@pytest.mark.parametrize("packing", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_what_would_take_any_memory_to_unpack_is_refused_before(tmp_path, packing):
    with zipfile.ZipFile(tmp_path / "m.zip", "w", packing) as archive:
        archive.writestr("a", b"a")
    for opens in (opened_zip, fg.load):
        with pytest.raises(fg.FastGSError, match="LZMA.*bzip2"), contextlib.ExitStack() as stack:
            stack.enter_context(opens(tmp_path / "m.zip"))


def with_entry(packing: int, content: bytes, **sizes: int) -> bytes:
    """A zip file of one member; sizes: compress_size or file_size that its entry has instead of the true one."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", packing) as archive:
        archive.writestr("a", content)
        for name, value in sizes.items():
            setattr(archive.getinfo("a"), name, value)
    return out.getvalue()


def test_an_entry_that_says_more_or_less_than_there_is(tmp_path):
    """No buffer is made of the size that an entry says, nor of all that unpacks from a member whose entry says little."""
    cases = (with_entry(zipfile.ZIP_STORED, b"some", compress_size=2**31 - 9), with_entry(zipfile.ZIP_STORED, b"some", file_size=40),
             with_entry(zipfile.ZIP_DEFLATED, bytes(64 << 20), file_size=4))
    for data, said in zip(cases, ("longer than the file", "4 bytes instead of 40", "Bad CRC-32"), strict=True):
        (tmp_path / "m.zip").write_bytes(data)
        tracemalloc.start()
        try:
            with pytest.raises((fg.FastGSError, zipfile.BadZipFile), match=said), opened_zip(tmp_path / "m.zip") as archive:
                read_member(archive, archive.getinfo("a"))
            assert tracemalloc.get_traced_memory()[1] < 1 << 20
        finally:
            tracemalloc.stop()

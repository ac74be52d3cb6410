# SPDX-License-Identifier: GPL-3.0-or-later
"""Zip files that are nothing but a table of contents are refused before it is read."""
from __future__ import annotations

import io
import tracemalloc
import zipfile

import pytest

import fastgs_blender as fg
from fastgs_blender.util.zip_files import opened_zip


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


def test_what_would_take_any_memory_to_unpack_is_refused_before(tmp_path):
    with zipfile.ZipFile(tmp_path / "m.zip", "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("a", b"a")
    with pytest.raises(fg.FastGSError, match="LZMA"), opened_zip(tmp_path / "m.zip"):
        pass

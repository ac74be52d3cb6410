# SPDX-License-Identifier: GPL-3.0-or-later
"""A file that is no model gets one sentence that says what it looks like."""
from __future__ import annotations

import io
import tarfile

import numpy as np
import pytest
from PIL import Image

import fastgs_blender as fg


def picture(kind: str) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (40, 30)).save(out, kind)
    return out.getvalue()


def tar() -> bytes:
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w") as archive:
        archive.addfile(tarfile.TarInfo("a"))
    return out.getvalue()


LOOKS = {
    "PNG": (picture("PNG"), "a picture"), "JPEG": (picture("JPEG"), "a picture"), "WebP": (picture("WEBP"), "a picture"),
    "TIFF": (picture("TIFF"), "a picture"), "MP4": (b"\0\0\0\x20ftypisom" + bytes(50), "a video"), "MKV": (b"\x1aE\xdf\xa3abc", "a video"),
    "web page": (b"\xef\xbb\xbf\n<!DOCTYPE html><title>404</title>", "web page"), "XML": (b"<?xml version='1.0'?><a/>", "XML"),
    "LFS": (b"version https://git-lfs.github.com/spec/v1\noid sha256:1\nsize 5\n", "git lfs pull"), "JSON": (b'{"a": [1, 2]}', "JSON"),
    "OBJ": (b"# a mesh\nv 0 0 0\nv 1 0 0\nf 1 2 3\n", "it is text"), "zeros": (bytes(1000), "broken off"), "tar": (tar(), "tar archive"),
    "FBX": (b"Kaydara FBX Binary  \0\x1a\0", "an FBX file"), "LAS": (b"LASF" + bytes(200), "plain point cloud"),
    "7z": (b"7z\xbc\xaf'\x1c" + bytes(30), "7z archive"), "zip": (b"PK\x03\x04" + bytes(30), "zip archive"),
    "gzip": (b"\x1f\x8b\x08" + bytes(30), "gzip"), "pickle": (b"\x80\x02}q\0.", "never opened"), "blend": (b"BLENDER-v405", "blend file"),
    "numpy": (b"\x93NUMPY\x01\0" + bytes(80), "numpy array"), "noise": (np.random.default_rng(3).bytes(3001), "without a mark"),
}


@pytest.mark.parametrize("kind", LOOKS)
def test_an_unknown_file_is_named_by_its_looks(tmp_path, kind):
    content, said = LOOKS[kind]
    path = tmp_path / "model.bin"
    path.write_bytes(content)
    with pytest.raises(fg.FastGSError, match=said) as error:
        fg.load(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)

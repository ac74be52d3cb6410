# SPDX-License-Identifier: GPL-3.0-or-later
"""A file that is no model gets one sentence that says what it looks like."""
from __future__ import annotations

import io
import struct
import tarfile
import zipfile

import mutations
import numpy as np
import pytest
from PIL import Image

import fastgs_blender as fg
from fastgs_blender.formats import HEAD
from fastgs_blender.formats.foreign import look
from fastgs_blender.util.errors import printable


def picture(kind: str) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (40, 30)).save(out, kind)
    return out.getvalue()


def tar() -> bytes:
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w") as archive:
        archive.addfile(tarfile.TarInfo("a"))
    return out.getvalue()


def zipped(*names: str) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name in names:
            archive.writestr(name, b"content")
    return out.getvalue()


def gltf(as_glb: bool) -> bytes:
    text = b'{"asset":{"version":"2.0"},"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]}   '
    return b"glTF" + struct.pack("<IIII", 2, 20 + len(text), len(text), 0x4E4F534A) + text if as_glb else text


LOOKS = {
    "PNG": (picture("PNG"), "a picture"), "JPEG": (picture("JPEG"), "a picture"), "WebP": (picture("WEBP"), "a picture"),
    "TIFF": (picture("TIFF"), "a picture"), "MP4": (b"\0\0\0\x20ftypisom" + bytes(50), "a video"),
    "MKV": (b"\x1aE\xdf\xa3abc", "a video"), "web page": (b"\xef\xbb\xbf\n<!DOCTYPE html><title>404</title>", "web page"),
    "XML": (b"<?xml version='1.0'?><a/>", "XML"),
    "LFS": (b"version https://git-lfs.github.com/spec/v1\noid sha256:1\nsize 5\n", "git lfs pull"), "JSON": (b'{"a": [1, 2]}', "JSON"),
    "OBJ": (b"# a mesh\nmtllib a.mtl\no Cube\nv 0 0 0\nv 1 0 0\nf 1 2 3\n", "OBJ mesh"),
    "text": (b"v is a letter,\nand so is w\n", "it is text"), "STL": (b"solid cube\nfacet normal 0 0 1\nouter loop\n", "STL mesh"),
    "zeros": (bytes(1000), "broken off"), "tar": (tar(), "tar archive"), "FBX": (b"Kaydara FBX Binary  \0\x1a\0", "an FBX file"),
    "LAS": (b"LASF" + bytes(200), "plain point cloud"), "7z": (b"7z\xbc\xaf'\x1c" + bytes(30), "7z archive"),
    "zip": (b"PK\x03\x04" + bytes(30), "zip archive"), "gzip": (b"\x1f\x8b\x08" + bytes(30), "gzip"),
    "pickle": (b"\x80\x02}q\0.", "never opened"), "blend": (b"BLENDER-v405", "blend file"),
    "binary STL": (b"Exported".ljust(80, b"\1") + struct.pack("<I", 2) + bytes(100), "STL mesh"),
    "E57": (b"ASTM-E57" + bytes(90), "point cloud"), "PCD": (b"# .PCD v0.7\nVERSION 0.7\n", "point cloud"),
    "XYZ": (b"0.5 1 -2e3\n4 5 6\n7 8 9\n", "numbers in text"), "HDR": (b"#?RADIANCE\n\n", "a picture"),
    "HEIC": (b"\0\0\0\x18ftypheic" + bytes(20), "a picture"), "AVI": (b"RIFF\1\0\0\0AVI LIST", "a video"),
    "WAV": (b"RIFF\1\0\0\0WAVEfmt ", "a sound"), "Alembic": (b"Ogawa\xff\0\1", "Alembic"), "VDB": (b" BDV\0\0\0\0", "OpenVDB"),
    "xz": (b"\xfd7zXZ\0\0", "xz archive"), "COLMAP's database": (b"SQLite format 3\0" + bytes(20), "SQLite"),
    "docx": (zipped("[Content_Types].xml", "word/document.xml"), "office document"),
    "npz": (zipped("a.npy", "b.npy"), r"numpy arrays \(a, b\)"),
    "zip of pictures": (zipped("1.jpg", "2.jpg", "notes.txt"), "archive of pictures"),
    "zip of meshes": (zipped("a.obj", "b.obj"), "zip archive of .obj"), "PyTorch": (zipped("x/data.pkl", "x/data/0"), "file of PyTorch"),
    "mesh .glb": (gltf(True), "File > Import > glTF"), "mesh .gltf": (gltf(False), "File > Import > glTF"),
    "transforms.json": (b'{"camera_angle_x": 1, "frames": []}', "cameras of a capture"),
    "cameras.json": (b'[{"id": 0, "position": [0, 0, 0], "rotation": []}]', "cameras of a capture"),
    "numpy": (b"\x93NUMPY\x01\0" + bytes(80), "numpy array"), "noise": (np.random.default_rng(3).bytes(3001), "without a mark"),
}


@pytest.mark.parametrize("kind", LOOKS)
def test_an_unknown_file_is_named_by_its_looks(tmp_path, kind):
    content, said = LOOKS[kind]
    path = tmp_path / "model.bin"
    path.write_bytes(content)
    with pytest.raises(fg.FastGSError, match=said) as error:
        fg.load(path)
    text = str(error.value)
    assert str(path) in text and "\n" not in text and len(text) < len(str(path)) + 230  # a sentence


DAMAGED = ("docx", "npz", "zip of pictures", "PyTorch", "transforms.json", "mesh .glb", "OBJ", "STL")


def test_damaged_foreign_files(tmp_path):
    """Whatever is damaged in them: a short clause, a guess, or a refusal in one sentence."""
    def read(folder):
        path = folder / "m"
        text = look(path.read_bytes()[:HEAD], path) or ""
        assert len(text) < 230 and text == printable(text)

    told = mutations.campaign("foreign files", read, {kind: {"m": LOOKS[kind][0]} for kind in DAMAGED}, tmp_path)
    assert not told or told["accepted"]

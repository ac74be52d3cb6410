# SPDX-License-Identifier: GPL-3.0-or-later
"""explain() says why a file cannot be read, and what to do about it: most foreign files are recognisable."""
from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path

from ..util.reading import reading
from ..util.zip_files import opened_zip
from . import ply, zipped

PICTURE = "it is a picture, not a model; models are trained from several (fastgs train)"
VIDEO = "it is a video, not a model; models are trained from several (fastgs train)"
PICKLE = "it is a Python pickle, which may run any program and is never opened; export the model as .ply"
MAGIC = {
    b"PK\x03\x04": "it is a zip archive, but no model that is known (of checkpoints, those of FreeTimeGS, 4DGS and Hybrid 3D-4DGS are); "
                   "open the .ply or .safetensors that belongs to it",
    b"\x1f\x8b": "it is a gzip file, but not .spz; unpack it first",
    b"glTF": "it is a glTF file without Gaussians (KHR_gaussian_splatting); in Blender use File > Import > glTF",
    b"\x93NUMPY": "it is a numpy array, not a model",
    **{b"\x80" + bytes([protocol]): PICKLE for protocol in range(2, 6)},
    b"BLENDER": "it is a .blend file; open it in Blender",
    b"(\xb5/\xfd": "it is a zstd archive; unpack it first (a .blend file is one too: open that in Blender)",
    b"7z\xbc\xaf'\x1c": "it is a 7z archive; unpack it first",
    b"Rar!": "it is a rar archive; unpack it first",
    b"version https://git-lfs": "it is a note of Git LFS in the place of the file; fetch the file itself (git lfs pull)",
    b"\x89PNG": PICTURE, b"\xff\xd8\xff": PICTURE, b"GIF8": PICTURE, b"\x76\x2f\x31\x01": PICTURE, b"BM": PICTURE, b"II*\0": PICTURE,
    b"MM\0*": PICTURE, b"\x1aE\xdf\xa3": VIDEO,
    b"Kaydara FBX": "it is an FBX file; in Blender use File > Import > FBX",
    b"LASF": "it is a plain point cloud (LAS), not a Gaussian model; train one from its pictures",
    b"\x89HDF": "it is an HDF5 file, not a model that is known; export the model as .ply",
    b"%PDF": "it is a PDF document",
}
"""What files begin with, and what they are."""
INSIDE = ((slice(4, 8), b"ftyp", VIDEO), (slice(8, 12), b"WEBP", PICTURE),
          (slice(257, 262), b"ustar", "it is a tar archive; unpack it first"))
"""The same for marks further inside."""
GAUSSIAN = ("x", "y", "z", "opacity", "f_dc_0", "f_dc_1", "f_dc_2", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4)))
"""The columns without which there is no Gaussian."""


def explain(head: bytes, path: Path, known: Sequence[str]) -> str:
    """One clause on why the file cannot be read, and what to do; known: the formats that are read.  Raises FastGSError for a
    broken PLY header."""
    if head.startswith(b"ply"):
        return _explain_ply(ply.read_header(path))
    if head.startswith(zipped.MAGIC):
        with reading(path, "copy it again"):
            try:
                with opened_zip(path):
                    pass
            except zipfile.BadZipFile as error:
                return f"it is a broken zip archive ({error}); copy it again"
    for magic, text in MAGIC.items():
        if head.startswith(magic):
            return text
    for place, mark, text in INSIDE:
        if head[place] == mark:
            return text
    return f"{_look(head)}, and none of the known formats ({', '.join(known)})"


def _look(head: bytes) -> str:
    """A guess, as a clause, at the kind of a file that begins with no known mark."""
    if not head.strip(b"\0"):
        return "it begins with zeros, as files do whose download was broken off"
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    if text.startswith((b"<!doctype html", b"<html")):
        return "it is a web page, perhaps in the place of a download"
    if text.startswith((b"<?xml", b"<")):
        return "it is XML"
    if text.startswith((b"{", b"[")):
        return "it is JSON, but not of a model"
    if all(byte >= 32 or byte in b"\t\r\n\f" for byte in head) and b"\x7f" not in head:
        return "it is text"
    return "it is binary data without a mark that is known"


def _explain_ply(header: ply.Header) -> str:
    names = header.names
    if is_2dgs(header):
        return "it holds flat 2DGS surfels, not 3D Gaussians; train it with a 3D method"
    if any(name.startswith("motion_") for name in names) or {"t", "t_scale"} & names:
        return ("it is a 4D model of a kind that is not supported (of 4D PLY files, those of Spacetime Gaussians, FreeTimeGS and "
                "Mediastorm are); export it as Spacetime Gaussians .ply")
    missing = [name for name in GAUSSIAN if name not in names]
    kind = "a mesh" if any(e.name == "face" and e.count for e in header.elements) else "a plain point cloud"
    what = f"it is {kind}, not a Gaussian model" if {"opacity", "f_dc_0", "rot_0"}.isdisjoint(names) else "it is incomplete"
    return f"{what}: its vertices have no {', '.join(missing)}"


def is_2dgs(header: ply.Header) -> bool:
    """Whether a PLY file holds surfels of 2D Gaussian splatting."""
    scales = {"scale_0", "scale_1"} <= header.names and "scale_2" not in header.names
    return scales or any(c.lower().replace(" ", "") == "splatrendermode:2dgs" for c in header.comments)

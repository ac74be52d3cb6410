# SPDX-License-Identifier: GPL-3.0-or-later
"""explain() says why a file cannot be read, and what to do about it: most foreign files are recognisable."""
import re
import zipfile
from collections import Counter
from pathlib import Path, PurePosixPath

from ..util.documentation import page
from ..util.errors import FastGSError, printable
from ..util.reading import reading
from ..util.zip_files import MAGIC as ZIP
from ..util.zip_files import opened_zip
from . import ply
from .description import read_json
from .static import read_whole

GAUSSIAN = ("x", "y", "z", "opacity", "f_dc_0", "f_dc_1", "f_dc_2", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4)))
"""The columns without which there is no Gaussian."""
PICTURE = "it is a picture, not a model; models are trained from several (fastgs train)"
VIDEO = "it is a video, not a model; models are trained from several (fastgs train)"
SOUND = "it is a sound, not a model"
CLOUD = "it is a plain point cloud ({}), not a Gaussian model; train one from its pictures"
CAPTURE = "it describes cameras of a capture, not a model; train one from the capture (fastgs train)"
GLTF = "it is a glTF file without Gaussians (KHR_gaussian_splatting); in Blender use File > Import > glTF"
STL = "it is an STL mesh; in Blender use File > Import > STL"
PICKLE = "it is a Python pickle, which may run any program and is never opened; export the model as .ply"
CHECKPOINT = ("it is a file of PyTorch, but no model that is known (of dynamic checkpoints, those of FreeTimeGS, 4DGS, Hybrid 3D-4DGS and "
              "4D-Rotor are); open the .ply that belongs to it")
MAGIC = {
    b"\x1f\x8b": "it is a gzip file, but not .spz; unpack it first",
    b"glTF": GLTF,
    b"\x93NUMPY": "it is a numpy array, not a model",
    **{b"\x80" + bytes([protocol]): PICKLE for protocol in range(2, 6)},
    b"BLENDER": "it is a .blend file; open it in Blender",
    b"(\xb5/\xfd": "it is a zstd archive; unpack it first (a .blend file is one too: open that in Blender)",
    b"7z\xbc\xaf'\x1c": "it is a 7z archive; unpack it first",
    b"Rar!": "it is a rar archive; unpack it first",
    b"\xfd7zXZ\0": "it is an xz archive; unpack it first", b"BZh": "it is a bzip2 archive; unpack it first",
    b"version https://git-lfs": "it is a note of Git LFS in the place of the file; fetch the file itself (git lfs pull)",
    b"\x89PNG": PICTURE, b"\xff\xd8\xff": PICTURE, b"GIF8": PICTURE, b"\x76\x2f\x31\x01": PICTURE, b"BM": PICTURE, b"II*\0": PICTURE,
    b"MM\0*": PICTURE, b"8BPS": PICTURE, b"#?RADIANCE": PICTURE, b"#?RGBE": PICTURE, b"\x1aE\xdf\xa3": VIDEO,
    b"Kaydara FBX": "it is an FBX file; in Blender use File > Import > FBX",
    b"Ogawa": "it is an Alembic file; in Blender use File > Import > Alembic",
    b" BDV": "it is an OpenVDB volume; in Blender use Add > Volume > Import OpenVDB",
    b"LASF": CLOUD.format("LAS"), b"ASTM-E57": CLOUD.format("E57"), b"# .PCD": CLOUD.format("PCD"),
    b"\x89HDF": "it is an HDF5 file, not a model that is known; export the model as .ply",
    b"SQLite format 3\0": "it is an SQLite database, as COLMAP keeps of pictures, and no model",
    b"%PDF": "it is a PDF document",
}
"""What files begin with, and what they are."""
INSIDE = ((slice(4, 12), b"ftyp(heic|heix|mif1|avif)", PICTURE), (slice(4, 8), b"ftyp", VIDEO), (slice(8, 12), b"WEBP", PICTURE),
          (slice(8, 12), b"AVI ", VIDEO), (slice(8, 12), b"WAVE", SOUND),
          (slice(257, 262), b"ustar", "it is a tar archive; unpack it first"))
"""The same for marks further inside."""
PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".exr", ".tif", ".tiff", ".hdr")
OBJ = {b"v", b"vn", b"vt", b"f", b"o", b"g", b"s", b"mtllib", b"usemtl", b"l", b"p"}
NUMBER = re.compile(rb"[-+.\deE]+")
MAX_JSON = 1 << 22
"""Bytes of JSON that is looked into."""


def explain(head: bytes, path: Path) -> str:
    """One clause on why the file cannot be read, and what to do.  head: its first bytes.  Raises FastGSError for a broken PLY header."""
    if head.startswith(b"ply"):
        return _explain_ply(ply.read_header(path))
    return look(head, path) or f"{_guess(head)}, and none of the known formats, which {page('formats')} and Blender's import dialog list"


def _explain_ply(header: ply.Header) -> str:
    names = header.names
    if any(element.name == "codebook_centers" for element in header.elements):
        return "it is a reduced 3DGS PLY with codebooks, which is not read; export it as an ordinary .ply"
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


def look(head: bytes, path: Path) -> str | None:
    """What the file is and what to do with it, as a clause; None where nothing tells.  head: the file's first bytes."""
    if head.startswith(ZIP):
        return _zip(path)
    for magic, text in MAGIC.items():
        if head.startswith(magic):
            return text
    for place, mark, text in INSIDE:
        if re.fullmatch(mark, head[place]):
            return text
    if len(head) >= 84 and path.stat().st_size == 84 + 50 * int.from_bytes(head[80:84], "little"):
        return STL
    begin = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    return _json(path) if begin.startswith((b"{", b"[")) else _text(begin)


def _guess(head: bytes) -> str:
    """A guess, as a clause, at the kind of a file of which look() knows nothing."""
    if not head.strip(b"\0"):
        return "it begins with zeros, as files do whose download was broken off"
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    if text.startswith((b"<!doctype html", b"<html")):
        return "it is a web page, perhaps in the place of a download (for one that plays a model, choose the model)"
    if text.startswith((b"<?xml", b"<")):
        return "it is XML"
    if text.startswith((b"{", b"[")):
        return "it is JSON, but not of a model"
    if all(byte >= 32 or byte in b"\t\r\n\f" for byte in head) and b"\x7f" not in head:
        return "it is text"
    return "it is binary data without a mark that is known"


def _zip(path: Path) -> str:
    """By the names in it."""
    with reading(path, "copy it again"):
        try:
            with opened_zip(path) as archive:
                names = [info.filename for info in archive.infolist() if not info.is_dir()]
        except zipfile.BadZipFile as error:
            return f"it is a broken zip archive ({error}); copy it again"
    kinds = Counter(PurePosixPath(name).suffix.lower() for name in names)
    if any(PurePosixPath(name).name == "data.pkl" for name in names):
        return CHECKPOINT
    if "[Content_Types].xml" in names:
        return "it is an office document, not a model"
    if names and kinds[".npy"] == len(names):
        arrays = ", ".join(printable(name.removesuffix(".npy"))[:40] for name in names[:6])
        return f"it is a set of numpy arrays ({arrays}{', ...' if len(names) > 6 else ''}), but no model that is known"
    if sum(kinds[kind] for kind in PICTURES) > len(names) / 2:
        return "it is a zip archive of pictures; a model is trained from them (unpack it, then fastgs train)"
    most = ", ".join(printable(kind)[:12] for kind, _ in kinds.most_common(3) if kind)
    return f"it is a zip archive{f' of {most}' if most else ''}, in which there is no model that is known; unpack it, and open the model"


def _json(path: Path) -> str | None:
    """By the keys in it."""
    if path.stat().st_size > MAX_JSON:
        return None
    try:
        tree = read_json(read_whole(path))
    except FastGSError:
        return None
    if isinstance(tree, list):
        return CAPTURE if tree and isinstance(tree[0], dict) and "rotation" in tree[0] and "position" in tree[0] else None
    if "asset" in tree and ("meshes" in tree or "scenes" in tree):
        return GLTF
    return CAPTURE if isinstance(tree.get("frames"), list) and any(key.startswith(("camera_", "fl_")) for key in tree) else None


def _text(text: bytes) -> str | None:
    """By the first lines."""
    lines = [line.split() for line in text.splitlines()[:-1] if line.strip() and not line.startswith(b"#")]
    words = {line[0] for line in lines}
    if text.startswith(b"solid") and b"facet" in words:
        return STL
    numbers = [word for line in lines if line[0] == b"v" for word in line[1:]]
    if (numbers or b"mtllib" in words) and words <= OBJ and all(map(NUMBER.fullmatch, numbers)):
        return "it is an OBJ mesh; in Blender use File > Import > Wavefront"
    if len(lines) > 1 and all(len(line) >= 3 and all(map(NUMBER.fullmatch, line)) for line in lines):
        return CLOUD.format("numbers in text")
    return None

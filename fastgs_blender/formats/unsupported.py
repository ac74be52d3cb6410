# SPDX-License-Identifier: GPL-3.0-or-later
"""explain() says why a file cannot be read, and what to do about it."""
from __future__ import annotations

from pathlib import Path

from ..util.documentation import page
from . import ply
from .foreign import guess, look

GAUSSIAN = ("x", "y", "z", "opacity", "f_dc_0", "f_dc_1", "f_dc_2", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4)))
"""The columns without which there is no Gaussian."""


def explain(head: bytes, path: Path) -> str:
    """One clause on why the file cannot be read, and what to do.  head: its first bytes.  Raises FastGSError for a broken PLY header."""
    if head.startswith(b"ply"):
        return _explain_ply(ply.read_header(path))
    return look(head, path) or f"{guess(head)}, and none of the known formats, which {page('formats')} and Blender's import dialog list"


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

# SPDX-License-Identifier: GPL-3.0-or-later
"""The dynamic PLY of SuperSplat 4D, from which its `.sog4d` is made: INRIA's columns, motion_0..2, trbf_center and trbf_scale.

The law is that of sog4d.py: motion is a velocity, trbf_scale ln of the width, all in seconds.  How long the clip is, a comment says
("cfg_args: start=0 duration=5 fps=30"), or the cfg_args above the file; else it ends with the last centre.
It differs from Spacetime Gaussians in having three columns of motion and none of omega, and spherical harmonics as colours.
"""
import re
from pathlib import Path

import numpy as np

from ..model.appearance import SH
from ..model.gaussians import GaussianModel
from ..util.errors import FastGSError
from . import cfg_args, ply, sog4d
from .base import Format
from .ftgs import static_columns
from .mediastorm import MOTION, last_frame

BELL = ("trbf_center", "trbf_scale")
SAID = re.compile(r"\b(start|duration|fps)\s*[= ]\s*([0-9.eE+-]+)")
FPS = 30.0


class SuperSplatPly(Format):
    name = "SuperSplat 4D PLY"
    reads = (".ply",)

    def sniff(self, head: bytes, path: Path) -> bool:
        return head.startswith(b"ply") and is_dynamic(ply.read_header(path).names)

    def load(self, path: Path) -> GaussianModel:
        header = ply.read_header(path)
        degree, groups = static_columns(header, path)
        columns = ply.read_vertices(path, header, groups | {"velocity": MOTION, "bell": BELL})
        (centre, ln_width), velocity = columns.pop("bell").T, columns.pop("velocity")
        clip = _clip_of(header, path) or {"duration": last_frame(centre, FPS) / FPS}
        still = GaussianModel(**columns, appearance=SH(degree))
        width = np.maximum(np.exp(ln_width.astype(np.float64)), sog4d.NARROWEST)
        return sog4d.together([sog4d.Part(still, velocity, centre.astype(np.float64), width)], {"fps": FPS} | clip)


def is_dynamic(names: frozenset[str]) -> bool:
    """Whether columns are those of this format, and not of Spacetime Gaussians."""
    return names.issuperset((*MOTION, *BELL)) and names.isdisjoint(("motion_3", "omega_0"))


def _clip_of(header: ply.Header, path: Path) -> dict[str, float]:
    """The clip's begin, length and frame rate, as the file or the cfg_args above it states them."""
    comment = next((text for text in header.comments if text.startswith("cfg_args")), None)
    if comment is not None:
        try:
            return {name: float(value) for name, value in SAID.findall(comment)}
        except ValueError as error:
            raise FastGSError(f"its comment {comment[:80]!r} makes no sense; export it again.") from error
    found = cfg_args.beside(path)
    return {name: float(found[name]) for name in ("start", "duration", "fps") if type(found.get(name)) in (int, float)}

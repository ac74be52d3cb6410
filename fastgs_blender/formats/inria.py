# SPDX-License-Identifier: GPL-3.0-or-later
"""The PLY of INRIA's 3D Gaussian splatting: static Gaussians with spherical harmonics.

Columns, by name and in any order: x y z, f_dc_0..2, f_rest_* (all of red, then green, then blue), opacity (logit),
scale_0..2 (ln), rot_0..3 (w x y z); nx ny nz and others are ignored.  `comment SplatRenderMode: mip` (Brush) and
`comment antialiased 1` (Postshot) make the model antialiased; the blur stays 0.3, for the file does not say another.
A column filter_3D is fused into scales and opacities (mip_filter.py).

What some trainers write instead: red, green, blue for f_dc_* (nerfstudio's `--ply-color-mode rgb`), and scale_0 alone for round
Gaussians.
"""
import math
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ..model.appearance import SH, SH_C0, Changing
from ..model.gaussians import GaussianModel, Raster
from ..model.temporal import Always
from ..util.errors import LossWarning
from . import mip_filter, ply
from .base import Format, generator
from .description import comments, from_comments
from .foreign import GAUSSIAN, is_2dgs
from .static import plain_harmonics

KEYS = ("raster", "clip", "axes", "colour_space", "provenance", "surroundings")
"""What our comments add."""
POSITION, SCALE, ROTATION = ("x", "y", "z"), ("scale_0", "scale_1", "scale_2"), ("rot_0", "rot_1", "rot_2", "rot_3")
NORMAL = ("nx", "ny", "nz")
"""Written as zeros, since other tools expect them."""
DEGREES = {0: 0, 9: 1, 24: 2, 45: 3, 72: 4}
CONSTANT, PLAIN = ("f_dc_0", "f_dc_1", "f_dc_2"), ("red", "green", "blue")
"""The colour seen from everywhere: as coefficients, or as it is."""


def colour_columns(degree: int, each: int | None = None) -> list[str]:
    """The columns' names in the order of GaussianModel.features: by coefficient, then r, g, b.

    each  columns f_rest_* that the file has for a channel, where these are more than the degree has
    """
    rest = (degree + 1) ** 2 - 1
    return [*CONSTANT, *(f"f_rest_{c * (each or rest) + b}" for b in range(rest) for c in range(3))]


def harmonics(header: ply.Header, path: Path) -> tuple[int, list[str]]:
    """The degree of spherical harmonics that the columns f_rest_* fill, and colour_columns(); a LossWarning tells of others."""
    rest = sum(name.startswith("f_rest_") for name in header.names)
    each = rest // 3 if rest % 3 == 0 and header.names.issuperset(f"f_rest_{i}" for i in range(rest)) else 0
    degree = min(4, math.isqrt(each + 1) - 1)
    if rest not in DEGREES or (rest and not each):
        warnings.warn(LossWarning(f"{path}: its {rest} columns f_rest_* fit no degree of spherical harmonics (9, 24, 45 or 72 do); degree "
                                  f"{degree} is read."), stacklevel=4)
    return degree, colour_columns(degree, each)


class Inria(Format):
    """The PLY of static 3D Gaussian splatting."""

    name = "INRIA PLY"
    extensions = reads = (".ply",)
    antialiased = True
    keeps_cameras = True

    def sniff(self, head: bytes, path: Path) -> bool:
        if not head.startswith(b"ply"):
            return False
        header = ply.read_header(path)
        moves = any(name.startswith("motion_") for name in header.names)
        return header.names.issuperset(_needed(header)) and not moves and not is_2dgs(header)

    def load(self, path: Path) -> GaussianModel:
        header = ply.read_header(path)
        plain = not header.names.issuperset(CONSTANT)
        degree, colours = (0, PLAIN) if plain else harmonics(header, path)
        smoothed = {mip_filter.COLUMN: (mip_filter.COLUMN,)} if mip_filter.COLUMN in header.names else {}
        columns = ply.read_vertices(path, header, {
            "position": POSITION, "rotation": ROTATION, "scale": SCALE[:1] * 3 if _is_round(header) else SCALE, "opacity": "opacity",
            "features": colours, **smoothed})
        if plain:
            columns["features"] = _coefficients(header, columns["features"])
        raster = mip_filter.fused(columns, path) if smoothed else Raster(antialiased=says_antialiased(header))
        kinds = {"raster": raster} | from_comments(header.comments, KEYS)
        return GaussianModel(**columns, appearance=SH(degree), **kinds)

    def suits(self, model: GaussianModel) -> bool:
        still = model.basis.terms == 0 and model.rotation_basis.terms == 0
        return still and isinstance(model.temporal_kind, Always) and not isinstance(model.appearance, Changing)

    def fit(self, model: GaussianModel) -> tuple[GaussianModel, list[str]]:
        lost = comments(model, KEYS)[1]
        model, clauses = plain_harmonics(model, 4)
        return model, lost + clauses

    def write(self, model: GaussianModel, targets: list[Path]) -> None:
        mode = ["SplatRenderMode: mip"] if model.raster.antialiased else []
        columns = [
            (POSITION, model.position), (NORMAL, np.broadcast_to(np.float32(0), (len(model), 3))),
            *in_file_order(model), (("opacity",), model.opacity[:, None]), (SCALE, model.scale), (ROTATION, model.rotation)]
        ply.write(targets[-1], [f"Written by {generator()}", *mode, *comments(model, KEYS)[0]], columns)


def _is_round(header: ply.Header) -> bool:
    """Whether its Gaussians have one scale each."""
    return "scale_0" in header.names and header.names.isdisjoint(SCALE[1:])


def _needed(header: ply.Header) -> set[str]:
    """The columns without which such a file holds no Gaussians."""
    instead = set(SCALE[1:]) if _is_round(header) else set()
    return set(GAUSSIAN) - instead if header.names.issuperset(CONSTANT) else set(GAUSSIAN) - instead - set(CONSTANT) | set(PLAIN)


def _coefficients(header: ply.Header, colours: np.ndarray) -> np.ndarray:
    """Coefficients [N, 3] of colours as they are: floats 0..1, or integers up to their type's greatest."""
    code = next(p.code for p in header.vertex.properties if p.name == PLAIN[0])
    most = 1.0 if code[0] == "f" else float(np.iinfo(code).max)
    return (colours.astype(np.float64) / most - 0.5) / SH_C0


def says_antialiased(header: ply.Header) -> bool:
    """Whether a comment says that the model is antialiased (Mip-Splatting)."""
    said = {c.lower().replace(" ", "").replace(":", "") for c in header.comments}
    return not said.isdisjoint(("splatrendermodemip", "antialiased1"))


def in_file_order(model: GaussianModel) -> Iterator[tuple[Sequence[str], np.ndarray]]:
    """The colour columns, channel after channel."""
    yield ("f_dc_0", "f_dc_1", "f_dc_2"), model.features[:, :3]
    rest = model.appearance.width // 3 - 1
    for channel in range(3 if rest else 0):
        yield [f"f_rest_{channel * rest + b}" for b in range(rest)], model.features[:, 3 + channel::3]

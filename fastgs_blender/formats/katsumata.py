# SPDX-License-Identifier: GPL-3.0-or-later
"""The PLY of Katsumata's compact dynamic Gaussians (raven38/EfficientDynamic3DGaussian): positions as a Fourier series, and quaternions
that change at a constant rate.

Columns x000 y000 z000 (the constant), then for i = 0 .. L - 1 the factors of sin(2^i pi t) and cos(2^i pi t) as x001.., f_dc_*, f_rest_*,
opacity, scale_0..2, and rot_<row>_<component>.  Their program writes the table of quaternions row by row under names that count by
component: the columns, ordered by component and then by row, are read as that table.  A Gaussian's quaternion is unit(row 0) + t
unit(row 1), which is drawn as long as it is: the Gaussians are sheared, which no basis of time holds, so each moment is computed.
"""
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..model.appearance import SH
from ..model.gaussians import Clip, GaussianModel
from ..model.sequence import Computed, Source
from ..util.errors import FastGSError
from ..util.identity import status_of
from . import cfg_args, ellipsoids, ply
from .base import Loader, require_sound
from .inria import DEGREES, SCALE, colour_columns
from .sequences import SequenceFormat

CLIP = Clip(300, 30.0)
"""Of the captures that it was published with: the file does not say how long its own is."""
MOST_ROWS = 33
"""Of positions: the fastest of so many waves turns 32 768 times."""


class Katsumata(SequenceFormat):
    name = "compact dynamic Gaussians PLY (Katsumata)"
    reads = (".ply",)

    def sniff(self, head: bytes, path: Path) -> bool:
        return head.startswith(b"ply") and ply.read_header(path).names.issuperset(("x000", "y000", "z000", "rot_000_0"))

    def open(self, path: Path, load: Loader) -> Source:
        columns, degree = _read(path)
        n = len(columns["opacity"])
        place, turn = (columns[name].reshape(n, -1, width).astype(np.float64) for name, width in (("place", 3), ("turn", 4)))
        turn /= np.maximum(np.linalg.norm(turn, axis=2, keepdims=True), 1e-12)  # zeros stay
        still = GaussianModel(place[:, 0], turn[:, 0], columns["scale"], columns["opacity"], columns["features"],
                              appearance=SH(degree), clip=CLIP)
        rates, sizes = np.pi * 2.0 ** np.arange(place.shape[1] // 2), np.exp(columns["scale"].astype(np.float64))

        def compute(t: float) -> GaussianModel:
            waves = np.stack([np.sin(rates * t), np.cos(rates * t)], 1).ravel()
            scale, rotation = ellipsoids.of_raw_quaternions(turn[:, 0] + t * turn[:, 1:2].sum(1), sizes)
            return replace(still, position=place[:, 0] + np.einsum("k,nkd->nd", waves, place[:, 1:]), scale=scale, rotation=rotation)

        return Computed(CLIP, compute, lambda: status_of(str(path)), str(path))


def _read(path: Path) -> tuple[dict[str, np.ndarray], int]:
    """The columns, of places those that are used, all of them sound, and the degree of the spherical harmonics."""
    header = ply.read_header(path)
    rows = sum(name[:1] == "x" and name[1:].isdigit() for name in header.names)
    turns = sum(name.startswith("rot_") for name in header.names) // 4
    rest = sum(name.startswith("f_rest_") for name in header.names)
    if not 1 <= rows <= MOST_ROWS or turns < 1 or rest not in DEGREES:
        raise FastGSError(f"its {rows} rows of positions, {turns} of rotations and {rest} columns f_rest_* do not fit together; "
                          "export it again.")
    waves = int(cfg_args.number(cfg_args.beside(path), "approx_l", rows, 0, rows))
    groups = {"place": [f"{axis}{row:03}" for row in range(1 + 2 * min(waves, (rows - 1) // 2)) for axis in "xyz"],
              "turn": [f"rot_{row:03}_{component}" for component in range(4) for row in range(turns)],
              "features": colour_columns(DEGREES[rest]), "opacity": "opacity", "scale": SCALE}
    columns = ply.read_vertices(path, header, groups)
    require_sound(columns, path)
    return columns, DEGREES[rest]

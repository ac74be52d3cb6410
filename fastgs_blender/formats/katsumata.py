# SPDX-License-Identifier: GPL-3.0-or-later
"""The PLY of Katsumata's compact dynamic Gaussians (raven38/EfficientDynamic3DGaussian): positions as a Fourier series, turning at a
constant rate.

Columns x000 y000 z000 (the constant), then for i = 0 .. L - 1 the factors of sin(2^i pi t) and cos(2^i pi t) as x001.., f_dc_*, f_rest_*,
opacity, scale_0..2, and rot_<row>_<component>.  Their program writes the table of quaternions row by row under names that count by
component: the columns, ordered by component and then by row, are read as that table.  The rotation is row 0 + t row 1.
"""
from __future__ import annotations

import numpy as np

from ..model.appearance import SH
from ..model.gaussians import Clip, GaussianModel
from ..model.motion import Fourier, Polynomial
from ..util.errors import FastGSError
from . import cfg_args, ply
from .base import Format
from .inria import DEGREES, SCALE, colour_columns

CLIP = Clip(300, 30.0)
"""Of the captures that it was published with: the file does not say how long its own is."""
MOST = 4
"""L: 2^(L - 1) waves, of which those between powers of two are 0."""


class Katsumata(Format):
    """The format "compact dynamic Gaussians PLY (Katsumata)", as the head of this module describes it."""

    name = "compact dynamic Gaussians PLY (Katsumata)"
    reads = (".ply",)

    def sniff(self, head, path):
        return head.startswith(b"ply") and ply.read_header(path).names.issuperset(("x000", "y000", "z000", "rot_000_0"))

    def load(self, path):
        header = ply.read_header(path)
        rows = sum(name[:1] == "x" and name[1:].isdigit() for name in header.names)
        terms = (rows - 1) // 2
        file = cfg_args.find(path)
        said = cfg_args.read(file).get("approx_l") if file else None
        if isinstance(said, int) and 0 <= said <= terms:
            terms = said
        rest = sum(name.startswith("f_rest_") for name in header.names)
        turns = sum(name.startswith("rot_") for name in header.names) // 4
        places = [f"{axis}{row:03}" for row in range(1 + 2 * terms) for axis in "xyz"]
        names = [f"rot_{row:03}_{component}" for component in range(4) for row in range(turns)]
        if terms > MOST or rest not in DEGREES or turns < 1:
            raise FastGSError(f"its {rows} rows of positions, {turns} of rotations and {rest} columns f_rest_* do not fit together; "
                              "export it again.")
        groups = {"place": places, "turn": names, "features": colour_columns(DEGREES[rest]), "opacity": ("opacity",), "scale": SCALE}
        missing = [name for wanted in groups.values() for name in wanted if name not in header.names]
        if missing:
            raise FastGSError(f"its columns {', '.join(missing[:12])} are missing; export it again.")
        columns = ply.read_vertices(path, header, groups)
        n = len(columns["opacity"])
        place, turn = columns["place"].reshape(n, 1 + 2 * terms, 3), columns["turn"].reshape(n, turns, 4)
        moves = {}
        if terms:
            motion = np.zeros((n, 2**terms, 3), np.float32)
            for i in range(terms):
                motion[:, 2 * 2**i - 2:2 * 2**i] = place[:, 1 + 2 * i:3 + 2 * i]
            moves = {"motion": motion, "basis": Fourier(2 ** (terms - 1), 0.5)}
            if turns > 1:
                moves |= {"rotation_motion": turn[:, 1:2], "rotation_basis": Polynomial(1)}
        return GaussianModel(place[:, 0], turn[:, 0], columns["scale"], columns["opacity"][:, 0], columns["features"],
                             appearance=SH(DEGREES[rest]), clip=CLIP, **moves)

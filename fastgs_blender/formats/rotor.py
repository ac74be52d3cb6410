# SPDX-License-Identifier: GPL-3.0-or-later
"""Checkpoints of 4D-Rotor Gaussians (`step-*.ckpt` of weify627/4D-Rotor-Gaussians, a fork of nerfstudio).

pipeline has _model.gauss_params.<name>: xyz [N, 3], t [N, 1], scales_xyz [N, 3] and scales_t [N, 1] (ln), quats1 (s, b_xy, b_xz, b_yz),
quats2 (b_xw, b_yw, b_zw, p), features_dc, features_rest, opacities (logit).  The eight numbers make a matrix of space and time as they
are: its renderer never calls rotornorm(), so they need be no proper rotor and the matrix no rotation.  The Gaussian at one time is cut
out as in 4DGS, and left out where (T - t)^2 / (2 variance) is 16 or more.
"""
from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..model.appearance import SH
from ..model.gaussians import Clip, GaussianModel
from ..util.errors import FastGSError
from . import torch_zip
from .base import Format
from .realtime4dgs import FPS, capture_of, check_shapes, coefficients, conditional, numbers_of
from .straight import Timeline, straight

PREFIX = "_model.gauss_params."
NAMES = ("xyz", "t", "scales_xyz", "scales_t", "quats1", "quats2", "features_dc", "features_rest", "opacities")
REACH = 16.0
DEGREES = {0: 0, 3: 1, 8: 2, 15: 3}


class RotorGaussians(Format):
    """The format "4D-Rotor Gaussians checkpoint", as the head of this module describes it."""

    name = "4D-Rotor Gaussians checkpoint"
    reads = (".ckpt",)

    def sniff(self, head: bytes, path: Path) -> bool:
        return _parameters(torch_zip.content_or_none(head, path)) is not None

    def load(self, path: Path) -> GaussianModel:
        found = _parameters(torch_zip.TorchFile(path).content)
        if found is None:
            raise FastGSError("it is no checkpoint of 4D-Rotor Gaussians; save it again.")
        arrays = {name: numbers_of(found[name]) for name in NAMES}
        n = len(arrays["xyz"])
        widths = {"xyz": 3, "t": 1, "scales_xyz": 3, "scales_t": 1, "quats1": 4, "quats2": 4, "opacities": 1}
        check_shapes({name: (arrays[name], (n, width)) for name, width in widths.items()})
        rest = arrays["features_rest"].shape[1] if arrays["features_rest"].ndim == 3 else -1
        if rest not in DEGREES:
            raise FastGSError(f"its spherical harmonics have the shape {arrays['features_rest'].shape}, which fits no degree.")
        features = coefficients((arrays["features_dc"].reshape(-1, 1, 3), arrays["features_rest"]), n, rest + 1)
        begin, end = capture_of({}, arrays["t"])
        frames = max(1, round((end - begin) * FPS)) if end - begin > 1 else 300
        with np.errstate(all="ignore"):  # what is no number is found by usable()
            velocity, variance, scale, rotation = conditional(arrays["scales_xyz"], arrays["scales_t"], turns, arrays["quats1"],
                                                              arrays["quats2"])
            time = arrays["t"][:, 0].astype(np.float64)
            reach = np.sqrt(2 * REACH * variance)
            lives = straight(arrays["xyz"], velocity, time, 0.5 * np.log(variance), Timeline(begin, end - begin),
                             (time - reach, time + reach))
        return GaussianModel(**lives, rotation=rotation, scale=scale, opacity=arrays["opacities"][:, 0], features=features,
                             appearance=SH(DEGREES[rest]), clip=Clip(frames, FPS))


def turns(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Matrices [N, 4, 4] of space and time by (s, xy, xz, yz) [N, 4] and (xw, yw, zw, p) [N, 4]; those of proper rotors are rotations."""
    s, a, b, c = first.astype(np.float64).T
    d, e, f, p = second.astype(np.float64).T
    ss, aa, bb, cc, dd, ee, ff, pp = (v**2 for v in (s, a, b, c, d, e, f, p))
    rows = [
        [ss + cc + ee + ff - aa - bb - dd - pp, 2 * (s * a - b * c - d * e + f * p), 2 * (a * c + s * b - d * f - e * p),
         2 * (a * e + b * f + s * d + c * p)],
        [-2 * (s * a + b * c + d * e + f * p), ss + bb + dd + ff - aa - cc - ee - pp, 2 * (-a * b + d * p + s * c - e * f),
         2 * (-a * d - b * p + c * f + s * e)],
        [2 * (a * c - s * b - d * f + e * p), -2 * (a * b + d * p + e * f + s * c), ss + aa + dd + ee - bb - cc - ff - pp,
         2 * (a * p - b * d - c * e + s * f)],
        [2 * (a * e + b * f - s * d - c * p), 2 * (-a * d + b * p + c * f - s * e), -2 * (a * p + b * d + c * e + s * f),
         ss + aa + bb + cc - dd - ee - ff - pp],
    ]
    return np.array(rows).transpose(2, 0, 1)


def _parameters(content: Any) -> dict | None:
    """The table of tensors of a checkpoint, or None."""
    found = torch_zip.of_pipeline(content, PREFIX)
    return found if found.keys() >= set(NAMES) else None

# SPDX-License-Identifier: GPL-3.0-or-later
"""Checkpoints of 4D-Rotor Gaussians (`step-*.ckpt` of weify627/4D-Rotor-Gaussians, a fork of nerfstudio).

pipeline has _model.gauss_params.<name>: xyz [N, 3], t [N, 1], scales_xyz [N, 3] and scales_t [N, 1] (ln), quats1 (s, b_xy, b_xz, b_yz),
quats2 (b_xw, b_yw, b_zw, p), features_dc, features_rest, opacities (logit).  The eight numbers make a matrix of space and time as they
are: its renderer never calls rotornorm(), so they need be no proper rotor and the matrix no rotation.  The Gaussian at one time is cut
out as in 4DGS, and left out where (T - t)^2 / (2 variance) is 16 or more.
"""
from pathlib import Path
from typing import Any

import numpy as np

from ..model.appearance import SH
from ..model.gaussians import Clip, GaussianModel
from . import torch_zip
from .base import Format
from .realtime4dgs import FPS, conditional
from .straight import Timeline, straight
from .trained import first_and_last, harmonics, rows

PREFIX = "_model.gauss_params."
NAMES = ("xyz", "t", "scales_xyz", "scales_t", "quats1", "quats2", "features_dc", "features_rest", "opacities")
REACH = 16.0


class RotorGaussians(Format):
    name = "4D-Rotor Gaussians checkpoint"
    reads = (".ckpt",)

    def sniff(self, head: bytes, path: Path) -> bool:
        return bool(_parameters(torch_zip.content_or_none(head, path)))

    def load(self, path: Path) -> GaussianModel:
        found = _parameters(torch_zip.TorchFile(path).content)
        arrays = rows(found, {"xyz": (3,), "t": (), "scales_xyz": (3,), "scales_t": (), "quats1": (4,), "quats2": (4,), "opacities": ()})
        features, degree = harmonics(found["features_dc"], found["features_rest"], len(arrays["xyz"]))
        begin, end = first_and_last({}, arrays["t"])
        frames = max(1, round((end - begin) * FPS)) if end - begin > 1 else 300
        with np.errstate(all="ignore"):  # what is no number is found by usable()
            velocity, variance, scale, rotation = conditional(arrays["scales_xyz"], arrays["scales_t"], turns, arrays["quats1"],
                                                              arrays["quats2"])
            time = arrays["t"].astype(np.float64)
            reach = np.sqrt(2 * REACH * variance)
            lives = straight(arrays["xyz"], velocity, time, 0.5 * np.log(variance), Timeline(begin, end - begin),
                             (time - reach, time + reach))
        return GaussianModel(**lives, rotation=rotation, scale=scale, opacity=arrays["opacities"], features=features,
                             appearance=SH(degree), clip=Clip(frames, FPS))


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


def _parameters(content: Any) -> dict[str, torch_zip.Tensor]:
    """The table of tensors of a checkpoint; an empty one for anything else."""
    found = torch_zip.of_pipeline(content, PREFIX)
    return found if found.keys() >= set(NAMES) else {}

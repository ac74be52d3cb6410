# SPDX-License-Identifier: GPL-3.0-or-later
"""Checkpoints of 4DGS real-time (`chkpnt<N>.pth` of fudan-zvg) and of Hybrid 3D-4DGS, which adds a static set.

A file holds (tuple, iteration).  The tuple of 4D Gaussians: degree of spherical harmonics, xyz, features_dc, features_rest, scaling (ln),
rotation, opacity (logit), 5 of training, spatial scale, t, scaling_t (ln), rotation_r, rot_4d, environment map, temporal degree; the
hybrid's then the static xyz, features_dc, features_rest, scaling, rotation, opacity, and 3 of training.  A tuple of 12 is plain 3DGS.

With rot_4d, two quaternions make a rotation of space and time: the Gaussian at one time travels straight and keeps its covariance.
It is left out where its factor exp(-(T - t)^2 / (2 var)) is 0.05 or less.  Spherical harmonics 16.. and 32.. are multiplied by cosines
of (T - t) over the length of the capture.  The cfg_args beside the file say this length (time_duration, else it is 1 or 10 seconds, as
times say), frame_ratio, by which time is divided, prefilter_var, which is added to var alone, and the hybrid's opa_threshold, which is
the 0.05 of models without rot_4d.
"""
import math
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..model.appearance import SH, Changing
from ..model.gaussians import Clip, GaussianModel
from ..model.motion import Fourier
from ..util import rotations
from ..util.arguments import shown
from ..util.errors import FastGSError, LossWarning
from . import cfg_args, ellipsoids, torch_zip
from .base import Format
from .straight import Timeline, straight
from .trained import first_and_last, harmonics, rows

CUTOFF = 0.05
FPS = 30.0
STATIC_TUPLE, TUPLE, HYBRID = 12, 19, 28
CHUNK = 1 << 16


class Realtime4DGS(Format):
    name = "4DGS checkpoint"
    reads = (".pth",)

    def sniff(self, head: bytes, path: Path) -> bool:
        content = torch_zip.content_or_none(head, path)
        return (isinstance(content, tuple) and len(content) == 2 and isinstance(content[0], tuple)
                and len(content[0]) in (STATIC_TUPLE, TUPLE, HYBRID) and all(isinstance(v, torch_zip.Tensor) for v in content[0][1:7]))

    def load(self, path: Path) -> GaussianModel:
        values = torch_zip.TorchFile(path).content[0]
        degree = _degree(values[0], 3, "degree")
        if len(values) == STATIC_TUPLE:
            return GaussianModel(**_still(values[1:7], (degree + 1) ** 2), appearance=SH(degree))
        degree_t = _degree(values[18], 2, "temporal degree")
        degree_t = degree_t if degree == 3 else 0  # their kernel looks at it inside of the third band
        arrays = _still(values[1:7], (degree_t + 1) * (degree + 1) ** 2)
        moving = rows({"scaling": values[4], "t": values[13], "scaling_t": values[14], "rotation_r": values[15]},
                      {"scaling": (3,), "t": (), "scaling_t": ()} | ({"rotation_r": (4,)} if values[16] else {}))
        if isinstance(values[17], torch_zip.Tensor) and 0 not in values[17].shape:
            warnings.warn(LossWarning(f"{path}: its environment map, the background, is left out."), stacklevel=3)
        said = cfg_args.beside(path)
        begin, end = first_and_last(said, moving["t"])
        unit = max(1.0, cfg_args.number(said, "frame_ratio", 1, 0, 1e6))
        duration, frames = (end - begin) / unit, max(1, round((end - begin) * FPS))
        cutoff, time = CUTOFF, moving["t"].astype(np.float64)
        with np.errstate(all="ignore"):  # what is no number is found by usable()
            if values[16]:
                velocity, variance, arrays["scale"], arrays["rotation"] = conditional(
                    arrays["scale"], moving["scaling_t"], _turns, arrays["rotation"], moving["rotation_r"])
            else:
                velocity, variance = np.zeros((len(time), 3)), np.exp(moving["scaling_t"].astype(np.float64))
                cutoff = cfg_args.number(said, "opa_threshold", CUTOFF, 1e-30, 1)
            variance = variance + max(0.0, cfg_args.number(said, "prefilter_var", 0, -1e6, 1e6))
            reach = np.sqrt(-2 * math.log(cutoff) * variance)
            arrays |= straight(arrays["position"], velocity, time, 0.5 * np.log(variance), Timeline(begin / unit, duration),
                               (time - reach, time + reach))
        appearance: SH | Changing = SH(degree)
        if degree_t:
            features, angle = arrays["features"], 2 * np.pi * time / duration
            parts = [features[:, :48]]
            for k in range(1, degree_t + 1):
                own = features[:, 48 * k:48 * k + 48]
                parts += [np.sin(k * angle)[:, None] * own, np.cos(k * angle)[:, None] * own]
            arrays["features"] = np.concatenate(parts, 1)
            appearance = Changing(SH(3), Fourier(degree_t, 1.0, begin / (end - begin)))
        if len(values) == HYBRID and isinstance(values[19], torch_zip.Tensor) and 0 not in values[19].shape:
            rest = _still(values[19:25], (degree + 1) ** 2)
            n = len(rest["opacity"])
            rest |= straight(rest["position"], np.zeros((n, 3)), np.zeros(n), np.full(n, np.inf), window=(-np.inf, np.inf))
            rest["features"] = np.pad(rest["features"], ((0, 0), (0, appearance.width - rest["features"].shape[1])))
            arrays = {key: np.concatenate([value, rest[key]]) if isinstance(value, np.ndarray) else value for key, value in arrays.items()}
        return GaussianModel(**arrays, appearance=appearance, clip=Clip(frames, frames / (end - begin)))


def _degree(value: Any, most: int, what: str) -> int:
    if type(value) is not int or not 0 <= value <= most:
        raise FastGSError(f"its {what} of spherical harmonics cannot be {shown(value)}.")
    return value


def _still(values: Sequence[Any], count: int) -> dict[str, Any]:
    """The arrays of a set of Gaussians as the tuple has them, with so many coefficients of colour."""
    table = dict(zip(("position", "base", "rest", "scale", "rotation", "opacity"), values, strict=True))
    arrays = rows(table, {"position": (3,), "scale": (3,), "rotation": (4,), "opacity": ()})
    return arrays | {"features": harmonics(table["base"], table["rest"], len(arrays["position"]), count)[0]}


def _turns(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Rotations of space and time [N, 4, 4] by two quaternions."""
    (a, b, c, d), (p, q, r, s) = (rotations.unit(v.astype(np.float64)).T for v in (left, right))
    l_matrix = np.array([[a, -b, -c, -d], [b, a, -d, c], [c, d, a, -b], [d, -c, b, a]])
    r_matrix = np.array([[p, q, r, s], [-q, p, -s, r], [-r, s, p, -q], [-s, -r, q, p]])
    return np.einsum("ijn,jkn->nik", l_matrix, r_matrix)[:, ::-1, ::-1]


def conditional(ln_scale: np.ndarray, ln_scale_t: np.ndarray, turns: Callable[..., np.ndarray], *parts: np.ndarray
                ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Velocity [N, 3], temporal variance [N], ln scale [N, 3] and rotation [N, 4] of 4D Gaussians cut at one time.

    turns(*parts), of some rows of parts [N, 4], gives their matrices of space and time [n, 4, 4], time last.
    """
    n = len(ln_scale)
    velocity, variance, scale, rotation = np.empty((n, 3)), np.empty(n), np.empty((n, 3), np.float32), np.empty((n, 4), np.float32)
    for start in range(0, n, CHUNK):
        part = slice(start, start + CHUNK)
        sizes = np.exp(np.concatenate([ln_scale[part], ln_scale_t[part, None]], 1).astype(np.float64))
        space, time = np.split(turns(*(each[part] for each in parts)) * sizes[:, None], [3], axis=1)
        variance[part] = (time**2).sum((1, 2))
        velocity[part] = (space @ time.transpose(0, 2, 1))[:, :, 0] / variance[part, None]
        cut = space - velocity[part][:, :, None] * time
        scale[part], rotation[part] = ellipsoids.principal(cut, np.broadcast_to(np.eye(3), (len(cut), 3, 3)))
    return velocity, variance, scale, rotation

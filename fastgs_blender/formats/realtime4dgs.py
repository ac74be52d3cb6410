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
from __future__ import annotations

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

CUTOFF = 0.05
FPS = 30.0
STATIC_TUPLE, TUPLE, HYBRID = 12, 19, 28
CHUNK = 1 << 16


class Realtime4DGS(Format):
    """The format "4DGS checkpoint", as the head of this module describes it."""

    name = "4DGS checkpoint"
    reads = (".pth",)

    def sniff(self, head: bytes, path: Path) -> bool:
        content = torch_zip.content_or_none(head, path)
        return (isinstance(content, tuple) and len(content) == 2 and isinstance(content[0], tuple)
                and len(content[0]) in (STATIC_TUPLE, TUPLE, HYBRID) and all(isinstance(v, torch_zip.Tensor) for v in content[0][1:7]))

    def load(self, path: Path) -> GaussianModel:
        values = torch_zip.TorchFile(path).content[0]
        degree = values[0]
        if type(degree) is not int or not 0 <= degree <= 3:
            raise FastGSError(f"its degree of spherical harmonics cannot be {shown(degree)}.")
        position, *looks, scale, rotation, opacity = (numbers_of(v) for v in values[1:7])
        n = len(position)
        shapes = {"xyz": (position, (n, 3)), "scaling": (scale, (n, 3)), "rotation": (rotation, (n, 4)), "opacity": (opacity, (n, 1))}
        check_shapes(shapes)
        if len(values) == STATIC_TUPLE:
            return GaussianModel(position, rotation, scale, opacity[:, 0], coefficients(looks, n, (degree + 1) ** 2), appearance=SH(degree))
        t, scale_t = numbers_of(values[13]), numbers_of(values[14])
        check_shapes({"t": (t, (n, 1)), "scaling_t": (scale_t, (n, 1))})
        degree_t = values[18]
        if type(degree_t) is not int or not 0 <= degree_t <= 2:
            raise FastGSError(f"its temporal degree of spherical harmonics cannot be {shown(degree_t)}.")
        degree_t = degree_t if degree == 3 else 0  # their kernel looks at it inside of the third band
        if isinstance(values[17], torch_zip.Tensor) and 0 not in values[17].shape:
            warnings.warn(LossWarning(f"{path}: its environment map, the background, is left out."), stacklevel=3)
        said = cfg_args.beside(path)
        begin, end = capture_of(said, t)
        unit = max(1.0, cfg_args.number(said, "frame_ratio", 1, 0, 1e6))
        duration, frames = (end - begin) / unit, max(1, round((end - begin) * FPS))
        cutoff = CUTOFF
        with np.errstate(all="ignore"):  # what is no number is found by usable()
            if values[16]:
                rotation_r = numbers_of(values[15])
                check_shapes({"rotation_r": (rotation_r, (n, 4))})
                velocity, variance, scale, rotation = conditional(scale, scale_t, _turns, rotation, rotation_r)
            else:
                velocity, variance = np.zeros((n, 3)), np.exp(scale_t[:, 0].astype(np.float64))
                cutoff = cfg_args.number(said, "opa_threshold", CUTOFF, 1e-30, 1)
            variance = variance + max(0.0, cfg_args.number(said, "prefilter_var", 0, -1e6, 1e6))
            reach = np.sqrt(-2 * math.log(cutoff) * variance)
            time = t[:, 0].astype(np.float64)
            lives = straight(position, velocity, time, 0.5 * np.log(variance), Timeline(begin / unit, duration),
                             (time - reach, time + reach))
        look: SH | Changing = SH(degree)
        features = coefficients(looks, n, (degree_t + 1) * (degree + 1) ** 2)
        if degree_t:
            basis = Fourier(degree_t, 1.0, begin / (end - begin))
            angle = 2 * np.pi * time / duration
            parts = [features[:, :48]]
            for k in range(1, degree_t + 1):
                own = features[:, 48 * k:48 * k + 48]
                parts += [np.sin(k * angle)[:, None] * own, np.cos(k * angle)[:, None] * own]
            features, look = np.concatenate(parts, 1), Changing(SH(3), basis)
        arrays = lives | {"rotation": rotation, "scale": scale, "opacity": opacity[:, 0], "features": features}
        if len(values) == HYBRID and isinstance(values[19], torch_zip.Tensor) and 0 not in values[19].shape:
            arrays = _with_static(arrays, values[19:25], look)
        return GaussianModel(**arrays, appearance=look, clip=Clip(frames, frames / (end - begin)))


def _with_static(arrays: dict, values: tuple, look: SH | Changing) -> dict:
    """The arrays, joined by a set that does not change."""
    position, *looks, scale, rotation, opacity = (numbers_of(v) for v in values)
    n = len(position)
    check_shapes({"static_xyz": (position, (n, 3)), "static_scaling": (scale, (n, 3)), "static_rotation": (rotation, (n, 4)),
            "static_opacity": (opacity, (n, 1))})
    own = look.look if isinstance(look, Changing) else look
    features = np.zeros((n, look.width), np.float32)
    features[:, :own.width] = coefficients(looks, n, own.width // 3)
    rest = straight(position, np.zeros((n, 3)), np.zeros(n), np.full(n, np.inf), window=(-np.inf, np.inf))
    rest |= {"rotation": rotation, "scale": scale, "opacity": opacity[:, 0], "features": features}
    return {key: np.concatenate([value, rest[key]]) if isinstance(value, np.ndarray) else value for key, value in arrays.items()}


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
        rows = slice(start, start + CHUNK)
        sizes = np.exp(np.concatenate([ln_scale[rows], ln_scale_t[rows]], 1).astype(np.float64))
        space, time = np.split(turns(*(part[rows] for part in parts)) * sizes[:, None], [3], axis=1)
        variance[rows] = (time**2).sum((1, 2))
        velocity[rows] = (space @ time.transpose(0, 2, 1))[:, :, 0] / variance[rows, None]
        cut = space - velocity[rows][:, :, None] * time
        scale[rows], rotation[rows] = ellipsoids.principal(cut, np.broadcast_to(np.eye(3), (len(cut), 3, 3)))
    return velocity, variance, scale, rotation


def capture_of(said: dict, t: np.ndarray) -> tuple[float, float]:
    """First and last second of the capture."""
    span = said.get("time_duration")
    if isinstance(span, list) and len(span) == 2 and all(isinstance(v, (int, float)) and abs(v) < 1e6 for v in span) and span[1] > span[0]:
        return float(span[0]), float(span[1])
    known = np.sort(t[np.isfinite(t)])
    return (0.0, 1.0) if not len(known) or known[int(0.99 * (len(known) - 1))] <= 1.1 else (0.0, 10.0)


def coefficients(looks: Sequence[np.ndarray], n: int, count: int) -> np.ndarray:
    """Features [N, 3 count] of features_dc [N, 1, 3] and features_rest [N, M - 1, 3]; raises FastGSError."""
    dc, rest = looks
    if dc.shape != (n, 1, 3) or rest.ndim != 3 or rest.shape[::2] != (n, 3) or rest.shape[1] + 1 < count:
        raise FastGSError(f"its spherical harmonics have the shapes {dc.shape} and {rest.shape}, which do not fit {n} Gaussians.")
    return np.concatenate([dc, rest], 1)[:, :count].reshape(n, 3 * count)


def check_shapes(shapes: dict[str, tuple[np.ndarray, tuple[int, ...]]]) -> None:
    for name, (array, shape) in shapes.items():
        if array.shape != shape:
            raise FastGSError(f"its {name} has the shape {array.shape}, not {shape}; save the checkpoint again.")


def numbers_of(tensor: Any) -> np.ndarray:
    if not isinstance(tensor, torch_zip.Tensor):
        raise FastGSError("something in it that should be numbers is none; save the checkpoint again.")
    with np.errstate(over="ignore", invalid="ignore"):
        return tensor.read().astype(np.float32)



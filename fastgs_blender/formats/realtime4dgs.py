# SPDX-License-Identifier: GPL-3.0-or-later
"""Checkpoints of 4DGS real-time (`chkpnt<N>.pth` of fudan-zvg) and of Hybrid 3D-4DGS, which adds a static set.

A file holds (tuple, iteration).  The tuple of 4D Gaussians: degree of spherical harmonics, xyz, features_dc, features_rest, scaling (ln),
rotation, opacity (logit), 5 of training, spatial scale, t, scaling_t (ln), rotation_r, rot_4d, environment map, temporal degree; the
hybrid's then the static xyz, features_dc, features_rest, scaling, rotation, opacity, and 3 of training.  A tuple of 12 is plain 3DGS.

With rot_4d, two quaternions make a rotation of space and time: the Gaussian at one time travels straight and keeps its covariance.
It is left out where its factor exp(-(T - t)^2 / (2 var)) is 0.05 or less.  Spherical harmonics 16.. and 32.. are multiplied by cosines
of (T - t) over the length of the capture, which the cfg_args beside the file tell; else it is 1 or 10 seconds, as times say.
"""
from __future__ import annotations

import math
import warnings
from pathlib import Path

import numpy as np

from ..model.appearance import SH, Changing
from ..model.gaussians import Clip, GaussianModel
from ..model.motion import Fourier
from ..util import rotations
from ..util.arguments import shown
from ..util.errors import FastGSError, LossWarning
from . import cfg_args, torch_zip
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

    def sniff(self, head, path):
        content = torch_zip.content_or_none(head, path)
        return (isinstance(content, tuple) and len(content) == 2 and isinstance(content[0], tuple)
                and len(content[0]) in (STATIC_TUPLE, TUPLE, HYBRID) and all(isinstance(v, torch_zip.Tensor) for v in content[0][1:7]))

    def load(self, path):
        values = torch_zip.TorchFile(path).content[0]
        degree = values[0]
        if type(degree) is not int or not 0 <= degree <= 3:
            raise FastGSError(f"its degree of spherical harmonics cannot be {shown(degree)}.")
        position, *looks, scale, rotation, opacity = (numbers_of(v) for v in values[1:7])
        n = len(position)
        shapes = {"xyz": (position, (n, 3)), "scaling": (scale, (n, 3)), "rotation": (rotation, (n, 4)), "opacity": (opacity, (n, 1))}
        check_shapes(shapes)
        if len(values) == STATIC_TUPLE:
            features = coefficients(looks, n, 16)[:, :3 * (degree + 1) ** 2]
            return GaussianModel(position, rotation, scale, opacity[:, 0], features, appearance=SH(degree))
        t, scale_t = numbers_of(values[13]), numbers_of(values[14])
        check_shapes({"t": (t, (n, 1)), "scaling_t": (scale_t, (n, 1))})
        degree_t = values[18]
        if type(degree_t) is not int or not 0 <= degree_t <= 2 or (degree_t and degree != 3):
            raise FastGSError(f"its temporal degree of spherical harmonics cannot be {shown(degree_t)} with degree {degree}.")
        if isinstance(values[17], torch_zip.Tensor) and 0 not in values[17].shape:
            warnings.warn(LossWarning(f"{path}: its environment map, the background, is left out."), stacklevel=3)
        begin, end = capture_of(path, t)
        timeline, frames = Timeline(begin, end - begin), max(1, round((end - begin) * FPS))
        with np.errstate(all="ignore"):  # what is no number is found by usable()
            if values[16]:
                rotation_r = numbers_of(values[15])
                check_shapes({"rotation_r": (rotation_r, (n, 4))})
                velocity, variance, scale, rotation = conditional(scale, scale_t, _turns, rotation, rotation_r)
            else:
                velocity, variance = np.zeros((n, 3)), np.exp(scale_t[:, 0].astype(np.float64))
            reach = np.sqrt(-2 * math.log(CUTOFF) * variance)
            time = t[:, 0].astype(np.float64)
            lives = straight(position, velocity, time, 0.5 * np.log(variance), timeline, (time - reach, time + reach))
        bands = coefficients(looks, n, 16 * (degree_t + 1))
        features, look = bands[:, :3 * (degree + 1) ** 2], SH(degree)
        if degree_t:
            basis = Fourier(degree_t, 1.0, begin / (end - begin))
            angle = 2 * np.pi * time / (end - begin)
            parts = [bands[:, :48]]
            for k in range(1, degree_t + 1):
                own = bands[:, 48 * k:48 * k + 48]
                parts += [np.sin(k * angle)[:, None] * own, np.cos(k * angle)[:, None] * own]
            features, look = np.concatenate(parts, 1), Changing(SH(3), basis)
        arrays = lives | {"rotation": rotation, "scale": scale, "opacity": opacity[:, 0], "features": features}
        if len(values) == HYBRID:
            arrays = _with_static(arrays, values[19:25], look)
        return GaussianModel(**arrays, appearance=look, clip=Clip(frames, frames / (end - begin)))


def _with_static(arrays: dict, values, look) -> dict:
    """The arrays, joined by a set that does not change."""
    position, *looks, scale, rotation, opacity = (numbers_of(v) for v in values)
    n = len(position)
    check_shapes({"static_xyz": (position, (n, 3)), "static_scaling": (scale, (n, 3)), "static_rotation": (rotation, (n, 4)),
            "static_opacity": (opacity, (n, 1))})
    own = look.look if isinstance(look, Changing) else look
    features = np.zeros((n, look.width), np.float32)
    features[:, :own.width] = coefficients(looks, n, 16)[:, :own.width]
    rest = straight(position, np.zeros((n, 3)), np.zeros(n), np.full(n, np.inf), window=(-np.inf, np.inf))
    rest |= {"rotation": rotation, "scale": scale, "opacity": opacity[:, 0], "features": features}
    return {key: np.concatenate([value, rest[key]]) if isinstance(value, np.ndarray) else value for key, value in arrays.items()}


def _turns(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Rotations of space and time [N, 4, 4] by two quaternions."""
    (a, b, c, d), (p, q, r, s) = (rotations.unit(v.astype(np.float64)).T for v in (left, right))
    l_matrix = np.array([[a, -b, -c, -d], [b, a, -d, c], [c, d, a, -b], [d, -c, b, a]])
    r_matrix = np.array([[p, q, r, s], [-q, p, -s, r], [-r, s, p, -q], [-s, -r, q, p]])
    return np.einsum("ijn,jkn->nik", l_matrix, r_matrix)[:, ::-1, ::-1]


def conditional(ln_scale, ln_scale_t, turns, *parts):
    """Velocity [N, 3], temporal variance [N], ln scale [N, 3] and rotation [N, 4] of 4D Gaussians cut at one time.

    turns(*parts), of some rows of parts [N, 4], gives their rotations of space and time [n, 4, 4], time last.
    """
    n = len(ln_scale)
    velocity, variance, scale, rotation = np.empty((n, 3)), np.empty(n), np.empty((n, 3), np.float32), np.empty((n, 4), np.float32)
    for start in range(0, n, CHUNK):
        rows = slice(start, start + CHUNK)
        turn = turns(*(part[rows] for part in parts))
        spread = turn * np.exp(np.concatenate([ln_scale[rows], ln_scale_t[rows]], 1).astype(np.float64))[:, None]
        sigma = spread @ spread.transpose(0, 2, 1)
        variance[rows] = sigma[:, 3, 3]
        velocity[rows] = sigma[:, :3, 3] / sigma[:, 3, 3, None]
        covariance = sigma[:, :3, :3] - velocity[rows][:, :, None] * sigma[:, 3, None, :3]
        good = np.isfinite(covariance).all((1, 2))
        values, vectors = np.linalg.eigh(np.where(good[:, None, None], covariance, np.eye(3)))
        vectors[:, :, 0] *= np.sign(np.linalg.det(vectors))[:, None]
        scale[rows] = np.where(good[:, None], 0.5 * np.log(np.maximum(values, 0)), np.nan)
        rotation[rows] = rotations.from_matrices(vectors)
    return velocity, variance, scale, rotation


def capture_of(path: Path, t: np.ndarray) -> tuple[float, float]:
    """First and last second of the capture."""
    file = cfg_args.find(path)
    span = cfg_args.read(file).get("time_duration") if file else None
    if isinstance(span, list) and len(span) == 2 and all(isinstance(v, (int, float)) and abs(v) < 1e6 for v in span) and span[1] > span[0]:
        return float(span[0]), float(span[1])
    known = np.sort(t[np.isfinite(t)])
    return (0.0, 1.0) if not len(known) or known[int(0.99 * (len(known) - 1))] <= 1.1 else (0.0, 10.0)


def coefficients(looks, n: int, count: int) -> np.ndarray:
    """Features [N, 3 count] of features_dc [N, 1, 3] and features_rest [N, M - 1, 3]; raises FastGSError."""
    dc, rest = looks
    if dc.shape != (n, 1, 3) or rest.ndim != 3 or rest.shape[::2] != (n, 3) or rest.shape[1] + 1 < count:
        raise FastGSError(f"its spherical harmonics have the shapes {dc.shape} and {rest.shape}, which do not fit {n} Gaussians.")
    return np.concatenate([dc, rest], 1)[:, :count].reshape(n, 3 * count)


def check_shapes(shapes) -> None:
    for name, (array, shape) in shapes.items():
        if array.shape != shape:
            raise FastGSError(f"its {name} has the shape {array.shape}, not {shape}; save the checkpoint again.")


def numbers_of(tensor) -> np.ndarray:
    if not isinstance(tensor, torch_zip.Tensor):
        raise FastGSError("something in it that should be numbers is none; save the checkpoint again.")
    with np.errstate(over="ignore", invalid="ignore"):
        return tensor.read().astype(np.float32)



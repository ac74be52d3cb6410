# SPDX-License-Identifier: GPL-3.0-or-later
"""Ex4DGS (juno181): point_cloud.ply, Gaussians that drift, beside dynamic_point_cloud.ply, Gaussians with keyframes.

Time T is in frames, 0 .. duration, and s = T + time_pad (and one interval I more, where the interpolation looks two keys ahead).  A key k
lies at s = k I.  Places are interpolated linearly, by Catmull and Rom's cubic ("cube") or by a monotone one ("pchip"); rotations on the
great circle between two keys, whose quaternions keep their signs.  Quaternions of the drifting Gaussians are drawn as long as they are.
An opacity is whole between two centres c (in intervals) and falls off beyond like a bell of exp(v) + var_pad / (2.36 I) on either side;
before both centres the distance is that to the later one, as their program computes it.  What is not in the files, the cfg_args above
them say; `near` is the distance at which their rasteriser begins.
"""
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..model.appearance import SH
from ..model.gaussians import Clip, GaussianModel, Raster
from ..model.sequence import Computed, Source
from ..model.slicing import sigmoid
from ..util import rotations
from ..util.arguments import shown
from ..util.errors import FastGSError
from ..util.identity import status_of
from . import cfg_args, ellipsoids, ply
from .base import Loader, require_sound
from .inria import DEGREES, colour_columns
from .sequences import SequenceFormat
from .straight import logit

STATIC, DYNAMIC = "point_cloud.ply", "dynamic_point_cloud.ply"
FPS = 30.0
DRIFT = tuple(f"xyz_disp_{i}" for i in range(3))
MOST_KEYS = 4096


@dataclass(frozen=True, eq=False)
class Keyed:
    """Gaussians with keyframes: place [N, K, 3], turn [N, K, 4], centre [N, 2], spread [N, 2] (ln), and what does not change."""

    still: GaussianModel
    place: np.ndarray
    turn: np.ndarray
    centre: np.ndarray
    spread: np.ndarray


class Ex4DGS(SequenceFormat):
    name = "Ex4DGS"
    reads = (".ply",)

    def sniff(self, head: bytes, path: Path) -> bool:
        if not head.startswith(b"ply"):
            return False
        names = ply.read_header(path).names
        moving = {"motion_xyz_0_0", "motion_opacity_c_0"} <= names
        return moving or (names.issuperset(DRIFT) and path.with_name(DYNAMIC).is_file())

    def open(self, path: Path, load: Loader) -> Source:
        files = [path.with_name(STATIC), path.with_name(DYNAMIC)]
        said: dict[str, Any] = {"time_interval": 5, "time_pad": 3, "var_pad": 3, "kernel_size": 0.1, "near": 0.2, "interp_type": "cube",
                "rot_interp_type": "slerp"}
        said |= cfg_args.beside(path)
        duration = said.get("duration", -1)
        numbers = [said[key] for key in ("time_interval", "time_pad", "var_pad", "kernel_size", "near")]
        if not (isinstance(duration, int) and 1 <= duration <= 10**6
                and all(isinstance(v, (int, float)) and 0 <= v < 1e4 for v in numbers) and numbers[0] >= 1):
            raise FastGSError("the cfg_args that should lie above it, with the capture's duration and the keys' interval, are missing or "
                              "damaged; copy the whole folder of the model.")
        if not isinstance(said["interp_type"], str) or said["interp_type"] not in PLACES or said["rot_interp_type"] != "slerp":
            raise FastGSError(f"its interpolations {shown(said['interp_type'])} and {shown(said['rot_interp_type'])} are not supported; "
                              f"{', '.join(PLACES)} with 'slerp' are.")
        raster = Raster(blur=float(said["kernel_size"]), near=float(said["near"]), antialiased=True)
        drifting, drift = _drifting(files[0], raster)
        keyed = _keyed(files[1], raster)

        def compute(t: float) -> GaussianModel:
            time = t * duration
            with np.errstate(all="ignore"):
                still = replace(drifting, position=drifting.position + drift * np.float32(time / duration))
                moving = _at(keyed, time, said)
            return _joined(still, moving)

        return Computed(Clip(duration, FPS), compute, lambda: tuple(status_of(str(file)) for file in files), str(path))


def _drifting(path: Path, raster: Raster) -> tuple[GaussianModel, np.ndarray]:
    """The static Gaussians, and how far each drifts over the capture."""
    columns, degree = _read(path, "", {"position": ("x", "y", "z"), "rotation": tuple(f"rot_{i}" for i in range(4)), "drift": DRIFT})
    drift = columns.pop("drift")
    columns["scale"], columns["rotation"] = ellipsoids.of_raw_quaternions(columns["rotation"], np.exp(columns["scale"].astype(np.float64)))
    require_sound(columns, path)
    return _static(columns, degree, raster), drift


def _keyed(path: Path, raster: Raster) -> Keyed:
    """The Gaussians with keyframes."""
    names = ply.read_header(path).names
    keys = sum(name.startswith("motion_xyz_") for name in names) // 3
    if not 4 <= keys <= MOST_KEYS:
        raise FastGSError(f"{path}: it has {keys} keyframes, and from 4 to {MOST_KEYS} are read.")
    columns, degree = _read(path, "motion_", {
        "place": tuple(f"motion_xyz_{k}_{i}" for k in range(keys) for i in range(3)),
        "turn": tuple(f"motion_rot_{k}_{i}" for k in range(keys) for i in range(4)),
        "centre": ("motion_opacity_c_0", "motion_opacity_c_1"), "spread": ("motion_opacity_v_0", "motion_opacity_v_1")})
    n = len(columns["opacity"])
    place, turn = columns.pop("place").reshape(n, keys, 3), columns.pop("turn").reshape(n, keys, 4)
    centre, spread = columns.pop("centre"), columns.pop("spread")
    still = _static(columns | {"position": place[:, 0], "rotation": turn[:, 0]}, degree, raster)
    return Keyed(still, place, turn, centre, spread)


def _read(path: Path, prefix: str, more: dict) -> tuple[dict[str, np.ndarray], int]:
    """The columns of a PLY, all finite, and the degree of its spherical harmonics."""
    header = ply.read_header(path)
    rest = sum(name.startswith(f"{prefix}f_rest_") for name in header.names)
    groups = more | {"features": [prefix + name for name in colour_columns(DEGREES.get(rest, 0))], "opacity": (f"{prefix}opacity",),
                     "scale": tuple(f"{prefix}scale_{i}" for i in range(3))}
    missing = [name for names in groups.values() for name in names if name not in header.names]
    if rest not in DEGREES or missing:
        raise FastGSError(f"{path}: its columns {', '.join(missing[:8]) or 'f_rest_*'} are missing or fit no degree; export it again.")
    columns = ply.read_vertices(path, header, groups)
    require_sound(columns, path)
    return columns, DEGREES[rest]


def _static(columns: dict, degree: int, raster: Raster) -> GaussianModel:
    return GaussianModel(**columns | {"opacity": columns["opacity"].reshape(-1)}, appearance=SH(degree), raster=raster)


def _joined(one: GaussianModel, two: GaussianModel) -> GaussianModel:
    if one.appearance != two.appearance:
        raise FastGSError("its two files have spherical harmonics of different degrees; export them again.")
    return replace(one, **{name: np.concatenate([array, two.arrays[name]]) for name, array in one.arrays.items()})


def _at(keyed: Keyed, time: float, said: dict) -> GaussianModel:
    """The Gaussians with keyframes at a time in frames."""
    interval, wide = float(said["time_interval"]), said["interp_type"] != "linear"
    s = time + said["time_pad"] + (interval if wide else 0.0)
    k = int(np.clip(np.floor(s / interval), 1 if wide else 0, keyed.place.shape[1] - (3 if wide else 2)))
    u = s / interval - k
    place = PLACES[said["interp_type"]](*(keyed.place[:, k + j].astype(np.float64) for j in ((-1, 0, 1, 2) if wide else (0, 1))), u)
    x = s / interval - keyed.centre.astype(np.float64)
    nearest = x.min(1)
    ln = np.where((x > 0).any(1), keyed.spread[:, 1], keyed.spread[:, 0]).astype(np.float64)
    bell = np.exp(-((nearest / (np.exp(ln) + said["var_pad"] / interval / 2.36)) ** 2))
    shown = np.where(x[:, 0] * x[:, 1] < 0, 1.0, bell) * sigmoid(keyed.still.opacity)
    opacity = np.clip(logit(shown), -80, 30)
    return replace(keyed.still, position=place, rotation=_great_circle(keyed.turn[:, k], keyed.turn[:, k + 1], u), opacity=opacity)


def _great_circle(first: np.ndarray, second: np.ndarray, u: float) -> np.ndarray:
    a, b = rotations.unit(first.astype(np.float64)), rotations.unit(second.astype(np.float64))
    angle = np.maximum(np.arccos(np.clip(np.sum(a * b, 1, keepdims=True), -1 + 1e-4, 1 - 1e-4)), 1e-4)
    sine = np.maximum(np.sin(angle), 1e-4)
    p, q = np.sin((1 - u) * angle) / sine, np.sin(u * angle) / sine
    total = np.maximum(p + q, 1e-4)
    mixed = a * p / total + b * q / total
    return rotations.unit(np.where(np.abs(mixed).sum(1, keepdims=True) > 1e-4, mixed, a))


def _linear(b: np.ndarray, c: np.ndarray, u: float) -> np.ndarray:
    return b * (1 - u) + c * u


def _hermite(b: np.ndarray, c: np.ndarray, before: np.ndarray, after: np.ndarray, u: float) -> np.ndarray:
    return (2 * u**3 - 3 * u**2 + 1) * b + (u**3 - 2 * u**2 + u) * before + (3 * u**2 - 2 * u**3) * c + (u**3 - u**2) * after


def _cube(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, u: float) -> np.ndarray:
    return _hermite(b, c, (c - a) / 2, (d - b) / 2, u)


def _pchip(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, u: float) -> np.ndarray:
    def slope(left: np.ndarray, right: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            return np.where(left * right > 0, 2 * left * right / (left + right), 0)

    return _hermite(b, c, slope(b - a, c - b), slope(c - b, d - c), u)


PLACES: dict[str, Callable[..., np.ndarray]] = {"cube": _cube, "pchip": _pchip, "linear": _linear}

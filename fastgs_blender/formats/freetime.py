# SPDX-License-Identifier: GPL-3.0-or-later
"""Checkpoints of FreeTimeGS trainers: `ckpt_<step>.pt` and `canonical_4d.npz` (FreeTimeGsVanilla), `.npz` (FreeTimeGS++).

The arrays: means [N, 3], scales (ln) [N, 3], quats (w x y z) [N, 4], opacities (logit) [N], sh0 [N, 1, 3], shN [N, K, 3], times [N, 1],
durations (ln of the standard deviation, at least 0.02) [N, 1], velocities [N, 3] per unit of normalised time (first frame 0, last 1).

FreeTimeGS++ says sh_0, sh_n, velocity_model, and adds marginal_gates.  Its time is in seconds of the film, which need not begin at 0.
Where it trains without gates, it sets them to -100, and durations are logarithms as above; with gates, which all of its configurations
give a max_duration of 1, the standard deviation is sigmoid(durations) / 6.  Its opacity factor is g + (1 - g) bell, g = sigmoid(20 gate).
A gate that is shut (g near 0) is the plain bell, an open one (g near 1) does not fade.  No model holds what lies between: a file with
such gates is computed for each time.
"""
import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..model.appearance import SH
from ..model.gaussians import Clip, GaussianModel
from ..model.motion import Static
from ..model.sequence import Computed, Source
from ..model.slicing import sigmoid, slice_model
from ..model.temporal import Always
from ..util.errors import FastGSError
from ..util.identity import status_of
from ..util.numpy_files import packed_arrays
from ..util.zip_files import members
from . import torch_zip
from .base import OPAQUE, Format, Loader, usable
from .ftgs import FRAMES, GSPLAT, MIN_DURATION, clip_of
from .mediastorm import LONGEST
from .straight import Timeline, logit, straight
from .trained import harmonics, numbers_of, rows

NAMES = {"means": ("means",), "scales": ("scales",), "quats": ("quats",), "opacities": ("opacities",), "sh0": ("sh0", "sh_0"),
         "shN": ("shN", "sh_n"), "times": ("times",), "durations": ("durations",), "velocities": ("velocities", "velocity_model")}
SHAPES = {"means": (3,), "scales": (3,), "quats": (4,), "opacities": (), "sh0": (3,), "times": (), "durations": (), "velocities": (3,)}
"""Of one Gaussian; the files differ in axes of length 1."""
FPS = 30.0
"""Frames per second of FreeTimeGS++'s films, which its file does not state."""
EARLY = 1.0
"""Seconds: times of FreeTimeGS++ that begin later than this are those of a part from a longer film."""
SHUT = 1e-5
"""A gate closer than this to 0 or 1 changes no opacity by more."""


class FreeTimeCheckpoint(Format):
    """A checkpoint that PyTorch saved."""

    name = "FreeTimeGS checkpoint"
    reads = (".pt",)

    def sniff(self, head: bytes, path: Path) -> bool:
        return _known(_splats(torch_zip.content_or_none(head, path)))

    def load(self, path: Path) -> GaussianModel:
        content = torch_zip.TorchFile(path).content
        spec = content.get("model_spec") if isinstance(content.get("model_spec"), dict) else {}
        said = {key: value for key, value in (content | spec).items() if isinstance(key, str)}
        strange = [key for key in ("color_correction", "use_marginal_gating", "use_color_velocity") if said.get(key)]
        strange += [key for key, usual in (("time_units", "normalized"), ("duration_activation", "exp")) if said.get(key, usual) != usual]
        if strange:
            raise FastGSError(f"it was trained with an extension that is not supported ({', '.join(strange)}); train it without.")
        return model_of(_splats(content), path, said.get("n_frames"), said.get("use_velocity", True) is not False)


class FreeTimeArrays(Format):
    """The same arrays in an .npz file."""

    name = "FreeTimeGS arrays"
    reads = (".npz",)

    def sniff(self, head: bytes, path: Path) -> bool:
        names = {name.removesuffix(".npy") for name in members(head, path) if name.endswith(".npy")}
        return _known(names)

    def open(self, path: Path, load: Loader) -> Source:
        table = packed_arrays(path)
        gate = _gates(table)
        if not _partly(gate):
            return load(path)
        fading = usable(self._read(table, path), path)
        if gate is None or len(fading) != len(gate):
            raise FastGSError("its gates do not fit its Gaussians, or some of its numbers are not finite; use an earlier checkpoint.")
        still = replace(fading, basis=Static(), motion=fading.motion[:, :0], temporal_kind=Always(), temporal=fading.temporal[:, :0],
                        mu_tau=np.zeros(len(fading)))
        whole = sigmoid(fading.opacity.astype(np.float64))

        def compute(t: float) -> GaussianModel:
            now = slice_model(fading, t, cull=False)
            return replace(still, position=now.position, opacity=np.clip(logit(gate * whole + (1 - gate) * now.opacity), -OPAQUE, OPAQUE))

        return Computed(fading.clip, compute, lambda: status_of(str(path)), str(path))

    def load(self, path: Path) -> GaussianModel:
        table = packed_arrays(path)
        if _partly(_gates(table)):
            raise FastGSError("some of its Gaussians fade only in part (marginal gates of FreeTimeGS++), which is computed for each time; "
                              "open it with open_source(), or turn it into one model with fastgs convert.")
        return self._read(table, path)

    def _read(self, arrays: Mapping, path: Path) -> GaussianModel:
        if any(name.startswith("velocity_model.") for name in arrays):
            raise FastGSError("its velocities come from a network of FreeTimeGS++ that is not supported; train with explicit velocities.")
        frames = arrays["n_frames"].read() if "n_frames" in arrays and not arrays["n_frames"].shape else None
        return model_of(arrays, path, None if frames is None else frames.item(), True)


def model_of(table: Mapping, path: Path, frames: object, moves: bool) -> GaussianModel:
    """The model of arrays that are known by shape and have read(); frames: of the clip, or None."""
    found = {key: next((table[name] for name in names if name in table), None) for key, names in NAMES.items()}
    arrays = rows(found, SHAPES)
    n = len(arrays["means"])
    features, degree = harmonics(arrays["sh0"], found["shN"], n)
    gate, durations = _gates(table), arrays["durations"].astype(np.float64)
    if "sh_0" in table:  # FreeTimeGS++
        timeline, clip = _film(arrays["times"])
        ln_sigma = -np.logaddexp(0, -durations) - math.log(6) if gate is not None and gate.any() else durations
    else:
        timeline, clip = Timeline(), clip_of(frames if isinstance(frames, int) and 1 <= frames <= 10_000_000 else FRAMES)
        ln_sigma = np.maximum(durations, math.log(MIN_DURATION))
    if gate is not None:
        if len(gate) != n:
            raise FastGSError("its array marginal_gates does not fit its Gaussians; save it again.")
        ln_sigma = np.where(gate > 1 - SHUT, np.inf, ln_sigma)
    lives = straight(arrays["means"], arrays["velocities"] if moves else None, arrays["times"], ln_sigma, timeline)
    return GaussianModel(**lives, rotation=arrays["quats"], scale=arrays["scales"], opacity=arrays["opacities"], features=features,
                         appearance=SH(degree), raster=GSPLAT, clip=clip)


def _film(times: np.ndarray) -> tuple[Timeline, Clip]:
    """The time line and the clip of FreeTimeGS++, which the file does not state: its Gaussians' times span the film."""
    known = times[np.isfinite(times) & (np.abs(times) <= LONGEST)]
    begin, end = np.quantile(known, (0.01, 0.99)).astype(float) if len(known) else (0.0, 1.0)
    begin = begin if begin > EARLY else 0.0
    frames = max(1, round((end - begin) * FPS))
    return Timeline(begin, frames / FPS), Clip(frames, FPS)


def _gates(table: Mapping) -> np.ndarray | None:
    """How far the gates are open [N], 0 to 1, or None; those of a model that was trained without gates are 0 exactly."""
    return sigmoid(20 * numbers_of(table["marginal_gates"]).reshape(-1)) if "marginal_gates" in table else None


def _partly(gate: np.ndarray | None) -> bool:
    """Whether some Gaussians fade only in part."""
    return gate is not None and bool(np.any((gate > SHUT) & (gate < 1 - SHUT)))


def _splats(content: object) -> dict:
    splats = content.get("splats") if isinstance(content, dict) else None
    if not isinstance(splats, dict):
        return {}
    return {key: value for key, value in splats.items() if isinstance(value, torch_zip.Tensor)}


def _known(names: Iterable[str]) -> bool:
    """Whether the names are those of FreeTimeGS, and not of a static model of gsplat."""
    return {"means", "quats", "times", "durations"} <= set(names)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Checkpoints of static Gaussians: gsplat's simple_trainer (`ckpts/ckpt_<step>_rank<r>.pt`), nerfstudio's splatfacto (`step-<step>.ckpt`).

gsplat saves {step, splats}.  splats: means (means3d before 1.0) [N, 3], scales (ln) [N, 3], quats (w x y z) [N, 4], opacities (logit)
[N], sh0 [N, 1, 3], shN [N, K, 3]; with app_opt, instead of the harmonics, features and colors (logit) [N, 3].  A training on several GPUs
leaves a file for each of them with a part of the Gaussians; these are read together.

nerfstudio saves {step, pipeline, ...}.  pipeline: _model.gauss_params.<name> (before 1.0 _model.<name>) for means, scales, quats,
features_dc [N, 3], features_rest [N, K, 3], opacities [N, 1].  Without features_rest, features_dc are logits of colours.  Its z points up.

Both draw with gsplat.  Whether antialiased, the training's settings tell: cfg.yml and config.yml in the folder above the checkpoint's.
"""
from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..model.appearance import SH, SH_C0
from ..model.gaussians import GaussianModel, Raster
from ..model.slicing import sigmoid
from ..util.errors import FastGSError, LossWarning, printable
from ..util.reading import open_file
from . import torch_zip
from .base import Format
from .ftgs import GSPLAT
from .realtime4dgs import check_shapes, numbers_of
from .scenes import together

DEGREES = {0: 0, 3: 1, 8: 2, 15: 3, 24: 4}
RANK = re.compile(r"(.*_rank)\d+(\.pt)", re.IGNORECASE)
PREFIXES = ("_model.gauss_params.", "_model.")
HARMONICS, COLOURS = {"sh0", "shN"}, {"features", "colors"}
"""Of gsplat, with and without app_opt."""
SHARED = {"means", "scales", "quats", "opacities"}
DC_AND_REST = {"features_dc", "features_rest"}
MAX_SETTINGS = 1 << 20
"""Bytes that are looked at."""


class GsplatCheckpoint(Format):
    """A checkpoint of gsplat's simple_trainer."""

    name = "gsplat checkpoint"
    reads = (".pt",)

    def sniff(self, head: bytes, path: Path) -> bool:
        return _splats(torch_zip.content_or_none(head, path)) is not None

    def load(self, path: Path) -> GaussianModel:
        parts = [path]
        if rank := RANK.fullmatch(path.name):
            parts = sorted(p for p in path.parent.iterdir() if (other := RANK.fullmatch(p.name)) and other.groups() == rank.groups())
        raster = replace(GSPLAT, antialiased=_says(path.parent.parent / "cfg.yml", "antialiased", "true"))
        return replace(together([_gsplat(part) for part in parts]), raster=raster)


class NerfstudioCheckpoint(Format):
    """A checkpoint of nerfstudio's splatfacto."""

    name = "nerfstudio checkpoint (splatfacto)"
    reads = (".ckpt",)

    def sniff(self, head: bytes, path: Path) -> bool:
        return _parameters(torch_zip.content_or_none(head, path)) is not None

    def load(self, path: Path) -> GaussianModel:
        found = _parameters(torch_zip.TorchFile(path).content)
        if found is None:
            raise FastGSError("it is no checkpoint of nerfstudio's splatfacto; save it again.")
        _tell_of(set(found) - SHARED - DC_AND_REST, path)
        base = numbers_of(found["features_dc"])
        rest = numbers_of(found["features_rest"])
        if rest.ndim == 3 and not rest.shape[1]:  # trained with sh_degree 0
            base = (sigmoid(base.astype(np.float64)) - 0.5) / SH_C0
        raster = replace(GSPLAT, antialiased=_says(path.parent.parent / "config.yml", "rasterize_mode", "antialiased"))
        return replace(_model(found, base[:, None], rest, raster), axes="RFU")


def _says(file: Path, key: str, value: str) -> bool:
    """Whether a line of a YAML file gives a key this value.  Trainers write one setting a line; objects of Python in it are not made."""
    if not file.is_file():
        return False
    with open_file(file) as stream:
        text = stream.read(MAX_SETTINGS).decode("utf-8", "replace")
    return re.search(rf"^\s*{key}:\s*['\"]?{value}['\"]?\s*$", text, re.MULTILINE) is not None


def _splats(content: Any) -> dict | None:
    """gsplat's table of tensors; None for anything else."""
    splats = content.get("splats") if isinstance(content, dict) else None
    if not isinstance(splats, dict) or not all(isinstance(v, torch_zip.Tensor) for v in splats.values()):
        return None
    table = {"means" if name == "means3d" else name: tensor for name, tensor in splats.items()}
    return table if table.keys() >= SHARED and (table.keys() >= HARMONICS or table.keys() >= COLOURS) else None


def _gsplat(path: Path) -> GaussianModel:
    splats = _splats(torch_zip.TorchFile(path).content)
    if splats is None:
        raise FastGSError(f"{path.name} is no checkpoint of gsplat's simple_trainer; save it again.")
    if splats.keys() >= HARMONICS:
        _tell_of(set(splats) - SHARED - HARMONICS, path)
        return _model(splats, numbers_of(splats["sh0"]), numbers_of(splats["shN"]), GSPLAT)
    _tell_of(set(splats) - SHARED - COLOURS, path)
    warnings.warn(LossWarning(f"{path}: its network of appearance (app_opt) is left out; colours are those before it."), stacklevel=4)
    colours = numbers_of(splats["colors"])
    base = (sigmoid(colours.astype(np.float64)) - 0.5) / SH_C0
    return _model(splats, base[:, None], np.zeros((len(base), 0, 3)), GSPLAT)


def _parameters(content: Any) -> dict[str, torch_zip.Tensor] | None:
    """splatfacto's tensors by their plain names; None for anything else."""
    for prefix in PREFIXES:
        found = torch_zip.of_pipeline(content, prefix)
        if prefix == PREFIXES[1]:  # the model's other parts are beside them there
            found = {name: value for name, value in found.items() if name in SHARED | DC_AND_REST}
        if found.keys() >= SHARED | DC_AND_REST:
            return found
    return None


def _tell_of(others: set[str], path: Path) -> None:
    if others:
        names = printable(", ".join(sorted(others)))[:120]
        warnings.warn(LossWarning(f"{path}: its parameters {names} are not known and are left out; it is shown as static Gaussians."),
                      stacklevel=4)


def _model(table: Mapping[str, torch_zip.Tensor], base: np.ndarray, rest: np.ndarray, raster: Raster) -> GaussianModel:
    """The model of tensors by the names in SHARED, and of coefficients [N, 1, 3] and [N, K, 3]."""
    arrays = {name: numbers_of(table[name]) for name in SHARED}
    n = arrays["means"].shape[0] if arrays["means"].ndim else 0
    if arrays["opacities"].shape == (n, 1):
        arrays["opacities"] = arrays["opacities"][:, 0]
    shapes = {"means": (n, 3), "scales": (n, 3), "quats": (n, 4), "opacities": (n,)}
    check_shapes({name: (arrays[name], shape) for name, shape in shapes.items()} | {"colour": (base, (n, 1, 3))})
    if rest.ndim != 3 or rest.shape != (n, rest.shape[1], 3) or rest.shape[1] not in DEGREES:
        raise FastGSError(f"its spherical harmonics have the shape {rest.shape}, which fits no degree; save the checkpoint again.")
    features = np.concatenate([base, rest], 1).reshape(n, -1)
    return GaussianModel(arrays["means"], arrays["quats"], arrays["scales"], arrays["opacities"], features,
                         appearance=SH(DEGREES[rest.shape[1]]), raster=raster)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Checkpoints of static Gaussians: gsplat's simple_trainer (`ckpts/ckpt_<step>_rank<r>.pt`), nerfstudio's splatfacto (`step-<step>.ckpt`).

gsplat saves {step, splats}.  splats: means (means3d before 1.0) [N, 3], scales (ln) [N, 3], quats (w x y z) [N, 4], opacities (logit)
[N], sh0 [N, 1, 3], shN [N, K, 3]; with app_opt, instead of the harmonics, features and colors (logit) [N, 3].  A training on several GPUs
leaves a file for each of them with a part of the Gaussians; these are read together.

nerfstudio saves {step, pipeline, ...}.  pipeline: _model.gauss_params.<name> (before 1.0 _model.<name>) for means, scales, quats,
features_dc [N, 3], features_rest [N, K, 3], opacities [N, 1].  Without features_rest, features_dc are logits of colours.  Its z points up.

Both draw with gsplat.  Whether antialiased, the training's settings tell: cfg.yml and config.yml in the folder above the checkpoint's.
"""
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
from .scenes import together
from .trained import harmonics, numbers_of, rows

RANK = re.compile(r"(.*_rank)\d+(\.pt)", re.IGNORECASE)
PREFIXES = ("_model.gauss_params.", "_model.")
HARMONICS, COLOURS = {"sh0", "shN"}, {"features", "colors"}
"""Of gsplat, with and without app_opt."""
SHARED: dict[str, tuple[int, ...]] = {"means": (3,), "scales": (3,), "quats": (4,), "opacities": ()}
DC_AND_REST = {"features_dc", "features_rest"}
MAX_SETTINGS = 1 << 20
"""Bytes that are looked at."""


class GsplatCheckpoint(Format):
    """A checkpoint of gsplat's simple_trainer."""

    name = "gsplat checkpoint"
    reads = (".pt",)

    def sniff(self, head: bytes, path: Path) -> bool:
        return bool(_splats(torch_zip.content_or_none(head, path)))

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
        return bool(_parameters(torch_zip.content_or_none(head, path)))

    def load(self, path: Path) -> GaussianModel:
        found = _parameters(torch_zip.TorchFile(path).content)
        _tell_of(set(found) - set(SHARED) - DC_AND_REST, path)
        base, rest = numbers_of(found["features_dc"]), numbers_of(found["features_rest"])
        if rest.ndim == 3 and not rest.shape[1]:  # trained with sh_degree 0
            base = _of_logits(base)
        raster = replace(GSPLAT, antialiased=_says(path.parent.parent / "config.yml", "rasterize_mode", "antialiased"))
        return replace(_model(found, base, rest, raster), axes="RFU")


def _says(file: Path, key: str, value: str) -> bool:
    """Whether a line of a YAML file gives a key this value.  Trainers write one setting a line; objects of Python in it are not made."""
    if not file.is_file():
        return False
    with open_file(file) as stream:
        text = stream.read(MAX_SETTINGS).decode("utf-8", "replace")
    return re.search(rf"^\s*{key}:\s*['\"]?{value}['\"]?\s*$", text, re.MULTILINE) is not None


def _splats(content: Any) -> dict[str, torch_zip.Tensor]:
    """gsplat's table of tensors; an empty one for anything else."""
    splats = content.get("splats") if isinstance(content, dict) else None
    if not isinstance(splats, dict) or not all(isinstance(v, torch_zip.Tensor) for v in splats.values()):
        return {}
    table = {"means" if name == "means3d" else name: tensor for name, tensor in splats.items()}
    return table if table.keys() >= set(SHARED) and (table.keys() >= HARMONICS or table.keys() >= COLOURS) else {}


def _gsplat(path: Path) -> GaussianModel:
    splats = _splats(torch_zip.TorchFile(path).content)
    if not splats:
        raise FastGSError(f"{path.name} is no checkpoint of gsplat's simple_trainer; save it again.")
    kind = HARMONICS if splats.keys() >= HARMONICS else COLOURS
    _tell_of(set(splats) - set(SHARED) - kind, path)
    if kind is HARMONICS:
        return _model(splats, splats["sh0"], splats["shN"], GSPLAT)
    warnings.warn(LossWarning(f"{path}: its network of appearance (app_opt) is left out; colours are those before it."), stacklevel=4)
    base = _of_logits(numbers_of(splats["colors"]))
    return _model(splats, base, np.zeros((len(base), 0, 3)), GSPLAT)


def _of_logits(colours: np.ndarray) -> np.ndarray:
    """Coefficients of degree 0 of colours that are logits."""
    return (sigmoid(colours.astype(np.float64)) - 0.5) / SH_C0


def _parameters(content: Any) -> dict[str, torch_zip.Tensor]:
    """splatfacto's tensors by their plain names; an empty table for anything else."""
    for prefix in PREFIXES:
        found = torch_zip.of_pipeline(content, prefix)
        if prefix == PREFIXES[1]:  # the model's other parts are beside them there
            found = {name: value for name, value in found.items() if name in DC_AND_REST.union(SHARED)}
        if found.keys() >= DC_AND_REST.union(SHARED):
            return found
    return {}


def _tell_of(others: set[str], path: Path) -> None:
    if others:
        names = printable(", ".join(sorted(others)))[:120]
        warnings.warn(LossWarning(f"{path}: its parameters {names} are not known and are left out; it is shown as static Gaussians."),
                      stacklevel=4)


def _model(table: Mapping[str, torch_zip.Tensor], base: Any, rest: Any, raster: Raster) -> GaussianModel:
    """The model of tensors by the names in SHARED, and of coefficients of degree 0 and above it."""
    arrays = rows(table, SHARED)
    features, degree = harmonics(base, rest, len(arrays["means"]))
    return GaussianModel(arrays["means"], arrays["quats"], arrays["scales"], arrays["opacities"], features, appearance=SH(degree),
                         raster=raster)

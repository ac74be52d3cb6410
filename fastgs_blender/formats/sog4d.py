# SPDX-License-Identifier: GPL-3.0-or-later
"""`.sog4d` of SuperSplat 4D: SOG with a velocity, a temporal centre and a temporal width for each Gaussian, in a zip.

Beside the pictures of SOG version 2: motion, kept as positions are; trbf, the centre c and ln of the width s, either as 16 bits between
bounds ("quantize16") or as numbers of two tables ("kmeans").  At T seconds, start <= T <= start + duration, a Gaussian lies at
position + motion (T - c); its opacity is multiplied by exp(-((T - c) / s)^2), and under 0.005 it is not drawn.
A file of several ("sog4d_multi") has one of these in a folder, and static ones, each a SOG, in others.  Segments (lists of what can be
seen in a part of the clip) and pictures of surroundings are ignored.  The other `.sog4d`, of gsplat-unity, is in sog4d_frames.py.
"""
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..model.appearance import SH
from ..model.gaussians import Clip, GaussianModel
from ..model.slicing import sigmoid
from ..util.errors import FastGSError
from ..util.reading import damaged_if
from . import pixel_tables as tables
from . import sog
from .base import Format
from .straight import Timeline, straight

CUTOFF = 0.005
"""Opacities below it are not drawn."""
NARROWEST = 1e-6
"""Least temporal width, in seconds."""
KINDS = ("sog4d", "sog4d_multi")


@dataclass(frozen=True)
class Part:
    """Gaussians of one folder: a static model, and how they move: velocity [N, 3], centre [N], width [N] in seconds, inf: for ever."""

    model: GaussianModel
    velocity: np.ndarray
    centre: np.ndarray
    width: np.ndarray


class Sog4d(Format):
    name = "SOG4D (SuperSplat 4D)"
    reads = (".sog4d",)

    def sniff(self, head: bytes, path: Path) -> bool:
        return tables.meta_of(head, path).get("type") in KINDS

    def load(self, path: Path) -> GaussianModel:
        with tables.opened(path) as files:
            meta = files.meta()
            parts, timed = [], meta
            if meta["type"] == "sog4d":
                parts.append(_moving(meta, files))
            else:
                folders = [_folder(part, name) for name, part in sorted((meta.get("static") or {}).items())]
                parts += [_still(inner.meta(), inner) for inner in map(files.within, folders)]
                if "dynamic" in meta:
                    inner = files.within(_folder(tables.part(meta, "dynamic"), "dynamic"))
                    timed = inner.meta()
                    parts.append(_moving(timed, inner))
        damaged_if(not parts, "it names no Gaussians")
        return together(parts, timed)


def _folder(part: object, name: str) -> str:
    """The folder of a part."""
    path = part.get("path", name) if isinstance(part, dict) else name
    return tables.plain(path.rstrip("/") if isinstance(path, str) else path)


def _still(meta: dict, files: tables.Folder) -> Part:
    model = sog.decoded({"version": 2} | meta, files)
    n = len(model)
    return Part(model, np.zeros((n, 3)), np.zeros(n), np.full(n, np.inf))


def _moving(meta: dict, files: tables.Folder) -> Part:
    model = sog.decoded({key: value for key, value in meta.items() if key != "shN"} | {"version": 2}, files)
    n, part = len(model), tables.part(meta, "trbf")
    if part.get("encoding", "quantize16") == "kmeans":
        code = tables.pixels(files, tables.names(meta, "trbf", 1)[0], n)
        centre, ln_width = (tables.table(part, f"{key}_codebook")[code[:, i]] for i, key in enumerate(("center", "scale")))
    else:
        share = tables.sixteen_bits(files, tables.names(meta, "trbf", 2), n)
        ends = {key: tables.numbers([part.get(key)], 1)[0] for key in ("center_min", "center_max", "scale_min", "scale_max")}
        centre, ln_width = (_between(ends[f"{key}_min"], ends[f"{key}_max"], share[:, i]) for i, key in enumerate(("center", "scale")))
    return Part(model, sog.logarithmic(meta, "motion", files, n), centre, np.maximum(np.exp(ln_width), NARROWEST))


def _between(low: float, high: float, share: np.ndarray) -> np.ndarray:
    return low + share * (high - low if high != low else 1.0)


def together(parts: list[Part], meta: dict) -> GaussianModel:
    """One model of all parts; meta says how long it lasts."""
    start, duration, fps = (_seconds(meta, key, default) for key, default in (("start", 0.0), ("duration", 0.0), ("fps", 30.0)))
    frames = max(1, round(duration * fps))
    length = duration or frames / fps
    degree = max(part.model.appearance.degree for part in parts)
    features = [np.pad(m.features, ((0, 0), (0, SH(degree).width - m.features.shape[1]))) for m in (part.model for part in parts)]
    whole = {name: np.concatenate([getattr(part.model, name) for part in parts]) for name in ("position", "rotation", "scale", "opacity")}
    velocity, centre, width = (np.concatenate([getattr(part, name) for part in parts]) for name in ("velocity", "centre", "width"))
    with np.errstate(all="ignore"):  # what is no number is found by usable()
        reach = np.sqrt(np.maximum(np.log(sigmoid(whole["opacity"].astype(np.float64)) / CUTOFF), 0))
        reach = np.where(np.isinf(width), np.inf, width * reach)
    lives = straight(whole.pop("position"), velocity, centre, np.log(width) - np.log(2) / 2, Timeline(start, length),
                     (centre - reach, centre + reach), closed=True)
    return GaussianModel(**lives, **whole, features=np.concatenate(features), appearance=SH(degree), clip=Clip(frames, frames / length))


def _seconds(meta: dict, key: str, default: float) -> float:
    value = meta.get(key, default)
    if type(value) not in (int, float) or not 0 <= value <= 1e5 or (key == "fps" and not value):
        raise FastGSError(f"its {key} of {str(value)[:40]!r} is no such number; the file is damaged.")
    return float(value)

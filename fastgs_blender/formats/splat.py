# SPDX-License-Identifier: GPL-3.0-or-later
"""`.splat` of antimatter15's viewer: records of 32 bytes without a header, static Gaussians of one colour each.

A record, little-endian: position 3 x f32, standard deviations 3 x f32, red green blue opacity u8 (255 is 1),
quaternion w x y z u8 ((b - 128) / 128).  The largest and most opaque Gaussians come first.
"""
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..model.appearance import RGB, SH_C0
from ..model.gaussians import GaussianModel
from ..model.slicing import sigmoid
from ..util import rotations
from ..util.errors import FastGSError, LossWarning
from .static import StaticFormat, logits, opacity_bytes, read_whole, to_byte

RECORD = np.dtype([("position", "<f4", 3), ("scale", "<f4", 3), ("colour", "u1", 4), ("rotation", "u1", 4)])
SAMPLES = 64
"""Records that are looked at to know a file without a header."""

FARTHEST = 1e7
"""Coordinates and sizes below which records are taken for a .splat, which has no mark of its own."""


class Splat(StaticFormat):
    name = ".splat"
    extensions = reads = (".splat",)
    degree = 0

    def sniff(self, head: bytes, path: Path) -> bool:
        size = path.stat().st_size
        named = path.suffix.lower() == ".splat"
        if size < RECORD.itemsize or (size % RECORD.itemsize and not named):
            return False
        data = read_whole(path, SAMPLES * RECORD.itemsize)
        records = np.frombuffer(data[:len(data) // RECORD.itemsize * RECORD.itemsize], RECORD)
        with np.errstate(over="ignore", invalid="ignore"):
            good = (np.abs(records["position"]) < FARTHEST).all(1) & (records["scale"] >= 0).all(1) & (records["scale"] < FARTHEST).all(1)
            norm = np.linalg.norm(_rotation(records), axis=1)
        good &= (np.abs(norm - 1) < 0.1) | (named & (norm > 0.1))
        return bool(good.mean() > 0.9 if named else good.all())

    def load(self, path: Path) -> GaussianModel:
        data = read_whole(path)
        count, rest = divmod(len(data), RECORD.itemsize)
        if data[len(data) - rest:].strip(b" \t\r\n\0"):
            warnings.warn(LossWarning(f"{path}: the file ends within a record, as those do that are cut short; its {count} whole records "
                                      "are read."), stacklevel=4)
        records = np.frombuffer(data, RECORD, count)
        return GaussianModel(
            position=records["position"], scale=np.log(records["scale"]), rotation=_rotation(records),
            opacity=logits()[records["colour"][:, 3]], features=records["colour"][:, :3] / np.float32(255), appearance=RGB())

    def fit(self, model: GaussianModel) -> tuple[GaussianModel, list[str]]:
        model, lost = super().fit(model)
        near = (np.abs(model.position) < FARTHEST).all(1) & (model.scale < np.log(FARTHEST)).all(1)
        if not near.any():
            raise FastGSError(f"its Gaussians lie farther away, or are larger, than {FARTHEST:.0f} units, and nobody takes such a file for "
                              "a .splat; make the model smaller, or choose another format.")
        if not near.all():
            model = model.take(np.flatnonzero(near))
            lost.append(f"{np.count_nonzero(~near)} Gaussians that lie farther away, or are larger, than {FARTHEST:.0f} units")
        colour = 0.5 + SH_C0 * model.features.astype(np.float64)
        if len(model) and (colour.min() < 0 or colour.max() > 1):
            lost.append("colours below 0 or above 1 are cut")
        lost.append("colours, opacities and rotations are rounded to 8 bits")
        return replace(model, features=np.clip(colour, 0, 1), appearance=RGB()), lost

    def write(self, model: GaussianModel, targets: list[Path]) -> None:
        records = np.empty(len(model), RECORD)
        records["position"] = model.position
        records["scale"] = np.exp(model.scale.astype(np.float64))
        records["colour"][:, :3] = to_byte(model.features.astype(np.float64) * 255)
        records["colour"][:, 3] = opacity_bytes(model)
        records["rotation"] = to_byte(rotations.unit(model.rotation.astype(np.float64)) * 128 + 128)
        importance = model.scale.sum(1, dtype=np.float64) + np.log(np.maximum(sigmoid(model.opacity), 1e-30))
        targets[-1].write_bytes(records[np.argsort(-importance, kind="stable")].tobytes())


def _rotation(records: np.ndarray) -> np.ndarray:
    return (records["rotation"].astype(np.float32) - 128) / np.float32(128)

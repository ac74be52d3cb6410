# SPDX-License-Identifier: GPL-3.0-or-later
"""FAST-GS's own format: a safetensors file with the model's arrays, and its kinds and constants as JSON.  docs/file-format.md."""
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..model.appearance import Features
from ..model.gaussians import GaussianModel
from ..model.parts import Parts
from ..util.errors import FastGSError
from ..util.reading import damaged_if
from ..util.tensor_files import MAX_HEADER, TensorFile, open_tensors, write_tensors
from . import compressed
from .base import LIMIT, Format, generator
from .description import describe, read_json, understand, whole_number
from .rate import Loss

VERSION, COMPRESSED = 1, 3
"""Of plain and of compressed files: raised when a reader of the old version would misread a new file; additions that it may pass over do
not raise it."""
KEY = "fast-gs"
DECODER = ("w1", "w2")
PARTS = "parts"
"""Key of the parts' names in the header, and of the array [N / 8, P] uint8 of their Gaussians, eight in a byte, the first highest."""
REQUIRED = ("basis", "rotation_basis", "temporal", "appearance", "raster", "clip", "axes", "colour_space")


@dataclass(frozen=True)
class Native(Format):
    """The format FAST-GS safetensors; it holds every model whole.

    loss      write the compressed variant (compressed.py), whose pictures may lose so much; None: every number as it is
    progress  called with 0..1 while it is compressed
    """

    loss: Loss | None = None
    progress: Callable[[float], None] | None = None

    name = "FAST-GS safetensors"
    says_axes = True
    extensions = reads = (".safetensors",)
    keeps_cameras = keeps_parts = True

    def sniff(self, head: bytes, path: Path) -> bool:
        return head[8:9] == b"{" and int.from_bytes(head[:8], "little") <= MAX_HEADER

    def load(self, path: Path) -> GaussianModel:
        with open_tensors(path) as file:
            if KEY not in file.metadata:
                raise FastGSError("it is a safetensors file, but not a FAST-GS model.")
            kinds, version, about = _kinds(file.metadata[KEY])
            look = kinds["appearance"]
            empty = GaussianModel(np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, look.width)), **kinds)
            if version == COMPRESSED:
                model = compressed.unpacked(file, about, empty)
                return replace(model, appearance=_with_decoder(file, look), parts=_parts(file, len(model)))
            position = file.entries.get("position")
            shapes = empty.shapes(position.shape[0] if position and position.shape else 1)
            if isinstance(look, Features):
                shapes |= {f"decoder.{key}": getattr(look, key).shape for key in DECODER}
            stored = [name for name, shape in shapes.items() if 0 not in shape[1:]]
            for name in stored:
                _check(file, name, shapes[name])
            arrays = {name: file.read(name) if name in stored else np.zeros(shape, np.float32) for name, shape in shapes.items()}
            parts = _parts(file, len(arrays["position"]))
        if isinstance(look, Features):
            kinds["appearance"] = replace(look, **{key: arrays.pop(f"decoder.{key}") for key in DECODER})
        return replace(empty, appearance=kinds["appearance"], parts=parts, **arrays)

    def fit(self, model: GaussianModel) -> tuple[GaussianModel, list[str]]:
        if self.loss is None:
            return model, []
        flat = [array.reshape(len(model), -1) for array in model.arrays.values()] if len(model) else []
        bad = ~np.logical_and.reduce([(np.abs(array) < LIMIT).all(1) for array in flat]) if flat else np.zeros(0, bool)
        lost = [f"{bad.sum()} Gaussians whose numbers are not finite"] if bad.any() else []
        lost += [f"its numbers are quantised so that pictures lose about {self.loss.decibels:g} dB",
                 "Gaussians that hardly show are left out, and the others come in another order"]
        return model.take(~bad), lost

    def write(self, model: GaussianModel, targets: list[Path]) -> None:
        about = {"version": VERSION, "generator": generator(), "model": describe(model)}
        if self.loss is None:
            tensors, bits = {name: array for name, array in model.arrays.items() if 0 not in array.shape[1:]}, model.parts.bits
        else:
            tensors, about["compressed"], bits = compressed.packed(model, self.loss, self.progress or (lambda share: None))
            about["version"] = COMPRESSED
        if isinstance(model.appearance, Features):
            tensors |= {f"decoder.{key}": getattr(model.appearance, key) for key in DECODER}
        if model.parts.names:
            about["parts"], tensors[PARTS] = list(model.parts.names), np.packbits(bits, axis=0)
        write_tensors(targets[-1], tensors, {KEY: json.dumps(about, allow_nan=False)})


def _with_decoder(file: TensorFile, look):
    """The appearance with the decoder's weights that the file has."""
    if not isinstance(look, Features):
        return look
    for key in DECODER:
        _check(file, f"decoder.{key}", getattr(look, key).shape)
    return replace(look, **{key: file.read(f"decoder.{key}") for key in DECODER})


def _parts(file: TensorFile, count: int) -> Parts:
    """The parts of a file's model of so many Gaussians."""
    names = read_json(file.metadata[KEY]).get(PARTS, [])
    if not names:
        return Parts()
    packed = file.read(PARTS)
    good = isinstance(names, list) and all(isinstance(name, str) for name in names)
    damaged_if(not good or packed.dtype != np.uint8 or packed.shape != (-(-count // 8), len(names)),
               "its header and its array of parts do not fit together")
    return Parts(tuple(names), np.unpackbits(packed, axis=0, count=count).astype(bool))


def _kinds(text: str) -> tuple[dict, int, dict]:
    """The model's kinds from the JSON in the metadata, the version of the format, and how it is compressed, if it is."""
    about = read_json(text)
    version = whole_number(about.get("version") if isinstance(about, dict) else None, "the version of its format")
    if version > COMPRESSED:
        raise FastGSError(f"a newer FAST-GS wrote it (format version {version}, this one reads up to {COMPRESSED}); "
                          "update FAST-GS for Blender.")
    if version not in (VERSION, COMPRESSED):
        raise FastGSError(f"its format version {version} was never released; make the file again from the model's source.")
    values = about.get("model")
    missing = [key for key in REQUIRED if not isinstance(values, dict) or key not in values]
    damaged_if(missing, f"its header says nothing about {', '.join(missing)}")
    return understand(values), version, about.get("compressed", {})


def _check(file: TensorFile, name: str, shape: tuple[int, ...]) -> None:
    """Raises FastGSError unless the file has a float32 array of that name and shape."""
    entry = file.entries.get(name)
    if entry is None:
        raise FastGSError(f"its array {name!r} is missing; the file is damaged.")
    if entry.dtype != "F32" or entry.shape != shape:
        raise FastGSError(f"its array {name!r} must be float32 of shape {shape}, not {entry.dtype} of {entry.shape}.")

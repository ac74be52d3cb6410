# SPDX-License-Identifier: GPL-3.0-or-later
"""FAST-GS's own format: a safetensors file with the model's arrays, and its kinds and constants as JSON.  docs/file-format.md."""
from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from ..model.appearance import Features
from ..model.gaussians import GaussianModel
from ..util.errors import FastGSError
from ..util.tensor_files import MAX_HEADER, TensorFile, open_tensors, write_tensors
from .base import Format, generator
from .description import describe, read_json, understand, whole_number

VERSION = 1
"""Raised when a reader of the old version would misread a new file; additions that it may pass over do not raise it."""
KEY = "fast-gs"
DECODER = ("w1", "w2")
REQUIRED = ("basis", "rotation_basis", "temporal", "appearance", "raster", "clip", "axes", "colour_space")


class Native(Format):
    """The format FAST-GS safetensors; it holds every model whole."""

    name = "FAST-GS safetensors"
    extensions = reads = (".safetensors",)

    def sniff(self, head, path):
        return head[8:9] == b"{" and int.from_bytes(head[:8], "little") <= MAX_HEADER

    def load(self, path):
        with open_tensors(path) as file:
            if KEY not in file.metadata:
                raise FastGSError("it is a safetensors file, but not a FAST-GS model.")
            kinds = _kinds(file.metadata[KEY])
            look = kinds["appearance"]
            empty = GaussianModel(np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, look.width)), **kinds)
            position = file.entries.get("position")
            shapes = empty.shapes(position.shape[0] if position and position.shape else 1)
            if isinstance(look, Features):
                shapes |= {f"decoder.{key}": getattr(look, key).shape for key in DECODER}
            stored = [name for name, shape in shapes.items() if 0 not in shape[1:]]
            for name in stored:
                _check(file, name, shapes[name])
            arrays = {name: file.read(name) if name in stored else np.zeros(shape, np.float32) for name, shape in shapes.items()}
        if isinstance(look, Features):
            kinds["appearance"] = replace(look, **{key: arrays.pop(f"decoder.{key}") for key in DECODER})
        return replace(empty, appearance=kinds["appearance"], **arrays)

    def write(self, model, targets):
        tensors = {name: array for name, array in model.arrays.items() if 0 not in array.shape[1:]}
        if isinstance(model.appearance, Features):
            tensors |= {f"decoder.{key}": getattr(model.appearance, key) for key in DECODER}
        about = {"version": VERSION, "generator": generator(), "model": describe(model)}
        write_tensors(targets[-1], tensors, {KEY: json.dumps(about, allow_nan=False)})


def _kinds(text: str) -> dict:
    """The model's kinds from the JSON in the metadata."""
    about = read_json(text)
    version = whole_number(about.get("version") if isinstance(about, dict) else None, "the version of its format")
    if version > VERSION:
        raise FastGSError(f"a newer FAST-GS wrote it (format version {version}, this one reads up to {VERSION}); "
                          "update FAST-GS for Blender.")
    values = about.get("model")
    missing = [key for key in REQUIRED if not isinstance(values, dict) or key not in values]
    if missing:
        raise FastGSError(f"its header says nothing about {', '.join(missing)}; the file is damaged.")
    return understand(values)


def _check(file: TensorFile, name: str, shape: tuple[int, ...]) -> None:
    """Raises FastGSError unless the file has a float32 array of that name and shape."""
    entry = file.entries.get(name)
    if entry is None:
        raise FastGSError(f"its array {name!r} is missing; the file is damaged.")
    if entry.dtype != "F32" or entry.shape != shape:
        raise FastGSError(f"its array {name!r} must be float32 of shape {shape}, not {entry.dtype} of {entry.shape}.")

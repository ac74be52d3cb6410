# SPDX-License-Identifier: GPL-3.0-or-later
"""FAST-GS's own file: safetensors, the arrays memory-mapped, everything else as JSON in the header.  docs/file-format.md.

The arrays of a loaded model are views of the file, private to the process: writing into them changes memory, never the
file.  (The safetensors library checks the header; its own reading of arrays makes copies.)
"""
from __future__ import annotations

import json
import os
import re
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..model.appearance import Features
from ..model.gaussians import GaussianModel
from ..util.errors import FastGSError
from .base import Format, generator
from .description import describe, read_json, understand, whole_number

VERSION = 1
"""Raised when a reader of the old version would misread a new file; additions that it may pass over do not raise it."""
KEY = "fast-gs"
MAX_HEADER = 16 << 20
DECODER = ("w1", "w2")
REQUIRED = ("basis", "rotation_basis", "temporal", "appearance", "raster", "clip", "axes", "colour_space")

_mapped: weakref.WeakKeyDictionary[GaussianModel, str] = weakref.WeakKeyDictionary()
"""Loaded models and their file, so that their file can be replaced where a mapped file cannot be (Windows)."""


class Native(Format):
    """See the module."""

    name = "FAST-GS safetensors"
    extensions = reads = (".safetensors",)

    def sniff(self, head, path):
        return head[8:9] == b"{" and int.from_bytes(head[:8], "little") <= MAX_HEADER

    def load(self, path):
        begin, tensors = _header(path)
        metadata = tensors.pop("__metadata__", None) or {}
        if KEY not in metadata:
            raise FastGSError("it is a safetensors file, but not a FAST-GS model.")
        kinds = _kinds(metadata[KEY])
        look = kinds["appearance"]
        count = (tensors.get("position", {}).get("shape") or [1])[0]
        empty = GaussianModel(np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, look.width)), **kinds)
        shapes = empty.shapes(count)
        if isinstance(look, Features):
            shapes |= {f"decoder.{key}": getattr(look, key).shape for key in DECODER}
        spans = {name: _span(tensors, name, shape) for name, shape in shapes.items() if 0 not in shape[1:]}
        data = _map(path)
        arrays = {name: np.zeros(shape, np.float32) for name, shape in shapes.items() if name not in spans}
        for name, (start, end) in spans.items():
            if begin + end > len(data):
                raise FastGSError(f"the file is cut short within its array {name!r}; copy or export it again.")
            array = data[begin + start:begin + end].view("<f4").reshape(shapes[name])
            arrays[name] = np.require(array, requirements="A")  # other writers may not align
        if isinstance(look, Features):
            kinds["appearance"] = replace(look, **{key: np.array(arrays.pop(f"decoder.{key}")) for key in DECODER})
        model = replace(empty, appearance=kinds["appearance"], **arrays)
        _mapped[model] = os.path.realpath(path)
        return model

    def write(self, model, targets):
        tensors = {name: array for name, array in model.arrays.items() if 0 not in array.shape[1:]}
        if isinstance(model.appearance, Features):
            tensors |= {f"decoder.{key}": getattr(model.appearance, key) for key in DECODER}
        about = {"version": VERSION, "generator": generator(), "model": describe(model)}
        write_tensors(targets[-1], tensors, {KEY: json.dumps(about, allow_nan=False)})


def write_tensors(path: Path, tensors: dict[str, np.ndarray], metadata: dict[str, str]) -> None:
    """A safetensors file; raises OSError.  One key of metadata: the library writes several in random order, and the same
    content must give the same bytes."""
    library = _library()
    try:
        library.numpy.save_file(tensors, path, metadata)
    except library.SafetensorError as error:
        number = re.search(r"os error (\d+)", str(error))
        raise (OSError(int(number[1]), os.strerror(int(number[1]))) if number else OSError(str(error))) from error


def release(path: Path) -> None:
    """Bring the models that are mapped from a file into memory, so that nothing here holds the file open."""
    for model in [m for m, file in _mapped.items() if file == os.path.realpath(path)]:
        hold(model)


def hold(model: GaussianModel) -> None:
    """Give the model arrays of its own."""
    for name, array in model.arrays.items():
        setattr(model, name, np.array(array))
    _mapped.pop(model, None)


def _library():
    """The safetensors library, when it is needed: without it other formats still work."""
    try:
        import safetensors.numpy
    except ImportError as error:
        raise FastGSError("the safetensors library, which reads and writes this format, is not installed.") from error
    return safetensors


def _header(path: Path) -> tuple[int, dict]:
    """Where the data begins, and the header's table, which the library has found sound."""
    with open(path, "rb") as stream:
        size = int.from_bytes(stream.read(8), "little")
        text = stream.read(min(size, MAX_HEADER))
    library = _library()
    try:
        with library.safe_open(path, "numpy"):
            pass
    except library.SafetensorError as error:
        raise FastGSError(f"the file is cut short or damaged ({error}); copy or export it again.") from error
    return 8 + size, read_json(text)


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


def _span(tensors: dict, name: str, shape: tuple[int, ...]) -> tuple[int, int]:
    """Begin and end of an array in the data, its type, shape and length checked."""
    info = tensors.get(name)
    if info is None:
        raise FastGSError(f"its array {name!r} is missing; the file is damaged.")
    start, end = info["data_offsets"]
    if info["dtype"] != "F32" or tuple(info["shape"]) != shape or end - start != 4 * int(np.prod(shape, dtype=object)):
        raise FastGSError(f"its array {name!r} must be float32 of shape {shape}, not {info['dtype']} of {tuple(info['shape'])}.")
    return start, end


def _map(path: Path) -> np.ndarray:
    """The file's bytes, copy-on-write; read-only where the system will not promise memory for that."""
    try:
        return np.memmap(path, np.uint8, "c")
    except (OSError, MemoryError):
        return np.memmap(path, np.uint8, "r")

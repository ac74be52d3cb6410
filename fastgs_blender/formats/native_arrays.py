# SPDX-License-Identifier: GPL-3.0-or-later
"""What our own file holds of one model: its arrays, its decoder and the bits of its parts, plain or compressed.

A file of one model holds them once, a long clip once for each of its pieces (chaptered.py).
"""
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ..model.appearance import Features
from ..model.gaussians import GaussianModel
from ..model.parts import Parts
from ..util.errors import FastGSError
from ..util.reading import damaged_if
from ..util.tensor_files import TensorFile
from . import compressed
from .rate import Loss

DECODER = ("w1", "w2")
PARTS = "parts"
"""Key of the parts' names in the header, and of the array [N / 8, P] uint8 of their Gaussians, eight in a byte, the first highest."""
COMPRESSED = "compressed"
"""Key of what the header says of compressed arrays; without it the arrays are plain."""


def arrays_of(model: GaussianModel, loss: Loss | None, progress: Callable[[float], None] | None) -> tuple[dict[str, np.ndarray], dict]:
    """The arrays to store by name, without the decoder, and the header's entries."""
    about: dict[str, Any] = {}
    if loss is None:
        tensors, bits = {name: array for name, array in model.arrays.items() if 0 not in array.shape[1:]}, model.parts.bits
    else:
        tensors, about[COMPRESSED], bits = compressed.packed(model, loss, progress or (lambda share: None))
    if model.parts.names:
        about[PARTS], tensors[PARTS] = list(model.parts.names), np.packbits(bits, axis=0)
    return tensors, about


def decoder_of(model: GaussianModel) -> dict[str, np.ndarray]:
    """The weights of the model's decoder by name; none without one."""
    appearance = model.appearance
    return {f"decoder.{key}": getattr(appearance, key) for key in DECODER} if isinstance(appearance, Features) else {}


def read_model(file: TensorFile, about: dict, template: GaussianModel) -> GaussianModel:
    """The model in a file; about: the header's entries, template: a model without Gaussians that has its kinds and its decoder."""
    if COMPRESSED in about:
        model = compressed.unpacked(file, about[COMPRESSED], template)
        return replace(model, parts=_parts(file, about, len(model)))
    position = file.entries.get("position")
    shapes = template.shapes(position.shape[0] if position and position.shape else 1)
    stored = [name for name, shape in shapes.items() if 0 not in shape[1:]]
    for name in stored:
        _check(file, name, shapes[name])
    arrays: Any = {name: file.read(name) if name in stored else np.zeros(shape, np.float32) for name, shape in shapes.items()}
    return replace(template, **arrays, parts=_parts(file, about, len(arrays["position"])))


def with_decoder(file: TensorFile, template: GaussianModel) -> GaussianModel:
    """The template with the weights of the decoder that the file has."""
    appearance = template.appearance
    if not isinstance(appearance, Features):
        return template
    for key in DECODER:
        _check(file, f"decoder.{key}", getattr(appearance, key).shape)
    weights: Any = {key: file.read(f"decoder.{key}") for key in DECODER}
    return replace(template, appearance=replace(appearance, **weights))


def _parts(file: TensorFile, about: dict, count: int) -> Parts:
    """The parts of a file's model of so many Gaussians."""
    names = about.get(PARTS, [])
    if not names:
        return Parts()
    packed = file.read(PARTS)
    good = isinstance(names, list) and all(isinstance(name, str) for name in names)
    damaged_if(not good or packed.dtype != np.uint8 or packed.shape != (-(-count // 8), len(names)),
               "its header and its array of parts do not fit together")
    return Parts(tuple(names), np.unpackbits(packed, axis=0, count=count).astype(bool))


def _check(file: TensorFile, name: str, shape: tuple[int, ...]) -> None:
    """Raises FastGSError unless the file has a float32 array of that name and shape."""
    entry = file.entries.get(name)
    if entry is None:
        raise FastGSError(f"its array {name!r} is missing; the file is damaged.")
    if entry.dtype != "F32" or entry.shape != shape:
        raise FastGSError(f"its array {name!r} must be float32 of shape {shape}, not {entry.dtype} of {entry.shape}.")

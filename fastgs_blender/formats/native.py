# SPDX-License-Identifier: GPL-3.0-or-later
"""FAST-GS's own format: a safetensors file with the model's arrays, and its kinds and constants as JSON.  docs/file-format.md."""
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..model.chapters import Chapters
from ..model.gaussians import GaussianModel
from ..model.sequence import Source
from ..util.errors import FastGSError
from ..util.reading import damaged_if
from ..util.tensor_files import MAX_HEADER, TensorFile, open_tensors, write_tensors
from . import chaptered
from .base import LIMIT, Format, Loader, generator
from .description import describe, read_json, understand, whole_number, without_gaussians
from .native_arrays import arrays_of, decoder_of, read_model, with_decoder
from .rate import Loss

VERSION, COMPRESSED = 1, 3
"""Of plain and of compressed files, beside that of long clips (chaptered.py): raised when a reader of the old version would misread a new
file; additions that it may pass over do not raise it."""
KEY = "fast-gs"
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
            about, version, template = _header(file)
            if version == chaptered.VERSION:
                return chaptered.opened(path, file, about, template).joined()
            return read_model(file, about, with_decoder(file, template))

    def open(self, path: Path, load: Loader) -> Source:
        with open_tensors(path) as file:
            about, version, template = _header(file)
            return load(path) if version != chaptered.VERSION else chaptered.opened(path, file, about, template)

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
        tensors, entries = arrays_of(model, self.loss, self.progress)
        about = {"version": VERSION if self.loss is None else COMPRESSED, "generator": generator(), "model": describe(model), **entries}
        write_tensors(targets[-1], tensors | decoder_of(model), {KEY: json.dumps(about, allow_nan=False)})

    def write_chapters(self, source: Chapters, target: Path) -> list[str]:
        """Write a long clip, one piece after another; returns what is lost, one clause each."""
        lost: dict[str, None] = {}

        def fit(model: GaussianModel) -> GaussianModel:
            fitted, clauses = self.fit(model)
            lost.update(dict.fromkeys(clauses))
            return fitted

        chaptered.write(source, target, self.loss, fit, self.progress or (lambda share: None))
        return list(lost)


def _header(file: TensorFile) -> tuple[dict, int, GaussianModel]:
    """The table in the metadata, the version of the format, and a model without Gaussians of the file's kinds."""
    if KEY not in file.metadata:
        raise FastGSError("it is a safetensors file, but not a FAST-GS model.")
    about = read_json(file.metadata[KEY])
    version = whole_number(about.get("version") if isinstance(about, dict) else None, "the version of its format")
    if version > chaptered.VERSION:
        raise FastGSError(f"a newer FAST-GS wrote it (format version {version}, this one reads up to {chaptered.VERSION}); "
                          "update FAST-GS for Blender.")
    if version not in (VERSION, COMPRESSED, chaptered.VERSION):
        raise FastGSError(f"its format version {version} was never released; make the file again from the model's source.")
    values = about.get("model")
    missing = [key for key in REQUIRED if not isinstance(values, dict) or key not in values]
    damaged_if(missing, f"its header says nothing about {', '.join(missing)}")
    entries = {key: value for key, value in about.items() if key != "compressed"}
    if version == COMPRESSED:
        entries["compressed"] = about.get("compressed", {})
    return entries, version, without_gaussians(understand(values))

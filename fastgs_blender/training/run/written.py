# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes the model of a run, and only one that can be read again: training that diverged has a reason to tell, and no model."""
import warnings
from pathlib import Path

from ... import formats
from ...model.chapters import Chapters
from ...model.gaussians import GaussianModel
from ...util.errors import FastGSError, LossWarning, printable
from ...util.outputs import writing


def write(model: GaussianModel | Chapters, path: Path) -> None:
    """Write a model, or a long clip, as .safetensors and read it; raises FastGSError where either fails, and what was at `path` stays."""
    with writing([path]) as (part,):
        try:
            formats.save(model, part)
            with warnings.catch_warnings():  # Gaussians that are left out are told to whoever opens the model
                warnings.simplefilter("ignore", LossWarning)
                for piece in getattr(formats.open_source(part), "pieces", ()):
                    piece.read()
        except FastGSError as error:
            raise FastGSError(str(error).replace(printable(str(part)), "the trained model")) from error

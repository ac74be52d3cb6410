# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes the model of an unfinished run from its last checkpoint."""
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...model.gaussians import GaussianModel
from ...model.surroundings import Surroundings
from ...util.errors import FastGSError
from ..core.anchor import backdrop_of
from ..core.model import empty_model, lasting, with_arrays
from ..core.settings import from_dict
from ..core.state import check_state, checked_clip
from . import checkpoint
from .files import CHECKPOINT, SEGMENTS, SO_FAR
from .written import write

VALUE = "optimiser.value."


def write_model(out: str | Path) -> Path:
    """Write the model of the run in a folder as it stands; returns its path.  Raises FastGSError where there is none yet.

    Of a long capture, which is trained in segments, it is the segment that is being trained.
    """
    out = Path(out)
    folders = [folder for folder in (out, *sorted((out / SEGMENTS).glob("*"))) if (folder / CHECKPOINT).exists()]
    if not folders:
        raise FastGSError(f"{out}: there is no checkpoint yet; wait until training has begun.")
    found = checkpoint.load(folders[-1])
    if found is None:
        raise FastGSError(f"{out}: its checkpoint has just been removed; look again in a moment.")
    try:
        model = model_of(*found)
    except FastGSError as error:
        raise FastGSError(f"{folders[-1] / CHECKPOINT}: {error}") from error
    write(model, out / SO_FAR)
    return out / SO_FAR


def model_of(arrays: dict[str, np.ndarray], about: dict) -> GaussianModel:
    """The model in a checkpoint, without the Gaussians that can never be seen; arguments as Trainer.state() gives them.

    Raises FastGSError where they are not those of a model.
    """
    settings, axes = from_dict(about.get("settings")), about.get("axes", "")
    empty = empty_model(settings, checked_clip(about.get("clip")), axes)
    check_state(arrays, about, empty, settings.iterations)
    values = {name.removeprefix(VALUE): array for name, array in arrays.items() if name.startswith(VALUE)}
    backdrop = backdrop_of(values, about["around"])
    return replace(lasting(with_arrays(empty, values)), surroundings=Surroundings(backdrop))

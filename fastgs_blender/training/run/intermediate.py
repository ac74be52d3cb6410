# SPDX-License-Identifier: GPL-3.0-or-later
"""The model of a run that is still going on, from its last checkpoint; without torch."""
from __future__ import annotations

from pathlib import Path

import numpy as np

from ... import formats
from ...model.gaussians import Clip, GaussianModel
from ...util.errors import FastGSError
from ..core.model import empty_model, lasting, with_arrays
from ..core.settings import from_dict
from . import checkpoint
from .session import SEGMENTS

NAME = "so-far.safetensors"
VALUE = "optimiser.value."


def write_model(out) -> Path:
    """Write the model of the run in a folder as it stands; returns its path.  Raises FastGSError where there is none yet.

    Of a long capture, which is trained in segments, it is the segment that is being trained.
    """
    out = Path(out)
    folders = [folder for folder in (out, *sorted((out / SEGMENTS).glob("*"))) if (folder / checkpoint.NAME).exists()]
    if not folders:
        raise FastGSError(f"{out}: there is no checkpoint yet; wait until training has begun.")
    arrays, about = checkpoint.load(folders[-1])
    model = model_of(arrays, about)
    formats.save(model, out / NAME)
    return out / NAME


def model_of(arrays: dict[str, np.ndarray], about: dict) -> GaussianModel:
    """The model in a checkpoint, without the Gaussians that can never be seen; arguments as Trainer.state() gives them."""
    if "clip" not in about:
        raise FastGSError("this checkpoint was written by an earlier version; it can be gone on with, but not looked at.")
    empty = empty_model(from_dict(about["settings"]), Clip(*about["clip"]), about["axes"])
    values = {name.removeprefix(VALUE): array for name, array in arrays.items() if name.startswith(VALUE)}
    return lasting(with_arrays(empty, values))

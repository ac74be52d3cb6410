# SPDX-License-Identifier: GPL-3.0-or-later
"""The column filter_3D in PLY files of Mip-Splatting and its descendants (Gaussian Opacity Fields, RaDe-GS).

filter_3D is the standard deviation f of a Gaussian that smooths each splat in space.  Their scene/gaussian_model.py draws scales
sqrt(s^2 + f^2) and opacities o sqrt(det before / det after); what is in the columns scale_* and opacity is s and o.
Their rasteriser adds kernel_size to the 2D covariance and compensates opacity for it, which is our `antialiased`.
"""
import warnings
from pathlib import Path

import numpy as np

from ..model.gaussians import Raster
from ..util.arguments import finite
from ..util.errors import FastGSError, LossWarning
from . import cfg_args
from .base import tell_left_out

COLUMN = "filter_3D"
KERNEL_SIZE = 0.1
"""Mip-Splatting's default, for files without a cfg_args."""
LARGEST_KERNEL = 100.0


def fused(columns: dict[str, np.ndarray], path: Path) -> Raster:
    """Fuse the column into `scale` [N, 3] and `opacity` [N] of `columns`, and give the rasteriser's constants; a LossWarning says so."""
    smooth = np.square(columns.pop(COLUMN).astype(np.float64))
    bad = ~np.isfinite(smooth[:, 0])
    if bad.any():
        if bad.all():
            raise FastGSError(f"no number in its column {COLUMN} is finite, so its Gaussians have no size; export the PLY again.")
        tell_left_out(path, bad, COLUMN)
        smooth = smooth[~bad]
        columns.update({name: array[~bad] for name, array in columns.items()})
    before, logit = columns["scale"].astype(np.float64), columns["opacity"].astype(np.float64)
    with np.errstate(all="ignore"):  # what is no number is found by usable()
        after = 0.5 * np.log(np.exp(2 * before) + smooth)
        after = np.where(smooth == 0, before, after)
        alpha = np.exp(np.minimum(-np.logaddexp(0, -logit) + (before - after).sum(1), 0))
        columns["opacity"] = np.where(smooth[:, 0] == 0, logit, np.log(alpha) - np.log1p(-alpha))
    columns["scale"] = after
    blur = _kernel_size(path)
    warnings.warn(LossWarning(f"{path}: its 3D smoothing filter (column {COLUMN}, Mip-Splatting) is fused into scales and opacities; it is "
                              f"shown antialiased, with a blur of {blur:g} square pixels."), stacklevel=4)
    return Raster(blur=blur, antialiased=True)


def _kernel_size(path: Path) -> float:
    """kernel_size of the training, where a cfg_args tells it."""
    file = cfg_args.find(path)
    try:
        said = cfg_args.read(file).get("kernel_size") if file else None
    except FastGSError:  # not the trainer's
        said = None
    good = isinstance(said, (int, float)) and finite(said) and 0 <= said <= LARGEST_KERNEL
    return float(said) if good else KERNEL_SIZE  # type: ignore[arg-type]

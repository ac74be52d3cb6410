# SPDX-License-Identifier: GPL-3.0-or-later
"""Static models as they are seen in a scene: at one moment, cropped, with their looks, where their objects stand, together as one."""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..model.appearance import SH_C0, Features
from ..model.gaussians import GaussianModel
from ..model.joining import concatenate
from ..model.slicing import freeze, sigmoid
from ..rendering.crops import crop_share
from ..rendering.instances import Instance
from ..rendering.looks import Look, graded, look_numbers, size_factor
from ..util import rotations
from ..util.errors import FastGSError
from .colour_spaces import in_colour_space
from .sampled import sampled
from .static import plain_harmonics
from .turning import turned

STEP = 1e-4
"""Of colours, to find how a look changes small differences."""


def as_seen(instances: list[Instance], antialiased: bool = False) -> tuple[GaussianModel, list[str]]:
    """One static model, in Blender's axes, of what the instances show, and one clause for everything that is lost on the way.

    antialiased: it is for files that say so; then the capture's sampling limit is a part of the Gaussians, where all instances know theirs
    Raises FastGSError where nothing is shown.
    """
    limited = antialiased and all(instance.captured.known or instance.model.raster.antialiased for instance in instances)
    parts, lost = [], {}
    for instance in instances:
        model, clauses = _seen(instance)
        if limited:
            model = sampled(model, instance.captured)
        lost |= dict.fromkeys(clauses)
        if len(model):
            parts.append(placed(model, instance.placement))
    if not parts:
        raise FastGSError("nothing is shown at this time; choose objects and a frame that show Gaussians.")
    if len({m.raster for m in parts}) > 1:
        lost |= {"that its objects were trained with different constants of the rasteriser": None}
    if len({m.colour_space for m in parts}) > 1:
        lost |= {"that some of its objects have linear colours, which become sRGB, as nearly as harmonics can hold it": None}
    return replace(together(parts), axes="RFU"), list(lost)


def _seen(instance: Instance) -> tuple[GaussianModel, list[str]]:
    """An instance's static model in its own space, with spherical harmonics."""
    settings, model = instance.settings, instance.model
    backdrop, lost = model.surroundings.backdrop, []
    keep = sigmoid(model.opacity) >= settings.opacity_cut
    if settings.backdrop == "HIDDEN" and backdrop is not None:
        keep &= backdrop.distance(model.position) <= 1
    if len(instance.hidden):
        keep &= ~instance.hidden
    model = freeze(model.take(keep), instance.t)
    share = crop_share(settings.crops, model.position)
    model, share = model.take(share > 0), share[share > 0]
    if isinstance(model.appearance, Features):
        lost.append("its features and decoder become one colour a Gaussian")
    model, _ = plain_harmonics(model, 4)
    row = look_numbers(settings, model.colour_space)
    size = np.exp(model.scale.astype(np.float64).max(1, initial=-np.inf)) if len(model) else np.zeros(0)
    opacity = np.clip(sigmoid(model.opacity) * row[Look.OPACITY] * share, 1e-7, 1 - 1e-7)
    model = replace(model, scale=model.scale + np.log(np.maximum(size_factor(size, row), 1e-9))[:, None],
                    opacity=np.log(opacity) - np.log1p(-opacity))
    if row[Look.GRADED]:
        model = replace(model, features=_graded_harmonics(model, row))
        if model.appearance.degree:
            lost.append("how looks change colours that differ with the view, beyond small differences")
    return model, lost


def _graded_harmonics(model: GaussianModel, row: np.ndarray) -> np.ndarray:
    """Coefficients whose mean colours are changed by a look exactly, and whose differences from these as small ones are."""
    coefficients = model.features.reshape(len(model), -1, 3).astype(np.float64)
    mean = np.maximum(0.5 + SH_C0 * coefficients[:, 0], 0)
    changed = graded(mean, row)
    slope = np.stack([(graded(mean + STEP * axis, row) - changed) / STEP for axis in np.eye(3)], -1)  # [N, to, from]
    out = np.einsum("ntf,nbf->nbt", slope, coefficients)
    out[:, 0] = (changed - 0.5) / SH_C0
    return out.reshape(model.features.shape)


def placed(model: GaussianModel, place: np.ndarray) -> GaussianModel:
    """The model moved, turned and scaled by a matrix [4, 4]; a scale that differs by axis becomes the Gaussians' own."""
    if np.array_equal(place, np.eye(4)) or not len(model):
        return model
    linear = place[:3, :3]
    left, sizes, right = np.linalg.svd(linear)
    if not sizes.min() > 1e-12 * max(sizes.max(), 1e-30):
        raise FastGSError("a transform flattens its Gaussians; give it a scale other than 0.")
    turn = left @ right
    out = replace(turned(replace(model, position=np.zeros_like(model.position)), turn), position=model.position @ linear.T + place[:3, 3],
                  surroundings=model.surroundings.moved(place))
    if np.allclose(sizes, sizes[0], rtol=1e-6):
        return replace(out, scale=model.scale + np.log(sizes.mean()))
    own = rotations.to_matrices(rotations.unit(model.rotation.astype(np.float64)))
    frame = linear @ (own * np.exp(model.scale.astype(np.float64))[:, None])
    frame[~np.isfinite(frame).all((1, 2))] = 0  # load() leaves these Gaussians out
    axes, lengths, _ = np.linalg.svd(frame)
    axes = axes * np.sign(np.linalg.det(axes))[:, None, None]
    return replace(out, rotation=rotations.from_matrices(axes), scale=np.log(lengths))


def together(models: list[GaussianModel]) -> GaussianModel:
    """One static model of several with spherical harmonics; those of a lower degree get zeros.

    Of several colour spaces it has sRGB, see colour_spaces.py.
    """
    if len({m.colour_space for m in models}) > 1:
        models = [in_colour_space(m, "srgb") for m in models]
    first = models[0]
    return concatenate([replace(m, axes=first.axes, raster=first.raster) for m in models])

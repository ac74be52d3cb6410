# SPDX-License-Identifier: GPL-3.0-or-later
"""Static models as they are seen in a scene: at one moment, cropped, with their looks, where their objects stand, together as one."""
from dataclasses import replace

import numpy as np

from ..model.appearance import SH_C0, Features, sh_basis
from ..model.gaussians import GaussianModel
from ..model.joining import concatenate
from ..model.parts import told_apart
from ..model.slicing import freeze, sigmoid
from ..rendering.colour import linear_to_srgb, srgb_to_linear
from ..rendering.crops import crop_share
from ..rendering.distance import BOX, Sampling
from ..rendering.instances import Instance
from ..rendering.looks import Look, graded, look_numbers, size_factor
from ..util import rotations
from ..util.errors import FastGSError
from .static import plain_harmonics
from .turning import turned

STEP = 1e-4
"""Of colours, to find how a look changes small differences."""
DIRECTIONS, CHUNK = 200, 1 << 11
"""In which colours are converted to another colour space, and Gaussians at a time."""


def as_seen(instances: list[Instance], antialiased: bool = False) -> tuple[GaussianModel, list[str]]:
    """One static model, in Blender's axes, of what the instances show, and one clause for everything that is lost on the way.

    Its parts are those of the objects that show something, by their names, where these are several.

    antialiased: it is for files that say so; then the capture's sampling limit is a part of the Gaussians, where all instances know theirs
    Raises FastGSError where nothing is shown.
    """
    limited = antialiased and all(instance.captured.known or instance.model.raster.antialiased for instance in instances)
    parts, names, lost = [], list[str](), dict[str, None]()
    for instance in instances:
        model, clauses = _seen(instance)
        if limited:
            model = sampled(model, instance.captured)
        lost |= dict.fromkeys(clauses)
        if len(model):
            parts.append(placed(model, instance.placement))
            names.append(instance.name)
    if not parts:
        raise FastGSError("nothing is shown at this time; choose objects and a frame that show Gaussians.")
    if any(instance.settings.takes_light for instance in instances):
        lost |= {"Scene Light; the captured colours are written": None}
    if len({m.raster for m in parts}) > 1:
        lost |= {"that its objects were trained with different constants of the rasteriser": None}
    if len({m.colour_space for m in parts}) > 1:
        lost |= {"that some of its objects have linear colours, which become sRGB, as nearly as harmonics can hold it": None}
    model, objects = together(parts), told_apart([(name, len(m)) for name, m in zip(names, parts, strict=True)])
    return replace(model, axes="RFU", parts=objects if objects.names else model.parts), list(lost)


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

    Of several colour spaces it has sRGB, see in_colour_space().
    """
    if len({m.colour_space for m in models}) > 1:
        models = [in_colour_space(m, "srgb") for m in models]
    first = models[0]
    return concatenate([replace(m, axes=first.axes, raster=first.raster) for m in models])


def sampled(model: GaussianModel, captured: Sampling) -> GaussianModel:
    """A static model with the capture's sampling limit (rendering/distance.py) in its Gaussians; as it is where it is antialiased already.

    For files that hold no cameras.  The blur b of training is split as Mip-Splatting does it: BOX is left to the viewer, and the rest,
    (b - BOX) p^2 for the usual pixel p of the capture's cameras, is added to each squared standard deviation.  The file says that it is
    antialiased.  Viewers that follow it (Mip-Splatting's mode: PlayCanvas, SuperSplat, Brush and others) then draw views in finer pixels
    as smooth as the capture was, and views in coarser ones as faint.  Their own blur is 0.3, not BOX: small pictures are softer than ours.
    """
    if model.raster.antialiased:
        return model
    pixel = captured.usual(model.position.astype(np.float64))
    variance = np.exp(2 * model.scale.astype(np.float64)) + max(model.raster.blur - BOX, 0.0) * pixel[:, None] ** 2
    return replace(model, scale=0.5 * np.log(variance),
                   raster=replace(model.raster, antialiased=True), surroundings=replace(model.surroundings, cameras=()))


def in_colour_space(model: GaussianModel, colour_space: str) -> GaussianModel:
    """The static model with the colours it shows in "srgb" or "linear".

    Colours that are the same from everywhere are exact.  Others are converted in DIRECTIONS directions, and the harmonics of the same
    degree that fit these best take their place.
    """
    if model.colour_space == colour_space:
        return model
    convert = linear_to_srgb if colour_space == "srgb" else srgb_to_linear
    height = np.linspace(-1, 1, DIRECTIONS + 2)[1:-1]
    angle = np.arange(DIRECTIONS) * np.pi * (3 - np.sqrt(5))  # a spiral over the sphere
    flat = np.sqrt(1 - height**2)
    basis = sh_basis(np.stack([flat * np.cos(angle), flat * np.sin(angle), height], 1), model.appearance.degree)
    fit = np.linalg.pinv(basis)
    features = np.empty_like(model.features)
    for start in range(0, len(model), CHUNK):
        rows = slice(start, start + CHUNK)
        coefficients = model.features[rows].reshape(len(model.features[rows]), -1, 3).astype(np.float64)
        shown = convert(np.maximum(0.5 + np.einsum("db,nbc->ndc", basis, coefficients), 0))
        features[rows] = np.einsum("bd,ndc->nbc", fit, shown - 0.5).reshape(len(coefficients), -1)
    return replace(model, features=features, colour_space=colour_space)

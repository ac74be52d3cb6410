# SPDX-License-Identifier: GPL-3.0-or-later
"""Functions that the formats of static Gaussians share: fitting a model to them, and codes of 8 to 11 bits."""
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..model.appearance import RGB, SH, SH_C0, Changing
from ..model.gaussians import GaussianModel, Raster
from ..model.slicing import sigmoid
from ..model.temporal import Always
from ..util import rotations
from ..util.errors import FastGSError
from ..util.reading import open_file
from .base import LIMIT, OPAQUE, Format
from .fitting import plain_colour
from .turning import with_axes

SQRT_HALF = np.sqrt(0.5)
FEWEST_BYTES = 1 / 32
"""Bytes that a Gaussian takes at least in a packed file: a header that claims more Gaussians is a lie or a bomb."""
SMALL = 1 << 16
"""So many Gaussians may be in a file of any length."""


class StaticFormat(Format):
    """A format of static Gaussians in the axes RDF.

    degree  the highest degree of spherical harmonics that it holds
    linear  whether it can say that colours are linear
    empty   whether there are files without Gaussians
    """

    degree = 3
    linear = False
    empty = False

    def fit(self, model: GaussianModel) -> tuple[GaussianModel, list[str]]:
        model, lost = static(model, self.name)
        if not len(model) and not self.empty:
            raise FastGSError(f"the model has no Gaussians, and {self.name} has no files of none.")
        model, clauses = plain_harmonics(model, self.degree)
        lost += clauses
        if model.raster.antialiased and not self.antialiased:
            lost.append("that it was trained antialiased (Mip-Splatting)")
        if replace(model.raster, antialiased=False) != Raster():
            lost.append("the rasteriser's constants that it was trained with (blur, bounds of alpha, near plane)")
        if model.colour_space == "linear" and not self.linear:
            lost.append("that its colours are linear, not sRGB")
        if model.provenance.keys() - {"source", "format"}:
            lost.append("its provenance")
        return model, lost


def static(model: GaussianModel, name: str) -> tuple[GaussianModel, list[str]]:
    """The model in the axes RDF without Gaussians that are not finite numbers, and clauses; refuses what changes over time."""
    changes = model.basis.terms or model.rotation_basis.terms or isinstance(model.appearance, Changing)
    if changes or not isinstance(model.temporal_kind, Always):
        raise FastGSError(f"the model changes over time and {name} cannot hold that; write one frame of it "
                          "(fastgs convert --at FRAME, or freeze(model, t)), or save it as .safetensors.")
    bad = np.zeros(len(model), bool)
    for key in ("position", "rotation", "scale", "opacity", "features"):
        array = getattr(model, key).reshape(len(model), -1) if len(model) else np.zeros((0, 1))
        bad |= np.isnan(array).any(1) if key in ("opacity", "scale") else ~(np.abs(array) <= LIMIT).all(1)
    lost = [f"{bad.sum()} Gaussians whose numbers are not finite"] if bad.any() else []
    model = model.take(~bad) if bad.any() else model
    limit = np.float32(np.log(LIMIT))
    model = replace(model, opacity=np.clip(model.opacity, -OPAQUE, OPAQUE), scale=np.clip(model.scale, -limit, limit))
    return with_axes(model, "RDF"), lost


def plain_harmonics(model: GaussianModel, degree: int) -> tuple[GaussianModel, list[str]]:
    """The model with spherical harmonics of at most this degree, and clauses."""
    lost: list[str] = []
    if not isinstance(model.appearance, (RGB, SH)):
        model, lost = plain_colour(model, keep_features=False)
    if isinstance(model.appearance, RGB):
        if len(model) and model.features.min() < 0:
            lost.append("its negative colours become 0")
        return replace(model, features=(model.features.astype(np.float64) - 0.5) / SH_C0, appearance=SH(0)), lost
    if model.appearance.degree > degree:
        lost.append(f"its spherical harmonics of degree {model.appearance.degree} are cut to degree {degree}")
        model = replace(model, features=model.features[:, :3 * (degree + 1) ** 2], appearance=SH(degree))
    return model, lost


def read_whole(path: Path, limit: int | None = None) -> bytes:
    """All bytes of a file, or its first `limit`."""
    with open_file(path) as stream:
        return stream.read() if limit is None else stream.read(limit)


def plausible_count(count: int, size: int) -> None:
    """Raises FastGSError where a packed file of `size` bytes cannot hold `count` Gaussians."""
    if count > SMALL + size / FEWEST_BYTES:
        raise FastGSError(f"its header promises {count} Gaussians, which a file of {size} bytes cannot hold; it is cut short or damaged, "
                          "so copy it again.")


def logits() -> np.ndarray:
    """The logits [256] of the opacities 0/255 .. 255/255; the ends stand for wholly transparent and opaque."""
    with np.errstate(divide="ignore"):
        level = np.arange(256) / 255
        return np.clip(np.log(level) - np.log1p(-level), -OPAQUE, OPAQUE)


def to_byte(values: np.ndarray) -> np.ndarray:
    """Whole numbers 0..255 nearest to values of any size, as u8."""
    return np.rint(np.clip(values, 0, 255)).astype(np.uint8)


def opacity_bytes(model: GaussianModel) -> np.ndarray:
    """Opacities [N] as u8, 255 is opaque."""
    return to_byte(sigmoid(model.opacity) * 255)


def largest_and_rest(rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The index [N] of each quaternion's largest component, and the other three [N, 3] in order, with that one positive."""
    q = rotations.unit(rotation.astype(np.float64))
    largest = np.abs(q).argmax(1)
    rows = np.arange(len(q))
    q = q * np.where(q[rows, largest] < 0, -1.0, 1.0)[:, None]
    keep = np.arange(4)[None] != largest[:, None]
    return largest, q[keep].reshape(-1, 3)


def with_largest(largest: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """The inverse of largest_and_rest(): unit quaternions [N, 4]."""
    out = np.empty((len(rest), 4))
    keep = np.arange(4)[None] != largest[:, None]
    out[keep] = rest.ravel()
    out[~keep] = np.sqrt(np.maximum(0, 1 - (rest**2).sum(1)))
    return out


def by_channel(features: np.ndarray) -> np.ndarray:
    """Coefficients above degree 0 [N, B - 1, 3] of features [N, 3 B] as INRIA's f_rest_* order them: [N, 3, B - 1]."""
    return features[:, 3:].reshape(len(features), features.shape[1] // 3 - 1, 3).transpose(0, 2, 1)


def from_channels(base: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """features [N, 3 B] of the coefficients of degree 0 [N, 3] and others [N, 3, B - 1] (channel by channel)."""
    return np.concatenate([base, rest.transpose(0, 2, 1).reshape(len(base), 3 * rest.shape[2])], 1)

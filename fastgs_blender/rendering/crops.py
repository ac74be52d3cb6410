# SPDX-License-Identifier: GPL-3.0-or-later
"""Crops: a Gaussian is drawn by how far its centre lies within the boxes, ellipsoids and closed meshes that leave or remove it."""
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..model.gaussians import GaussianModel
from ..model.slicing import opacities_at, positions_at
from ..util.errors import FastGSError
from ..util.rotations import transformed
from .volumes import Volume

BOX, SPHERE, VOLUME = range(3)
"""What kernels know a shape by: volumes have VOLUME + their place among the crops' volumes."""


@dataclass(frozen=True, eq=False)
class Crop:
    """A shape.  Shapes to keep add up; what lies in a shape to remove is gone, whatever keeps it.

    matrix  [4, 4] from the model's space to the shape's own, in which its bounds reach from -1 to 1 along each axis.  A matrix with
            NaN is that of a shape without an inside.
    remove  whether its inside is removed, rather than kept
    shape   "BOX", "SPHERE" (the ellipsoid within the bounds), or the Volume of a closed mesh
    soft    depth within the shape, by half of its extent, over which it begins to count: 0 is a sharp edge

    Example:
        look = fg.ObjectSettings(crops=(fg.Crop(np.eye(4), remove=True, shape="SPHERE"),))
    """

    matrix: np.ndarray
    remove: bool = False
    shape: str | Volume = "BOX"
    soft: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.soft < np.inf:
            raise FastGSError(f"the soft edge of a crop must be a number of 0 or more, not {self.soft!r}.")

    @cached_property
    def _key(self) -> tuple[bytes, bool, str, float]:
        shape = self.shape.digest if isinstance(self.shape, Volume) else self.shape
        return np.asarray(self.matrix, np.float64).tobytes(), bool(self.remove), shape, float(self.soft)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Crop) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def share(self, position: np.ndarray) -> np.ndarray:
        """How much positions [M, 3] in the model's space lie within the shape: [M], 0..1."""
        matrix = np.asarray(self.matrix, np.float64)
        x = transformed(position, matrix)
        if isinstance(self.shape, Volume):
            depth = self.shape.depth_at(x)
        else:
            depth = 1 - (np.sqrt((x * x).sum(1)) if self.shape == "SPHERE" else np.abs(x).max(1))
        if self.soft <= 0:
            return (depth >= 0).astype(np.float64)
        s = np.clip(np.nan_to_num(depth, nan=0.0) / self.soft, 0, 1)
        return s * s * (3 - 2 * s)


def crops_between(before: tuple[Crop, ...], after: tuple[Crop, ...], share: float) -> tuple[Crop, ...]:
    """The crops at a share of the way from one moment to the next: they go straight; all but their places is the nearer moment's."""
    near = before if share < 0.5 else after
    if before == after or len(before) != len(after):
        return near
    return tuple(replace(crop, matrix=(1 - share) * np.asarray(a.matrix) + share * np.asarray(b.matrix))
                 for crop, a, b in zip(near, before, after))


def crop_arrays(crops: Sequence[Crop]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What kernels take; shapes to keep come first.

    rows of the matrices [B, 3, 4] float64, remove [B] bool, kinds [B] int64 (BOX, SPHERE, VOLUME + place), soft [B] float64, and
    the volumes' depths [K, R, R, R] float32
    """
    ordered = sorted(crops, key=lambda crop: crop.remove)
    rows = np.array([np.asarray(crop.matrix, np.float64)[:3] for crop in ordered]).reshape(-1, 3, 4)
    volumes = {crop.shape.digest: crop.shape.depth for crop in ordered if isinstance(crop.shape, Volume)}
    place = {digest: VOLUME + number for number, digest in enumerate(volumes)}
    kinds = [place[crop.shape.digest] if isinstance(crop.shape, Volume) else SPHERE if crop.shape == "SPHERE" else BOX for crop in ordered]
    depths = np.stack(list(volumes.values())) if volumes else np.zeros((0, 2, 2, 2), np.float32)
    return (np.ascontiguousarray(rows), np.array([crop.remove for crop in ordered], bool), np.array(kinds, np.int64),
            np.array([crop.soft for crop in ordered], np.float64), depths)


def crop_share(crops: Sequence[Crop], position: np.ndarray) -> np.ndarray:
    """What the crops leave of the opacity of Gaussians at positions [M, 3] in the model's space: [M], 0..1."""
    keep = [crop for crop in crops if not crop.remove]
    share = np.zeros(len(position)) if keep else np.ones(len(position))
    for crop in keep:
        share = np.maximum(share, crop.share(position))
    for crop in crops:
        if crop.remove:
            share = share * (1 - crop.share(position))
    return share


def kept_by(crops: Sequence[Crop], position: np.ndarray) -> np.ndarray:
    """Which positions [M, 3] in the model's space the crops leave, wholly or in part: [M] bool."""
    return crop_share(crops, position) > 0


def cropped(model: GaussianModel, crops: Sequence[Crop], per_frame: int = 2) -> GaussianModel:
    """The model of those Gaussians that the crops leave at a moment at which they can be seen.

    Moments are taken from the whole clip, per_frame of them in each frame.  Soft edges become sharp where they end.
    """
    kept = np.zeros(len(model), bool)
    count = model.clip.frame_count * per_frame
    for t in np.arange(count) / count:
        at = np.flatnonzero((opacities_at(model, t) >= model.raster.alpha_cut) & ~kept)
        kept[at] = kept_by(crops, positions_at(model, t, at))
    return model.take(kept)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Format, the interface of a file format; usable(), the check that every loaded model passes."""
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..model.appearance import Features
from ..model.gaussians import GaussianModel
from ..model.sequence import Source
from ..util.errors import FastGSError, LossWarning
from ..util.threads import ranges, run
from ..util.version import VERSION

LIMIT = 1e18
"""Larger numbers than this are no scene: their squares leave float32."""
LIMITS = {"scale": float(np.log(LIMIT)), "mu_tau": 1e6}
"""Where the bound is another: logarithms, and times, which high powers are taken of."""
STEEP = 80.0
"""Logarithms of temporal widths are kept within +-STEEP: beyond it nothing changes but that exp() overflows."""
OPAQUE = 30.0
"""The logit that stands for an opacity of exactly 1 (sigmoid(30) is 1 in float32)."""


Loader = Callable[[Path], GaussianModel]


class Format:
    """One file format.  Errors carry no file name: load() and save() of the package put it in front.

    name        as users know it
    extensions  of the files it writes, lower case, with the dot
    magic       the first bytes of its files, where these tell
    reads       what file dialogs offer to read: extensions, lower case, with the dot, or whole names of files
    says_axes   whether the format, or each of its files, says which way is up
    antialiased whether it can say that the model is antialiased (Mip-Splatting)
    keeps_cameras  whether it holds the places of the capture's cameras
    keeps_parts    whether it holds the model's parts
    """

    name = ""
    extensions: tuple[str, ...] = ()
    reads: tuple[str, ...] = ()
    magic = b""
    says_axes = False
    antialiased = False
    keeps_cameras = False
    keeps_parts = False

    def sniff(self, head: bytes, path: Path) -> bool:
        """Whether the file is of this format, by its first bytes `head` and, where these do not tell, its header."""
        return bool(self.magic) and head.startswith(self.magic)

    def load(self, path: Path) -> GaussianModel:
        """The file's model; arrays may hold anything, finite or not.  Raises FastGSError."""
        raise NotImplementedError

    def open(self, path: Path, load: Loader) -> Source:
        """The file as a source: its model, or for a format of sequences a Sequence; load() reads another file whole."""
        return load(path)

    def suits(self, model: GaussianModel) -> bool:
        """Whether this format is the one for such a model, among those that share its extension."""
        return True

    def fit(self, model: GaussianModel) -> tuple[GaussianModel, list[str]]:
        """The model in the kinds that the format can hold, and one clause for everything that is lost on the way."""
        return model, []

    def losses(self, model: GaussianModel) -> list[str]:
        """What writing the model would lose, one clause each."""
        return self.fit(model)[1] + self.lost_cameras(model) + self.lost_parts(model)

    def lost_cameras(self, model: GaussianModel) -> list[str]:
        """A clause on the capture's cameras, where the format cannot hold those that the model knows."""
        if self.keeps_cameras or not model.surroundings.cameras:
            return []
        return ["the places of the capture's cameras are left out, so that Antialias ends with them"]

    def lost_parts(self, model: GaussianModel) -> list[str]:
        """A clause on the model's parts, where the format cannot hold them."""
        if self.keeps_parts or not model.parts.names:
            return []
        return [f"its parts ({', '.join(model.parts.names[:5])}{' ...' if len(model.parts) > 5 else ''}) become one"]

    def files(self, model: GaussianModel, path: Path) -> list[Path]:
        """All files that save() writes, companions first, `path` last."""
        return [path]

    def write(self, model: GaussianModel, targets: list[Path]) -> None:
        """Write a model that fit() returned to `targets`, which stand for files()."""
        raise NotImplementedError


def generator() -> str:
    """Name and version of this program, for the headers of files."""
    return f"FAST-GS for Blender {VERSION}"


def usable(model: GaussianModel, path: Path) -> GaussianModel:
    """The model without the Gaussians that cannot be computed with; a LossWarning says how many are left out.

    Left out are those with NaN, infinite or absurd (> 1e18) numbers.  Infinities that have a meaning stay, as the finite
    number that means the same: opaque (logit inf), flat (ln 0) and unchanging (ln of an infinite time).
    Raises FastGSError where nothing is left, and where the decoder, which all of them share, has absurd numbers.
    """
    if isinstance(model.appearance, Features) and max(np.abs(w).max() for w in (model.appearance.w1, model.appearance.w2)) > LIMIT:
        raise FastGSError(f"its decoder has weights above {LIMIT:.0e}; the training has probably diverged, so use an earlier checkpoint.")
    _tame(model)
    bad: dict[str, np.ndarray] = {}
    for name, array in model.arrays.items():
        mask = _unusable_rows(array, LIMITS.get(name, LIMIT))
        if mask is not None:
            bad[name] = mask
    if not bad:
        return model
    drop = np.logical_or.reduce(list(bad.values()))
    names = ", ".join(bad)
    if drop.all():
        raise FastGSError(f"none of its {len(model)} Gaussians can be used: numbers in their {names} are not finite; "
                          "the training has probably diverged, so use an earlier checkpoint.")
    tell_left_out(path, drop, names)
    return model.take(~drop)


def tell_left_out(path: Path, drop: np.ndarray, names: str) -> None:
    """LossWarning for the Gaussians [N] that are left out because of numbers in the columns of these names."""
    warnings.warn(LossWarning(f"{path}: {drop.sum()} of {len(drop)} Gaussians {'is' if drop.sum() == 1 else 'are'} left out, because "
                              f"numbers in their {names} are not finite."), stacklevel=4)


def require_sound(arrays: Mapping[str, np.ndarray], path: Path) -> None:
    """Raises FastGSError where usable() would leave out a row of arrays that go together."""
    for name, array in arrays.items():
        if _unusable_rows(array, LIMITS.get(name, LIMIT)) is not None:
            raise FastGSError(f"{path}: its {name} has numbers that are not finite or absurd; the training has probably diverged, so use "
                              "an earlier checkpoint.")


def _tame(model: GaussianModel) -> None:
    """Replace infinities that have a meaning, and steepness that cannot be told from a step."""
    model.opacity = _clipped(model.opacity, -OPAQUE, OPAQUE, only=np.isinf)
    model.scale = _clipped(model.scale, -np.log(LIMIT), np.inf, only=np.isneginf)
    if len(model):
        low = np.where(model.temporal_kind.logarithms, -STEEP, -np.inf).astype(np.float32)
        model.temporal = _clipped(model.temporal, low, -low)


def _clipped(array: np.ndarray, low: Any, high: Any, only: Any = None) -> np.ndarray:
    """The array with its values clipped; those alone for which only(values) holds.  The same array if nothing changes."""
    with np.errstate(invalid="ignore"):
        outside = (array < low) | (array > high)
    if only is not None:
        outside &= only(array)
    if not outside.any():
        return array
    return np.where(outside, np.clip(array, low, high), array).astype(np.float32)


def _unusable_rows(array: np.ndarray, limit: float) -> np.ndarray | None:
    """Mask [N] of rows with a value above limit, below -LIMIT or NaN; None if there is none.

    A few rows at a time, so that no temporary array is as large as the model.
    """
    n = len(array)
    flat = array.reshape(n, -1) if array.size else np.zeros((0, 0), np.float32)
    pieces = ranges(len(flat), max(1, (1 << 18) // max(1, flat.shape[1])))

    def bad(first: int, last: int) -> np.ndarray | None:
        part = flat[first:last]
        with np.errstate(invalid="ignore"):
            return None if part.max() <= limit and part.min() >= -LIMIT else ~((part <= limit) & (part >= -LIMIT)).all(1)

    found = run(bad, pieces)
    if all(part is None for part in found):
        return None
    mask = np.zeros(n, bool)
    for (first, last), part in zip(pieces, found, strict=True):
        mask[first:last] = False if part is None else part
    return mask

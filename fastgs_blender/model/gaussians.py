# SPDX-License-Identifier: GPL-3.0-or-later
"""GaussianModel: 4D Gaussians as a struct of arrays, and everything else that a file must record of them."""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from numbers import Integral
from typing import Any, ClassVar
from weakref import WeakSet

import numpy as np

from ..util.arguments import finite, in_words, numbers, one_of, shown
from ..util.errors import FastGSError
from ..util.threads import taken
from .appearance import APPEARANCES, RGB, Appearance
from .basis import MAX_TERMS
from .motion import Basis, Static
from .parts import Parts
from .surroundings import Surroundings
from .temporal import KINDS, Always, Radial, Window, WindowedRadial

AXES = ("RDF", "RFU", "RUB")
"""Where the world's x, y and z point: RDF = right, down, forward (COLMAP, INRIA); RFU = Blender (z up); RUB = OpenGL (y up)."""


@dataclass(frozen=True)
class Raster:
    """The rasteriser constants that a model was trained with.

    blur         added to the diagonal of the 2D covariance, in square pixels (gsplat's eps2d)
    alpha_max    upper bound of a splat's alpha at a pixel
    alpha_cut    a splat's alpha below this is not drawn
    near         Gaussians whose centre is not beyond this distance along the view axis are not drawn, in model units
    antialiased  opacity is scaled by sqrt(det before / det after blur) (Mip-Splatting)

    Example:
        raster = fg.Raster(near=0.01)
    """

    blur: float = 0.3
    alpha_max: float = 0.99
    alpha_cut: float = 1 / 255
    near: float = 0.2
    antialiased: bool = False

    def __post_init__(self) -> None:
        numbers = (self.blur, self.alpha_max, self.alpha_cut, self.near)
        good = (all(map(finite, numbers)) and isinstance(self.antialiased, (bool, np.bool_))
                and self.blur >= 0 and 0 < self.alpha_cut < 1 and 0 < self.alpha_max <= 1 and self.near >= 0)
        if not good:
            raise FastGSError(f"the rasteriser constants are out of range: {in_words(self)}.")


@dataclass(frozen=True)
class Clip:
    """The capture's time line: frame f (0 .. frame_count - 1) lies at t = f / frame_count.

    fps          frames per second of the capture
    start_frame  what the capture called its first frame
    free         whether it has no frame rate of its own, see sequence.FreeClip

    Example:
        clip = fg.Clip(frame_count=50, fps=25.0)
    """

    free: ClassVar[bool] = False
    frame_count: int = 1
    fps: float = 30.0
    start_frame: int = 0

    def __post_init__(self) -> None:
        whole = all(isinstance(v, Integral) for v in (self.frame_count, self.start_frame)) and abs(self.start_frame) <= 1_000_000_000
        if not (whole and 1 <= self.frame_count <= 10_000_000 and finite(self.fps) and self.fps > 0):
            raise FastGSError(f"a clip needs at least one frame and a positive frame rate, not {in_words(self)}.")

    @property
    def duration(self) -> float:
        """Length in seconds."""
        return self.frame_count / self.fps

    def t_of_frame(self, frame: float) -> float:
        """Model time of a frame counted from 0; fractions are sub-frames."""
        return frame / self.frame_count


@dataclass(eq=False)
class GaussianModel:
    """N 4D Gaussians.  Arrays are float32 and C-contiguous; K, R, P, F follow from the kinds below.

    position         [N, 3]     constant term of the motion (the paper's mu_base with A_0 folded in)
    rotation         [N, 4]     constant term of the quaternion, w x y z, normalised at use
    scale            [N, 3]     ln of the standard deviations along the Gaussian's axes
    opacity          [N]        logit of sigma_s
    features         [N, F]     see `appearance`
    motion           [N, K, 3]  coefficients of `basis`
    rotation_motion  [N, R, 4]  coefficients of `rotation_basis`, added to `rotation` before normalising
    mu_tau           [N]        temporal centre: of centred bases, of the time features, of Radial
    temporal         [N, P]     parameters of `temporal_kind`
    surroundings     backdrop, cameras of the capture, a good view
    parts            named selections of its Gaussians

    Optional arrays may be left out when their width is 0 (mu_tau: zeros).  Raises FastGSError where shapes disagree.

    Example:
        one = fg.GaussianModel(position=[[0, 0, 4]], rotation=[[1, 0, 0, 0]], scale=[[-1, -1, -1]], opacity=[2.0], features=[[1, 0, 0]])
    """

    position: np.ndarray
    rotation: np.ndarray
    scale: np.ndarray
    opacity: np.ndarray
    features: np.ndarray
    motion: np.ndarray = None  # type: ignore[assignment]
    rotation_motion: np.ndarray = None  # type: ignore[assignment]
    mu_tau: np.ndarray = None  # type: ignore[assignment]
    temporal: np.ndarray = None  # type: ignore[assignment]
    basis: Basis = field(default_factory=Static)
    rotation_basis: Basis = field(default_factory=Static)
    temporal_kind: Always | Radial | Window | WindowedRadial = field(default_factory=Always)
    appearance: Appearance = field(default_factory=RGB)
    raster: Raster = field(default_factory=Raster)
    clip: Clip = field(default_factory=Clip)
    axes: str = "RDF"
    colour_space: str = "srgb"
    provenance: dict[str, str] = field(default_factory=dict)
    surroundings: Surroundings = field(default_factory=Surroundings)
    parts: Parts = field(default_factory=Parts)

    def __post_init__(self) -> None:
        self._check_kinds()
        n = len(np.atleast_1d(self.position))
        for name, shape in self.shapes(n).items():
            value = getattr(self, name)
            if value is None and (0 in shape or name == "mu_tau"):
                value = np.zeros(shape, np.float32)
            if np.shape(value) != shape:
                raise FastGSError(f"the model's {name} must have the shape {shape}, not {np.shape(value)}.")
            setattr(self, name, np.ascontiguousarray(numbers(value, f"the model's {name}", str(shape), np.float32)))
        if self.parts.names and len(self.parts.bits) != n:
            raise FastGSError(f"the model's parts are of {len(self.parts.bits)} Gaussians, and it has {n}.")
        one_of(self.axes, "the model's axes", AXES)
        one_of(self.colour_space, "the model's colour space", ("srgb", "linear"))

    def _check_kinds(self) -> None:
        """The kernels take widths and codes from the kinds and read the arrays by them."""
        for basis in (self.basis, self.rotation_basis):
            if not isinstance(basis, Basis) or not 0 <= basis.terms <= MAX_TERMS:
                raise FastGSError(f"the model's basis of time must be a Basis of at most {MAX_TERMS} terms, not {basis!r}.")
            if (shape := np.shape(basis.weights(0.5))) != (basis.terms,):
                raise FastGSError(f"the basis of time {basis!r} has {basis.terms} terms but weights of the shape {shape} at one time.")
        if type(self.temporal_kind) not in KINDS.values():
            raise FastGSError(f"the model's temporal opacity must be one of {', '.join(KINDS)}, not {self.temporal_kind!r}.")
        if type(self.appearance) not in APPEARANCES.values():
            raise FastGSError(f"the model's appearance must be one of {', '.join(APPEARANCES)}, not {self.appearance!r}.")

    def shapes(self, n: int) -> dict[str, tuple[int, ...]]:
        """The shape of every array for n Gaussians of this model's kinds."""
        return {
            "position": (n, 3), "rotation": (n, 4), "scale": (n, 3), "opacity": (n,),
            "features": (n, self.appearance.width), "motion": (n, self.basis.terms, 3),
            "rotation_motion": (n, self.rotation_basis.terms, 4), "mu_tau": (n,),
            "temporal": (n, self.temporal_kind.width),
        }

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All arrays [N, ...] by name, of the shapes that the class lists."""
        return {name: getattr(self, name) for name in self.shapes(0)}

    def __len__(self) -> int:
        return len(self.position)

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(a.nbytes for a in self.arrays.values())

    def moment(self, t: float, hold: bool = False, read: bool = True) -> tuple[GaussianModel, float]:
        """The model to slice at t, and the time to slice it at: as of any source, see sequence.py."""
        return self, t

    def take(self, index: Any) -> GaussianModel:
        """The model of some of its Gaussians: a slice, indices [M] or a mask [N] bool.  Raises FastGSError for others."""
        chosen: Any = index if isinstance(index, slice) else np.asarray(index)
        if isinstance(chosen, np.ndarray) and chosen.size == 0:
            chosen = chosen.astype(np.intp)
        try:
            if isinstance(chosen, np.ndarray) and (chosen.ndim != 1 or chosen.dtype.kind not in "biu"):
                raise IndexError
            numbers = isinstance(chosen, np.ndarray) and chosen.dtype != bool
            arrays = list(self.arrays.values())
            rows = taken(arrays, chosen) if numbers else [a[chosen] for a in arrays]  # short rows are taken four times as fast
            fields: dict[str, Any] = dict(zip(self.arrays, rows, strict=True))
            return replace(self, **fields, parts=self.parts.take(chosen))
        except (IndexError, TypeError) as error:
            raise FastGSError(f"Gaussians are chosen by a slice, by numbers from 0 to {len(self) - 1} or by a mask [{len(self)}], not by"
                              f" {shown(index)}.") from error

    def __repr__(self) -> str:
        """Two lines: its size and its kinds."""
        motion, turn = (f"{basis.name} ({basis.terms} terms)" for basis in (self.basis, self.rotation_basis))
        return (f"GaussianModel: {len(self)} Gaussians, {self.nbytes / 1e6:.1f} MB, axes {self.axes}, {self.colour_space}, "
                f"{self.clip.frame_count} frames at {self.clip.fps:g} fps\n"
                f"    motion {motion}, rotation {turn}, opacity {self.temporal_kind.name}, appearance {self.appearance.name} "
                f"({self.appearance.width} numbers)")


_unchanging: WeakSet[GaussianModel] = WeakSet()


def unchanging(model: GaussianModel, declared: bool = False) -> bool:
    """Whether nobody changes the model's arrays, so that copies of them may be kept: because they are read-only, or because it was once
    declared here, as open_source() does."""
    if declared:
        _unchanging.add(model)
    return model in _unchanging or not any(array.flags.writeable for array in model.arrays.values() if array.size)

# SPDX-License-Identifier: GPL-3.0-or-later
"""bake() turns an animated mesh into 4D Gaussians, without training.

Flat Gaussians are spread evenly over the surface; each follows its place on it through all frames, and its path and turning
are written in a basis of time by least squares.
"""
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..model.filmed_from import BAKED
from ..model.gaussians import Clip, GaussianModel, Raster
from ..model.motion import Basis, Static
from ..util import rotations
from ..util.arguments import integer, numbers, real
from ..util.errors import FastGSError
from .bends import offset_paths, tangent_frames
from .colours import Colours, Painted
from .sampling import SurfaceSamples
from .trajectories import PROBES, WIDTH, MovingSurface, choose_paths, fit_paths, fit_turning

THICKNESS = 0.02
"""Standard deviation across the surface, as a share of the smaller one within it."""
CLOSED = Raster(near=0.01, blur=0.01, antialiased=True)
"""How Gaussians that close the surface by themselves are drawn.  Many lie one behind the other at an outline and are opaque together far
from their centres, so that the usual blur of 0.3 square pixels would make it half a pixel thicker on each side.  That hides what lies
behind, from Depth and Vector too.  With 0.05 the cover of an outline's pixels is too large by 0.36, with 0.01 by 0.22."""
SPECKLED = Raster(near=0.01)
"""How they are drawn where they do not, because a speckled texture has them narrow everywhere: the usual blur closes the gaps from afar."""
FULL = 0.75
"""Median area of the Gaussians, as a share of the usual one, from which they close the surface."""
GREY = (0.906, 0.906, 0.906)
"""sRGB of Blender's default, linear 0.8."""
OPAQUE = 0.99
"""Opacity of an opaque surface's Gaussians."""
FAR = 3.0
"""A largest distance of more than so many times the tolerance of the percentile is warned of: it is seen although it is rare."""


@dataclass(frozen=True)
class BakeReport:
    """The result of a bake in figures.

    gaussians                    number of Gaussians
    basis, rotation_basis        of positions and of quaternions, with the orders that were chosen
    band_limit                   highest frequency of motion that the basis holds, in Hz
    mean_residual, tail_residual, max_residual
                                 distance of the Gaussians from the places that they follow, over all given times, in the object's units:
                                 the mean, the 99th percentile, the largest
    size                         of the object (with several: of the one that is followed worst, as are the residuals)
    tolerance, tail_tolerance    of the mean and of the 99th percentile, as shares of the size
    turn_residual                mean error of the rotations, in degrees
    worst_triangle, worst_frame  where and when the distance is largest; frames count as the clip's do, from its start_frame
    worst_place                  that triangle in words

    Example:
        print(fg.bake(positions, triangles, count=100)[1])
    """

    gaussians: int
    basis: Basis
    rotation_basis: Basis
    band_limit: float
    mean_residual: float
    tail_residual: float
    max_residual: float
    size: float
    tolerance: float
    tail_tolerance: float
    turn_residual: float
    worst_triangle: int
    worst_frame: float
    worst_place: str

    @property
    def order(self) -> int:
        """Order of the basis; of a table of keyframes, how many there are; 0 where nothing moves."""
        return getattr(self.basis, "order", self.basis.terms)

    @property
    def reached(self) -> bool:
        """Whether the mean residual and the 99th percentile are within their tolerances."""
        return self.mean_residual <= self.tolerance * self.size and self.tail_residual <= self.tail_tolerance * self.size

    @property
    def worst(self) -> str:
        """Where, when and how far the Gaussians are off at most."""
        return f"{self.worst_place} on frame {self.worst_frame:g}, by {self._percent(self.max_residual)} of the object's size"

    @property
    def warning(self) -> str | None:
        """One sentence where a tolerance is not reached, or where a few places are far off, else None."""
        advice = "sample more times per frame, allow a higher order, or bake fewer frames at once."
        limit = f"with the highest order that is safe or allowed ({self.motion})"
        mean = (f"the motion is followed to {self._percent(self.mean_residual)} of the object's size instead of"
                f" {100 * self.tolerance:.3g} %") if self.mean_residual > self.tolerance * self.size else ""
        tail = (f"1 % of the Gaussians are off by more than {self._percent(self.tail_residual)} of the object's size instead of"
                f" {100 * self.tail_tolerance:.3g} %") if self.tail_residual > self.tail_tolerance * self.size else ""
        if mean or tail:
            return f"{' and '.join(filter(None, (mean, tail)))}, {limit}, worst at {self.worst}: {advice}"
        if self.max_residual > FAR * self.tail_tolerance * self.size:
            return f"a few Gaussians do not follow the motion, worst at {self.worst}: lower the tolerance of 99 %, or {advice}"
        return None

    def _percent(self, distance: float) -> str:
        return f"{100 * distance / self.size:.3g} %"

    @property
    def motion(self) -> str:
        """The basis in words."""
        if isinstance(self.basis, Static):
            return "no motion"
        return f"{self.basis.name} of order {self.order}, up to {self.band_limit:.3g} Hz" if self.band_limit else "straight motion"

    def __str__(self) -> str:
        if isinstance(self.basis, Static):
            return f"{self.gaussians:,} Gaussians, no motion, size {self.size:.3g}"
        return (f"{self.gaussians:,} Gaussians, {self.motion}, size {self.size:.3g}, off by {self._percent(self.mean_residual)} of it on "
                f"average, 99 % of them by at most {self._percent(self.tail_residual)}, worst at {self.worst}")


class Baked(NamedTuple):
    """A model of a mesh, and how well it follows that."""

    model: GaussianModel
    report: BakeReport


def bake(positions: np.ndarray, triangles: np.ndarray, colours: Any = GREY, *, frames: np.ndarray | None = None,
         frame_count: int | None = None, fps: float = 24.0, start_frame: int = 0, count: int = 100_000, tolerance: float = 0.005,
         tail_tolerance: float = 0.01, max_order: int = 0, basis: str = "auto", part: np.ndarray | None = None,
         patch: np.ndarray | None = None, samples: SurfaceSamples | None = None, provenance: dict[str, str] | None = None,
         progress: Callable[[float], None] | None = None) -> Baked:
    """4D Gaussians on an animated triangle mesh.

    positions    [S, V, 3]  the vertices in world space at S times
    triangles    [T, 3]     vertex indices, the same at all times
    colours      sRGB display values 0..1, with opacity as an optional fourth: one for all; [T, C] for the triangles;
                 [T, 3, C] for their corners; a function of (triangle [N], barycentric weights [N, 3]) -> [N, C], of which the
                 mean around each Gaussian is taken, on its side of an edge of colour; where samples are given, [N, C] is for these and
                 not for triangles; what surface_colours() returned
    frames       [S]        frame numbers of the times counted from the clip's first, increasing; default 0, 1, 2 ...
                            Fractions are welcome: half frames double what may safely be fitted
    frame_count  of the clip, default up to the last of `frames`; frame f lies at t = f / frame_count
    fps, start_frame  are recorded in the model's clip
    count        number of Gaussians (fully transparent places get none)
    tolerance    of the mean distance between a Gaussian and the place on the surface that it follows, by the object's size
                 (the largest side of its bounding box, the median over the times)
    tail_tolerance  of the 99th percentile of these distances, so that hands and feet are followed too
    max_order    of the basis; 0: what the number of times safely allows
    basis        "auto", "cosine", "fourier" (with a linear term), "paper" (Fourier of period 1), "keyframes"
    part         [T] a number for the object that each triangle belongs to, where several are baked together: each is held to
                 the tolerance of its own size
    patch        [T] a number for the area of one colour that each triangle belongs to: Gaussians keep to their side of its border,
                 as they do at sharp edges
    samples      where on the surface, if that is known already: surface_samples(positions, triangles, count)
    provenance   further facts to record in the model
    progress     called with 0..1 between pieces of work; what it raises cancels the bake and passes through

    The model is in Blender's axes (RFU), coloured in sRGB.  Raises FastGSError for input that describes no surface; warns
    (UserWarning) where the tolerance is not reached.

    Example:
        baked, report = fg.bake(positions, triangles, colours=(0.8, 0.3, 0.1), count=1000)
    """
    progress = progress or (lambda share: None)
    surface, frames, frame_count = _checked(positions, triangles, frames, frame_count, part, patch)
    for name, value in (("tolerance", tolerance), ("tolerance of the 99th percentile", tail_tolerance)):
        if not real(value, f"the {name}") > 0:
            raise FastGSError(f"the {name} must be positive, not {value}.")
    given = samples is not None
    samples = _spread(surface, count) if samples is None else samples
    progress(0.15)
    painted = colours if isinstance(colours, Painted) else surface.painted(colours, samples, given)
    visible = painted.rgba[:, 3] >= 1 / 255
    if not visible.any():
        raise FastGSError("everything is fully transparent: there is nothing to bake.")
    samples, painted = SurfaceSamples(samples.triangle[visible], samples.weights[visible], samples.spacing), painted.take(visible)
    progress(0.25)

    t = frames / frame_count
    paths = fit_paths(surface, samples, t, 1 / frame_count, basis, tolerance, tail_tolerance, max_order, lambda x: progress(0.25 + 0.4 * x))
    turning = fit_turning(surface, samples, painted, t, not isinstance(paths.basis, Static), max_order, lambda x: progress(0.65 + 0.25 * x))
    tilt, offset = tangent_frames(surface, samples, turning, t)
    progress(0.95)
    position, motion = offset_paths(surface, samples, paths, offset, t)
    sigma = np.c_[turning.width, THICKNESS * turning.width.min(1)]
    alpha = OPAQUE * np.clip(painted.rgba[:, 3], 0, 1)
    closed = np.median(turning.width.prod(1)) > FULL * (WIDTH * samples.spacing) ** 2
    model = GaussianModel(
        position=position, motion=motion, basis=paths.basis,
        rotation=rotations.multiply(turning.constant[turning.row], tilt),
        rotation_motion=rotations.multiply(turning.coefficients[turning.row], tilt[:, None]),
        rotation_basis=turning.basis, scale=np.log(sigma), opacity=np.log(alpha / (1 - alpha)),
        features=painted.rgba[:, :3], raster=CLOSED if closed else SPECKLED, clip=Clip(frame_count, fps, start_frame), axes="RFU",
        provenance={"source": BAKED, **(provenance or {})},
    )
    triangle = int(samples.triangle[paths.sample])
    report = BakeReport(
        gaussians=len(model), basis=paths.basis, rotation_basis=turning.basis,
        band_limit=paths.basis.max_frequency * fps / frame_count, mean_residual=paths.mean, tail_residual=paths.tail,
        max_residual=paths.largest, size=float(surface.sizes[paths.part]), tolerance=tolerance, tail_tolerance=tail_tolerance,
        turn_residual=float(np.degrees(turning.residual)), worst_triangle=triangle, worst_frame=start_frame + float(frames[paths.time]),
        worst_place=f"triangle {triangle}" + (f" of part {part[triangle]}" if part is not None else ""))
    if report.warning:
        warnings.warn(report.warning, stacklevel=2)
    return Baked(model, report)


def followed(positions: np.ndarray, triangles: np.ndarray, *, frames: np.ndarray, frame_count: int, tolerance: float = 0.005,
             tail_tolerance: float = 0.01, max_order: int = 0, basis: str = "auto", part: np.ndarray | None = None) -> bool:
    """Whether a bake() of these arguments would keep to its tolerances, judged by few places; if not, more times per frame may help."""
    surface, frames, frame_count = _checked(positions, triangles, frames, frame_count, part)
    t = frames / frame_count
    return choose_paths(surface, surface.spread(PROBES), t, 1 / frame_count, basis, tolerance, tail_tolerance, max_order)[1]


def surface_samples(positions: np.ndarray, triangles: np.ndarray, count: int = 100_000) -> SurfaceSamples:
    """The places on an animated surface (as for bake()) that get a Gaussian: evenly spread, dense enough where it is stretched."""
    return _spread(_checked(positions, triangles)[0], count)


def _spread(surface: MovingSurface, count: int) -> SurfaceSamples:
    return surface.spread(integer(count, "the number of Gaussians", 1, 50_000_000))


def _checked(positions: Any, triangles: Any, frames: Any = None, frame_count: int | None = None, part: Any = None,
             patch: Any = None) -> tuple[MovingSurface, np.ndarray, int]:
    """The surface, its frame numbers [S] and the clip's length; FastGSError where they do not fit together."""
    positions, triangles = numbers(positions, "positions", "(times, vertices, 3)", np.float32), np.asarray(triangles)
    if positions.ndim != 3 or positions.shape[2] != 3 or not len(positions):
        raise FastGSError(f"positions must have the shape (times, vertices, 3), not {positions.shape}.")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or not np.issubdtype(triangles.dtype, np.integer):
        raise FastGSError(f"triangles must be whole numbers of the shape (triangles, 3), not {triangles.shape} of {triangles.dtype}.")
    if not len(triangles):
        raise FastGSError("there are no faces to bake.")
    if triangles.min() < 0 or triangles.max() >= positions.shape[1]:
        raise FastGSError(f"the triangles refer to vertices outside 0..{positions.shape[1] - 1}.")
    if not np.isfinite(positions).all():
        raise FastGSError("some vertex positions are not finite numbers.")
    frames = np.arange(len(positions), dtype=np.float64) if frames is None else numbers(frames, "frames", "(times,)")
    if frames.shape != (len(positions),) or not np.isfinite(frames).all() or not (np.diff(frames) > 0).all():
        raise FastGSError("frames must be increasing numbers, one for each time at which positions are given.")
    if frame_count is None:
        frame_count = max(int(np.floor(frames[-1])), 0) + 1
    frame_count = integer(frame_count, "the number of frames of the clip", 1, 10_000_000)
    surface = MovingSurface(positions, triangles.astype(np.int64), _numbers("part", part, triangles), _numbers("patch", patch, triangles))
    if not surface.areas.any():
        raise FastGSError("the faces have no area in any frame: there is no surface to bake.")
    return surface, frames, frame_count


def _numbers(name: str, values: Any, triangles: Any) -> np.ndarray:
    if values is None:
        return np.zeros(len(triangles), np.int64)
    if np.shape(values) != (len(triangles),):
        raise FastGSError(f"{name} must give one number for each of the {len(triangles)} triangles.")
    return np.unique(np.asarray(values), return_inverse=True)[1]


def surface_colours(colours: Colours, positions: np.ndarray, triangles: np.ndarray, samples: SurfaceSamples) -> Painted:
    """The colours of the samples as bake() computes them, opacity and edges of colour included; bake() takes them back, changed or not."""
    return _checked(positions, triangles)[0].painted(colours, samples, True)

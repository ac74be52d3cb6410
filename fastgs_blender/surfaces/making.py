# SPDX-License-Identifier: GPL-3.0-or-later
"""make_mesh(): the surface of a model as a mesh whose vertices move as the model's Gaussians do."""
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ..model.filmed_from import BAKED, directions
from ..model.gaussians import GaussianModel
from ..util.arguments import integer, real, shown
from ..util.errors import FastGSError
from .carrying import carry
from .carving import carved
from .opening import opened
from .views import VIEWS, filmed_side, render_views, subject_of

LEAST = 0.01
"""Share of the surface that a piece must have; smaller ones are taken for floaters."""
MOST_TIMES = 257
"""At which paths are computed; on half frames where these are no more than a quarter of it."""
PRECISE = 1e-4
"""Root mean squared distance, as a share of the size, to which shapes give the paths."""
TEARS = 0.02
"""Share of its area that may be torn before a mesh is made anew: torn faces become large, and show as sails."""
CAUTION = 0.75
"""Share of the time that a mesh holds, after which the next one is made: it then has to hold both ways."""
MOST_MESHES = 12
"""Beyond so many, a mesh goes on although it tears."""


@dataclass(frozen=True, eq=False)
class MovingMesh:
    """A mesh of one topology that moves: at a time t its vertices are  rest + sum_r curve_r(t) shape_r.

    quads      [Q, 4]     vertex numbers; normals point outwards
    rest       [V, 3]     the vertices when it was made
    shapes     [R, V, 3]  differences from these
    times      [S]        of the model, increasing, at which the curves are known; between them they are cubic.  It is made for the
                          times from the first to the last
    curves     [S, R]     how much of each shape, within -1..1
    colours    [V, 3]     in the model's colour space, as seen from straight before the surface
    made       the time at which it was made
    closed     whether it has an inside; otherwise it is what was filmed

    Example:
        mesh = fg.make_mesh(model, t=0.25, detail=48)[0]
        vertices = mesh.at(0.3)
    """

    quads: np.ndarray
    rest: np.ndarray
    shapes: np.ndarray
    times: np.ndarray
    curves: np.ndarray
    colours: np.ndarray
    made: float
    closed: bool = True

    @property
    def slopes(self) -> np.ndarray:
        """How fast the curves change at their times [S, R]; between two times they are the cubic of these slopes (Catmull-Rom)."""
        return np.gradient(self.curves, self.times, axis=0) if len(self.times) > 1 else np.zeros_like(self.curves)

    def at(self, t: float) -> np.ndarray:
        """The vertices [V, 3] float64 at a time; before the first and after the last they stand still."""
        t = float(np.clip(t, self.times[0], self.times[-1]))
        k = int(np.clip(np.searchsorted(self.times, t) - 1, 0, max(len(self.times) - 2, 0)))
        weights, slopes = self.curves[k], self.slopes
        if len(self.times) > 1:
            span = self.times[k + 1] - self.times[k]
            u = (t - self.times[k]) / span
            weights = ((1 + 2 * u) * (1 - u) ** 2 * self.curves[k] + u * u * (3 - 2 * u) * self.curves[k + 1]
                       + span * u * (1 - u) * ((1 - u) * slopes[k] - u * slopes[k + 1]))
        return self.rest + np.tensordot(weights, self.shapes, 1)


def make_mesh(model: GaussianModel, t: float = 0.0, *, detail: int = 160, closed: bool | None = None, smoothing: int = 2,
              progress: Callable[[float], Any] | None = None) -> list[MovingMesh]:
    """The surface of a model's subject at a time t, as a mesh that the Gaussians around it carry through the clip.

    It is one mesh, unless more than TEARS of its area tears: there it is made anew.  All meshes are in the order of their times.

    detail     voxels along the subject's longest side; a face is about as large as one
    closed     whether the surface has no holes; otherwise it is left out where no camera of the capture saw it, as far as the file knows
               these, or nobody can see it.  None: it is open if the cameras stood on one side, because nobody knows the others
    smoothing  how often the surface is averaged with its neighbourhood, 0 or more
    progress   called with 0..1 between pieces of work; what it raises stops the work and passes through

    Raises FastGSError where nothing is there, for arguments out of range, and for a sequence, whose Gaussians have no motion.

    Example:
        mesh = fg.make_mesh(model, t=0.25, detail=48)[0]
        print(len(mesh.rest), "vertices", len(mesh.quads), "faces")
    """
    if not isinstance(model, GaussianModel):
        raise FastGSError(f"a mesh is made of a model whose Gaussians move, as fg.load(path) reads it, not of {shown(model)}.")
    t, detail = real(t, "the time of a model"), integer(detail, "the detail", 8, 1024)
    smoothing = integer(smoothing, "the smoothing", 0, 1000)
    progress = progress or (lambda share: None)
    times = np.union1d(times_of(model), np.clip(t, 0, (model.clip.frame_count - 1) / model.clip.frame_count))
    waiting, found = [(0, len(times), int(np.abs(times - t).argmin()))], list[MovingMesh]()
    while waiting:
        begin, end, at = waiting.pop()
        done = begin / len(times) if found else 0.0
        limit = TEARS if len(found) + 1 < MOST_MESHES else np.inf
        mesh = _made(model, times[at], times[begin:end], detail, closed, smoothing, limit,
                     partial(lambda done, share: progress(done + (1 - done) * share), done))
        found.append(mesh)
        closed = found[0].closed  # those that are made anew later are like the first one
        first, last = np.searchsorted(times, mesh.times[[0, -1]])
        if last + 1 < end:  # the next one is made where it probably holds back to here
            waiting.append((last + 1, end, last + 1 + _inside(end - last - 1, last - at)))
        if first > begin:
            waiting.append((begin, first, first - 1 - _inside(first - begin, at - first)))
    return sorted(found, key=lambda mesh: mesh.times[0])


def _inside(count: int, reach: int) -> int:
    """How many of `count` times beyond a seam the next mesh is made, where the one before it holds over `reach` times."""
    return min(int(CAUTION * reach), count // 2)


def times_of(model: GaussianModel) -> np.ndarray:
    """The times at which paths are computed: whole frames, half ones of a short clip, fewer of a long one."""
    last = model.clip.frame_count - 1
    count = 2 * last + 1 if 8 * last < MOST_TIMES else min(last + 1, MOST_TIMES)
    return np.linspace(0, last, count) / model.clip.frame_count


def _made(model: GaussianModel, t: float, times: np.ndarray, detail: int, closed: bool | None, smoothing: int, limit: float,
          progress: Callable[[float], Any]) -> MovingMesh:
    """The mesh that is made at a time t, for as many of the times around it as it does not tear."""
    subject = subject_of(model, t)
    side = None if closed else filmed_side(model, subject)
    closed = bool(closed or (closed is None and (side is None or model.provenance.get("source") == BAKED)))
    views = render_views(subject, directions(VIEWS) if closed or side is None else side, detail, lambda share: progress(0.4 * share))
    surface = carved(subject, views, detail, smoothing, LEAST, lambda share: progress(0.4 + 0.2 * share))
    if not closed:
        surface = opened(surface, model, subject, subject.size / detail, LEAST)
    if not len(surface.quads):
        raise FastGSError("no surface was found: what is there is too faint or too small; choose another frame or more detail.")
    paths = carry(model, t, surface.vertices, surface.quads, subject.size / detail, times, limit, lambda share: progress(0.6 + 0.4 * share))
    shapes, curves = _shapes(paths.places, surface.vertices, PRECISE * subject.size)
    return MovingMesh(surface.quads, surface.vertices.astype(np.float32), shapes, paths.times, curves,
                      surface.colours.astype(np.float32), float(t), closed)


def _shapes(paths: np.ndarray, rest: np.ndarray, precise: float) -> tuple[np.ndarray, np.ndarray]:
    """(shapes [R, V, 3] float32, curves [S, R]) whose products are the paths [S, V, 3] without `rest`: as few as are precise enough.

    They are principal components.  Whatever moves the Gaussians, limbs that swing and cloth that waves need ten or twenty.
    """
    off: np.ndarray = (paths - rest.astype(np.float32)).reshape(len(paths), -1)
    values, vectors = np.linalg.eigh((off @ off.T).astype(np.float64))
    values, vectors = np.maximum(values[::-1], 0), vectors[:, ::-1]
    missed = np.append(values[::-1].cumsum()[::-1], 0) / (len(paths) * len(rest))
    count = int(np.argmax(missed <= precise**2))
    curves = vectors[:, :count]
    largest = np.abs(curves).max(0, initial=1e-30)
    return ((curves * largest).T.astype(np.float32) @ off).reshape(count, len(rest), 3), curves / largest

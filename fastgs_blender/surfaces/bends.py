# SPDX-License-Identifier: GPL-3.0-or-later
"""Lays flat Gaussians where a surface bends so that they fit all of what they cover, and not only the triangle under their middle.

Where faces meet at a blunt angle a Gaussian on one of them would stick out beyond the other.  Many do so behind one another at an outline,
and hide what is beside it.
"""
import numpy as np

from ..model.fitting import Fit
from ..util import rotations
from ..util.threads import ranges, run
from .borders import SHARP
from .sampling import SurfaceSamples, lengths, near_pairs, triangle_normals
from .trajectories import CHUNK, WIDTH, MovingSurface, Paths, Turning

REACH = 2.5
"""Standard deviations of a Gaussian of the usual width within which its neighbours lie on the surface that it covers."""
TIMES = 3
"""Number of times whose bends are averaged."""
UNEVEN = 1e-3
"""Height over a Gaussian, as a share of the samples' spacing, that a neighbour on the same surface may have although that does not bend."""


def tangent_frames(surface: MovingSurface, samples: SurfaceSamples, turning: Turning, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(tilt [N, 4], normal offset [N]): the turn in its own axes, and the way along its normal, that make each Gaussian the plane which
    fits the surface under it best.

    The surface is known by the samples that lie there: their mean normal and mean height count, weighted by the Gaussian's density.  These
    are means over a few of the times t [S] as well, because a Gaussian keeps its tilt and its offset.
    """
    n, (position, normal) = len(samples), _places(surface, samples, surface.pose)
    near = _neighbours(position, normal, samples.spacing)
    axes = _axes(turning, t[surface.pose])[:, :2]
    pairs, total = [], np.ones(n)
    for i, j in (near, near[::-1]):
        offset = position[j] - position[i]
        away = [np.einsum("pd,pd->p", axes[i, k], offset) / turning.width[i, k] for k in range(2)]
        pairs.append((i, j, np.exp(-0.5 * (away[0] ** 2 + away[1] ** 2))))
        total += np.bincount(i, pairs[-1][2], n)

    def mean(values: np.ndarray) -> np.ndarray:
        """Of values [N, D], over each sample and its neighbours."""
        found = [own + sum(np.bincount(i, weight * own[j], n) for i, j, weight in pairs) for own in np.ascontiguousarray(values.T)]
        return np.stack(found, 1) / total[:, None]

    times = np.unique(np.linspace(0, len(t) - 1, TIMES).astype(int))
    centre, facing = np.zeros((n, 3)), np.zeros((n, 3))
    for s in times:
        (position, normal), axes = _places(surface, samples, s), _axes(turning, t[s])
        centre += np.einsum("nkd,nd->nk", axes, mean(position) - position) / len(times)
        facing += np.einsum("nkd,nd->nk", axes, mean(normal))
    facing /= np.maximum(lengths(facing), 1e-30)[:, None]
    x, y, z = np.where(facing[:, 2:] > SHARP, facing, [0, 0, 1]).T
    return rotations.unit(np.stack([1 + z, -y, x, np.zeros(n)], 1)), centre[:, 2] + (x * centre[:, 0] + y * centre[:, 1]) / z


def offset_paths(surface: MovingSurface, samples: SurfaceSamples, paths: Paths, offset: np.ndarray,
                 t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The paths' constants [N, 3] and coefficients [N, K, 3] of samples that are so far along the normals of their triangles."""
    fit, constant, coefficients = Fit.of(paths.basis, t), paths.constant.copy(), paths.coefficients.copy()

    def piece(start: int, stop: int) -> None:
        used, row = np.unique(samples.triangle[start:stop], return_inverse=True)
        normal = np.moveaxis(fit.coefficients(_normals(surface.corners(used))), 0, 1)
        moved = normal[row] * offset[start:stop, None, None]
        constant[start:stop] += moved[:, 0]
        coefficients[start:stop] += moved[:, 1:]

    run(piece, ranges(len(samples), max(CHUNK // (12 * len(t)), 64)))
    return constant, coefficients


def _neighbours(position: np.ndarray, normal: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Pairs i, j of samples that are near to each other on one surface: one that bends by so much can lie so high over the other."""
    i, j = near_pairs(position, None, REACH * WIDTH * spacing)
    cosine = np.einsum("nd,nd->n", normal[i], normal[j])
    i, j, cosine = (each[cosine > SHARP] for each in (i, j, cosine))
    offset = position[j] - position[i]
    height = np.abs(np.einsum("nd,nd->n", offset, normal[i]))
    one = height <= np.sqrt(np.maximum(1 - cosine**2, 0)) * lengths(offset) + UNEVEN * spacing
    return i[one], j[one]


def _places(surface: MovingSurface, samples: SurfaceSamples, time: int) -> tuple[np.ndarray, np.ndarray]:
    """Places and normals [N, 3] of the samples."""
    corners = surface.corners(samples.triangle, time)
    return np.einsum("nkd,nk->nd", corners, samples.weights), _normals(corners)


def _normals(corners: np.ndarray) -> np.ndarray:
    """Unit normals [..., 3] of triangles with corners [..., 3 corners, 3]; 0 where they have no area."""
    normal = triangle_normals(corners)
    return normal / np.maximum(lengths(normal), 1e-30)[..., None]


def _axes(turning: Turning, t: float) -> np.ndarray:
    """The Gaussians' axes at a time as the rows of matrices [N, 3, 3]."""
    turned = turning.basis.value(turning.coefficients, t, np.zeros(len(turning.constant)))
    return rotations.to_matrices(rotations.unit(turning.constant + turned)).transpose(0, 2, 1)[turning.row]

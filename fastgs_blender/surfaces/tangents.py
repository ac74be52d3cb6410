# SPDX-License-Identifier: GPL-3.0-or-later
"""Computes tangent frames of moving triangles: the rotation and the size of a flat Gaussian on a surface."""
from dataclasses import dataclass

import numpy as np

from ..util import rotations
from .sampling import lengths, triangle_normals


@dataclass(frozen=True, eq=False)
class Tangents:
    """U frames on triangles at S times.

    rotation [S, U, 4]  unit quaternions w x y z of the frame whose x follows a fixed direction of the material and whose z is
                        the normal; without jumps of sign in time
    stretch  [U, 2]     by how much the material is stretched at most along the frame's x and y, 1 in the pose of reference
    """

    rotation: np.ndarray
    stretch: np.ndarray


def tangents(corners: np.ndarray, pose: int, along: np.ndarray | None = None, which: np.ndarray | None = None) -> Tangents:
    """U frames on triangles with corners [S, T, 3 corners, 3]; `pose` is the index of the time of reference.

    along [U, 3]: the direction in that pose which x shall follow; where it is 0, that in which the material is stretched most.
    which [U]: the triangle of each frame; default: each triangle has one.
    Where a triangle has no area it keeps the frame that it has at the nearest other time before, else after.
    """
    corners = np.asarray(corners, np.float64)
    which = np.arange(corners.shape[1]) if which is None else which
    edges = corners[:, :, 1:] - corners[:, :, :1]
    normal = triangle_normals(corners)
    double_area = lengths(normal)
    axes, inverse, flat = plane(edges[pose])
    turned = _most_stretched(edges, inverse)[which]
    if along is not None:
        wanted = np.einsum("uad,ud->ua", axes[which], along)
        length = np.linalg.norm(wanted, axis=1, keepdims=True)
        turned = np.where(length > 0, wanted / np.where(length > 0, length, 1), turned)
    direction = np.where(flat[which, None], [1.0, 0.0], np.einsum("ukm,um->uk", inverse[which], turned))

    # A triangle's own frame has x along its first edge.  The frames that are asked for are turned against it within its plane.
    first = lengths(edges[:, :, 0])
    valid = (double_area > 1e-12 * double_area.max(initial=0.0)) & (first > 0)
    base = edges[:, :, 0] / np.where(valid, first, 1)[..., None]
    z = normal / np.where(valid, double_area, 1)[..., None]
    own = rotations.from_matrices(np.stack([base, np.cross(z, base), z], -1))
    second = np.stack([np.einsum("std,std->st", base, edges[:, :, 1]), double_area / np.where(valid, first, 1)])
    x, y = direction[:, 0] * first[:, which] + direction[:, 1] * second[0][:, which], direction[:, 1] * second[1][:, which]
    length = np.hypot(x, y)
    area_ratio = (double_area / np.where(flat, 1.0, double_area[pose]))[:, which]
    stretch = np.stack([length, np.divide(area_ratio, length, out=np.zeros_like(length), where=length > 0)], -1).max(0)
    cosine = np.divide(x, length, out=np.ones_like(x), where=length > 0)
    c, s = np.sqrt(np.maximum(1 + cosine, 0) / 2), np.copysign(np.sqrt(np.maximum(1 - cosine, 0) / 2), y)
    w, i, j, k = np.moveaxis(own[:, which], -1, 0)
    q = _fill(np.stack([w * c - k * s, i * c + j * s, j * c - i * s, k * c + w * s], -1), valid[:, which])
    return Tangents(rotations.one_sign(q), np.where(flat[which, None], 1.0, stretch))


def plane(edges: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(axes, inverse, flat) of the planes of triangles with edges [U, 2, 3].

    axes     [U, 2, 3]  unit vectors
    inverse  [U, 2, 2]  from coordinates along the axes to factors of the two edges
    flat     [U]        whether the triangle has no area
    """
    a, b = edges[:, 0], edges[:, 1]
    length = np.linalg.norm(a, axis=-1)
    x = a / np.where(length > 0, length, 1)[:, None]
    bx = np.einsum("ud,ud->u", b, x)
    rest = b - bx[:, None] * x
    by = np.linalg.norm(rest, axis=-1)
    flat = (length <= 0) | (by <= 1e-9 * length)
    inverse = np.zeros((len(a), 2, 2))  # of [[length, bx], [0, by]]
    inverse[:, 0, 0] = 1 / np.where(flat, 1, length)
    inverse[:, 1, 1] = 1 / np.where(flat, 1, by)
    inverse[:, 0, 1] = -bx * inverse[:, 0, 0] * inverse[:, 1, 1]
    return np.stack([x, rest / np.where(flat, 1, by)[:, None]], 1), inverse, flat


def _most_stretched(edges: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """The unit direction [U, 2] in the plane of reference that is stretched most at any time."""
    deformed = np.einsum("ukm,sukd->sumd", inverse, edges)
    c = np.einsum("sumd,sund->sumn", deformed, deformed)  # right Cauchy-Green tensor
    half, difference = 0.5 * (c[..., 0, 0] + c[..., 1, 1]), 0.5 * (c[..., 0, 0] - c[..., 1, 1])
    when = (half + np.hypot(difference, c[..., 0, 1])).argmax(0)
    u = np.arange(len(inverse))
    angle = 0.5 * np.arctan2(c[when, u, 0, 1], difference[when, u])
    return np.stack([np.cos(angle), np.sin(angle)], -1)


def _fill(q: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Quaternions [S, U, 4]; where not valid [S, U] those of the nearest valid time before, else after, else none at all."""
    if valid.all():
        return q
    times = np.arange(len(q))[:, None]
    before = np.maximum.accumulate(np.where(valid, times, -1), 0)
    first = np.where(valid.any(0), valid.argmax(0), -1)
    source = np.where(before >= 0, before, first)
    filled = np.take_along_axis(q, np.maximum(source, 0)[..., None], 0)
    return np.where(source[..., None] >= 0, filled, [1.0, 0, 0, 0])

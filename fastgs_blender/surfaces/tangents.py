# SPDX-License-Identifier: GPL-3.0-or-later
"""Computes tangent frames of moving triangles: the rotation and the size of a flat Gaussian on a surface."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..util import rotations
from .sampling import triangle_normals


@dataclass(frozen=True, eq=False)
class Tangents:
    """U triangles at S times.

    rotation [S, U, 4]  unit quaternions w x y z of the frame whose x follows a fixed direction of the material and whose z is
                        the normal; without jumps of sign in time
    stretch  [U, 2]     by how much the material is stretched at most along the frame's x and y, 1 in the pose of reference
    """

    rotation: np.ndarray
    stretch: np.ndarray


def tangents(corners: np.ndarray, pose: int, along: np.ndarray | None = None) -> Tangents:
    """Frames of triangles with corners [S, U, 3 corners, 3]; `pose` is the index of the time of reference.

    along [U, 3]: the direction in that pose which x shall follow; where it is 0, that in which the material is stretched most.
    Where a triangle has no area it keeps the frame that it has at the nearest other time before, else after.
    """
    corners = np.asarray(corners, np.float64)
    edges = corners[:, :, 1:] - corners[:, :, :1]
    normal = triangle_normals(corners)
    double_area = np.linalg.norm(normal, axis=-1)
    axes, inverse, flat = plane(edges[pose])
    turned = _most_stretched(edges, inverse)
    if along is not None:
        wanted = np.einsum("uad,ud->ua", axes, along)
        length = np.linalg.norm(wanted, axis=1, keepdims=True)
        turned = np.where(length > 0, wanted / np.where(length > 0, length, 1), turned)
    direction = np.where(flat[:, None], [1.0, 0.0], np.einsum("ukm,um->uk", inverse, turned))
    x = np.einsum("uk,sukd->sud", direction, edges)
    length = np.linalg.norm(x, axis=-1)
    valid = (double_area > 1e-12 * double_area.max(initial=0.0)) & (length > 0)
    area_ratio = double_area / np.where(flat, 1.0, double_area[pose])
    stretch = np.stack([length, np.divide(area_ratio, length, out=np.zeros_like(length), where=length > 0)], -1).max(0)
    x = x / np.where(valid, length, 1)[..., None]
    z = normal / np.where(valid, double_area, 1)[..., None]
    q = _fill(rotations.from_matrices(np.stack([x, np.cross(z, x), z], -1)), valid)
    return Tangents(rotations.one_sign(q), np.where(flat[:, None], 1.0, stretch))


def plane(edges: np.ndarray):
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


def _most_stretched(edges, inverse):
    """The unit direction [U, 2] in the plane of reference that is stretched most at any time."""
    deformed = np.einsum("ukm,sukd->sumd", inverse, edges)
    c = np.einsum("sumd,sund->sumn", deformed, deformed)  # right Cauchy-Green tensor
    half, difference = 0.5 * (c[..., 0, 0] + c[..., 1, 1]), 0.5 * (c[..., 0, 0] - c[..., 1, 1])
    when = (half + np.hypot(difference, c[..., 0, 1])).argmax(0)
    u = np.arange(len(inverse))
    angle = 0.5 * np.arctan2(c[when, u, 0, 1], difference[when, u])
    return np.stack([np.cos(angle), np.sin(angle)], -1)


def _fill(q, valid):
    """Quaternions [S, U, 4]; where not valid [S, U] those of the nearest valid time before, else after, else none at all."""
    if valid.all():
        return q
    times = np.arange(len(q))[:, None]
    before = np.maximum.accumulate(np.where(valid, times, -1), 0)
    first = np.where(valid.any(0), valid.argmax(0), -1)
    source = np.where(before >= 0, before, first)
    filled = np.take_along_axis(q, np.maximum(source, 0)[..., None], 0)
    return np.where(source[..., None] >= 0, filled, [1.0, 0, 0, 0])

# SPDX-License-Identifier: GPL-3.0-or-later
"""Rotations as unit quaternions w x y z and as matrices, in float64; the kernels have the same formulas, fused.

A quaternion and its negative are the same rotation.  Products read from right to left, like those of matrices.
"""
import numpy as np
from numpy.typing import ArrayLike


def unit(q: np.ndarray) -> np.ndarray:
    """Normalised quaternions [..., 4]; one that vanishes becomes the identity, NaN stays NaN."""
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    vanishing = norm <= 1e-12
    return np.where(vanishing, [1.0, 0, 0, 0], q / np.where(vanishing, 1, norm))


def to_matrices(q: np.ndarray) -> np.ndarray:
    """Rotation matrices [..., 3, 3] of unit quaternions [..., 4]."""
    return np.stack(elements(q), -1).reshape(*np.shape(q)[:-1], 3, 3)


def elements(q: np.ndarray) -> list[np.ndarray]:
    """The nine elements [...] of the rotation matrices of unit quaternions [..., 4], row by row."""
    w, x, y, z = np.moveaxis(np.asarray(q, np.float64), -1, 0)
    return [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]


def transform(linear: ArrayLike, shift: ArrayLike = (0, 0, 0)) -> np.ndarray:
    """The matrix [4, 4] that applies a matrix [3, 3], such as a rotation, and then moves by a shift [3]."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, shift
    return matrix


def transformed(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Points [..., 3] by a matrix [4, 4]."""
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def from_matrices(matrices: np.ndarray) -> np.ndarray:
    """Unit quaternions [..., 4] with w >= 0 of rotation matrices [..., 3, 3].

    Of the four equivalent formulas each matrix gets the one with the largest divisor (Shepperd 1978).
    """
    m = np.asarray(matrices, np.float64)
    d = np.stack([m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]], -1)
    trace = d.sum(-1, keepdims=True)
    squares = np.concatenate([1 + trace, 1 - trace + 2 * d], -1)  # 4 w^2, 4 x^2, 4 y^2, 4 z^2
    s, p = m - np.swapaxes(m, -1, -2), m + np.swapaxes(m, -1, -2)
    wx, wy, wz = s[..., 2, 1], s[..., 0, 2], s[..., 1, 0]
    xy, xz, yz = p[..., 0, 1], p[..., 0, 2], p[..., 1, 2]
    w2, x2, y2, z2 = np.moveaxis(squares, -1, 0)
    rows = np.stack([np.stack(r, -1) for r in ((w2, wx, wy, wz), (wx, x2, xy, xz), (wy, xy, y2, yz), (wz, xz, yz, z2))], -2)
    q = np.take_along_axis(rows, squares.argmax(-1)[..., None, None], -2)[..., 0, :]
    q = q / np.maximum(np.linalg.norm(q, axis=-1, keepdims=True), 1e-30)
    return np.where(q[..., :1] < 0, -q, q)


def one_sign(q: np.ndarray) -> np.ndarray:
    """The same rotations [S, ..., 4]: of q and -q always the one nearer to its predecessor along the first axis."""
    turns = np.where((q[1:] * q[:-1]).sum(-1) < 0, -1.0, 1.0)
    return q * np.concatenate([np.ones_like(turns, shape=(1, *turns.shape[1:])), turns]).cumprod(0)[..., None]


def multiply(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Products [..., 4] of quaternions: first q turns, then p."""
    pw, pv, qw, qv = p[..., :1], p[..., 1:], q[..., :1], q[..., 1:]
    return np.concatenate([pw * qw - (pv * qv).sum(-1, keepdims=True), pw * qv + qw * pv + np.cross(pv, qv)], -1)


def inverse(q: np.ndarray) -> np.ndarray:
    """Inverses [..., 4] of unit quaternions."""
    return q * [1, -1, -1, -1]


def log(q: np.ndarray) -> np.ndarray:
    """Half the rotation vectors [..., 3], in radians, of unit quaternions [..., 4]."""
    v = q[..., 1:]
    norm = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.arctan2(norm, q[..., :1]) * np.divide(v, norm, out=np.zeros_like(v), where=norm > 1e-15)


def exp(v: np.ndarray) -> np.ndarray:
    """Unit quaternions [..., 4] of half rotation vectors [..., 3] in radians: they turn about v by 2 |v|."""
    angle = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle), np.sinc(angle / np.pi) * v], -1)


def slerp(p: np.ndarray, q: np.ndarray, share: np.ndarray | float) -> np.ndarray:
    """Quaternions [..., 4] on the great arc from p to q (Shoemake 1985); share [..., 1] or a number: 0 gives p, 1 gives q."""
    return multiply(p, exp(share * log(multiply(inverse(p), q))))

# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes of quads: their edges, the neighbours of their vertices, normals, and separate pieces."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..util.backends import load_backend


@dataclass(frozen=True, eq=False)
class Mesh:
    """What is to be known of V vertices and quads [Q, 4], apart from where the vertices are.

    edges         [E, 2]  pairs of vertices, each once
    first, other  the neighbours of vertex v are other[first[v]:first[v + 1]]
    """

    quads: np.ndarray
    edges: np.ndarray
    first: np.ndarray
    other: np.ndarray

    @staticmethod
    def of(quads: np.ndarray, count: int) -> Mesh:
        """That of quads on so many vertices."""
        edges = edges_of(quads)
        first = np.append(0, np.bincount(edges.ravel(), minlength=count).cumsum())
        return Mesh(quads, edges, first, edges[:, ::-1].ravel()[np.argsort(edges.ravel(), kind="stable")])

    def smoothed(self, values: np.ndarray, rounds: int = 1, share: float = 0.5) -> np.ndarray:
        """Values [V] or [V, D] of which, so many times, a share is replaced by the mean of the neighbours'."""
        return load_backend("cpu").smoothed(values.reshape(len(values), -1), self.first, self.other, rounds, share).reshape(values.shape)

    def normals(self, x: np.ndarray) -> np.ndarray:
        """Unit normals [V, 3] of the vertices at x [V, 3]."""
        return normals(x, self.quads)

    def sides(self, x: np.ndarray) -> np.ndarray:
        """The lengths [Q, 4] of the quads' sides where the vertices are at x [V, 3]."""
        corners = x[self.quads]
        way = np.roll(corners, -1, 1) - corners
        return np.sqrt(np.einsum("qsd,qsd->qs", way, way))

    def areas(self, x: np.ndarray) -> np.ndarray:
        """The areas [Q] of the quads where the vertices are at x [V, 3]."""
        return 0.5 * np.linalg.norm(area_vectors(x, self.quads), axis=1)

    def pieces(self) -> np.ndarray:
        """For each vertex the least number of a vertex to which edges lead from it [V]."""
        label, some = np.arange(len(self.first) - 1), self.first[:-1] < self.first[1:]
        while True:
            new = label.copy()
            new[some] = np.minimum(label[some], np.minimum.reduceat(label[self.other], self.first[:-1][some]))
            new = new[new]
            if np.array_equal(new, label):
                return label
            label = new


def edges_of(quads: np.ndarray) -> np.ndarray:
    """The edges of quads [Q, 4], each once: pairs of vertices [E, 2]."""
    pairs = np.sort(np.stack([quads, np.roll(quads, -1, 1)], -1).reshape(-1, 2), 1).astype(np.int64)
    both = np.unique(pairs[:, 0] << 32 | pairs[:, 1])
    return np.stack([both >> 32, both & 0xFFFFFFFF], 1)


def area_vectors(x: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Normals [Q, 3] of quads on vertices [V, 3], as long as twice their areas."""
    return np.cross(x[quads[:, 2]] - x[quads[:, 0]], x[quads[:, 3]] - x[quads[:, 1]])


def normals(x: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Unit normals [V, 3] of vertices [V, 3]: the sums of their quads' area vectors."""
    total = np.stack([np.bincount(quads.ravel(), np.repeat(column, 4), len(x)) for column in area_vectors(x, quads).T], 1)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)

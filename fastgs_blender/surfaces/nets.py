# SPDX-License-Identifier: GPL-3.0-or-later
"""Surface nets: the surface on which a volume of distances is 0, as quads (Gibson 1998; "naive" form).

A vertex lies in each cell of 2 x 2 x 2 points whose signs differ, at the mean of the places where the cell's edges cross 0.  Each edge
between points of different signs is crossed by a quad of the vertices of the four cells around it.  So all quads are about as large as a
voxel, and the surface is closed wherever the volume is.
"""
import itertools

import numpy as np

CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))
EDGES = [(a, b) for a, b in itertools.combinations(range(8), 2) if np.abs(CORNERS[a] - CORNERS[b]).sum() == 1]


def surface_net(volume: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(vertices [V, 3] in units of the volume's points, quads [Q, 4]) of a volume [X, Y, Z]; normals point to where it is positive."""
    inside = volume < 0
    count = np.zeros(np.array(volume.shape) - 1, np.int8)
    for corner in CORNERS:
        count += _corner(inside, corner)
    cells = np.argwhere((count > 0) & (count < 8))
    values = np.stack([volume[tuple((cells + corner).T)] for corner in CORNERS], 1).astype(np.float64)
    total, crossings = np.zeros((len(cells), 3)), np.zeros(len(cells))
    for a, b in EDGES:
        crosses = (values[:, a] < 0) != (values[:, b] < 0)
        share = np.where(crosses, values[:, a] / np.where(crosses, values[:, a] - values[:, b], 1), 0)
        total += crosses[:, None] * (CORNERS[a] + share[:, None] * (CORNERS[b] - CORNERS[a]))
        crossings += crosses
    number = np.full(count.shape, -1, np.int32)
    number[tuple(cells.T)] = np.arange(len(cells))
    quads = []
    for axis in range(3):
        step = np.eye(3, dtype=int)[axis]
        first, second = np.eye(3, dtype=int)[[(axis + 1) % 3, (axis + 2) % 3]]
        low = inside[tuple(slice(None if axis != k else -1) for k in range(3))]
        high = inside[tuple(slice(1 if axis == k else 0, None) for k in range(3))]
        edge = np.argwhere(low != high)
        edge = edge[(edge[:, [(axis + 1) % 3, (axis + 2) % 3]] > 0).all(1)
                    & (edge[:, [(axis + 1) % 3, (axis + 2) % 3]] < np.array(count.shape)[[(axis + 1) % 3, (axis + 2) % 3]]).all(1)]
        around = np.stack([number[tuple((edge - shift).T)] for shift in (first + second, second, 0 * step, first)], 1)
        outwards = inside[tuple(edge.T)]
        quads.append(np.where(outwards[:, None], around, around[:, ::-1]))
    return cells + total / crossings[:, None], np.concatenate(quads)


def _corner(values: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """The values at one corner of each cell."""
    return values[tuple(slice(c, c - 1 or None) for c in corner)]

# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds where a splat object's model lies in the object's own space, so that Blender's operators act on splats as on any mesh.

Every point of an object's proxy mesh knows its place in the model's space: an attribute, which no operator changes.  Operators that
change the mesh (Apply, Set Origin, Mirror and transforms in Edit Mode) move the points in the object's space.  The affine map between
both is where the model lies.  Nothing else is stored, so undo, copies and libraries need no care.
"""
import threading

import numpy as np

from ..fastgs_blender.util import rotations
from . import arrays

PLACE = "Model Position"
"""Attribute of a proxy's vertices: where they lie in the model's space."""
TOLERANCE = 1e-5
"""Distance, as a share of the points' extent, up to which a point counts as being where the map puts it."""
ROUNDS = 10
SOME = 400
"""So many vertices say where a model lies; all of them lie alike."""

_known: dict[int, np.ndarray] = {}
"""The last map of each mesh, for meshes whose points have been deleted, by the mesh's session_uid."""


def model_matrix(obj) -> np.ndarray:
    """[4, 4] float64 from the model's space to the object's; the identity where a mesh does not know (meshes of one's own)."""
    mesh = obj.original.data
    if obj.type != 'MESH' or mesh is None:
        return np.eye(4)
    pairs = _edited(mesh) if mesh.is_editmode else _stored(mesh)
    if pairs is None:
        return _known.get(mesh.session_uid, np.eye(4))
    some = _some(len(pairs[0]))
    found = affine(pairs[0][some], pairs[1][some])
    if found is None:
        return _known.get(mesh.session_uid, np.eye(4))
    _known[mesh.session_uid] = found
    return found


def placement(obj, world=None) -> np.ndarray:
    """[4, 4] float64 from the model's space to the world, by the object's matrix or that of an instance."""
    return np.array(obj.matrix_world if world is None else world, np.float64) @ model_matrix(obj)


def write(mesh, place: np.ndarray, matrix: np.ndarray) -> None:
    """Give a mesh's vertices their places in the model's space [M, 3], and put them where `matrix` [4, 4] maps these."""
    if mesh.attributes.get(PLACE) is not None:
        mesh.attributes.remove(mesh.attributes[PLACE])
    mesh.attributes.new(PLACE, 'FLOAT_VECTOR', 'POINT').data.foreach_set("vector", place.astype(np.float32).ravel())
    mesh.vertices.foreach_set("co", rotations.transformed(place, matrix).astype(np.float32).ravel())
    _known[mesh.session_uid] = np.array(matrix, np.float64)


def set_model_matrix(obj, matrix: np.ndarray) -> None:
    """Put the model elsewhere in the object's space: its points follow, the object itself stays where it is."""
    pairs = _stored(obj.data)
    if pairs is not None:
        write(obj.data, pairs[0], matrix)
        obj.data.update()


def misplaced(mesh) -> bool:
    """Whether single points were moved: not all of them lie where the map puts them."""
    pairs = _stored(mesh)
    found = None if pairs is None else affine(*pairs)
    return found is not None and bool((_away(*pairs, found) > 10 * _slack(pairs[1])).any())


def affine(place: np.ndarray, at: np.ndarray) -> np.ndarray | None:
    """[4, 4] that maps `place` [M, 3] to `at` [M, 3] for most of the points; None where they do not determine it.

    Least squares, and again over the better half while single points lie elsewhere.  Numbers are rounded where the rounded
    ones are as good, so that an unmoved model is drawn with exactly the matrix that it had.
    """
    use, found = np.arange(len(place)), None
    for _ in range(ROUNDS):
        found = _least_squares(place[use], at[use])
        if found is None:
            return None
        away = _away(place, at, found)
        if (away <= _slack(at)).all():
            break
        better = np.sort(np.argsort(away, kind="stable")[:len(place) // 2 + 1])
        if np.array_equal(better, use):
            break
        use = better
    rounded = np.round(found, 5)
    good = _away(place[use], at[use], rounded).max() <= max(1e-6 * _extent(at), 2 * _away(place[use], at[use], found).max())
    return rounded if good else found


def _some(count: int) -> np.ndarray:
    """Numbers of vertices from the first to the last, and the last four, which are the corners of the proxy's box."""
    return np.unique(np.r_[np.linspace(0, count - 1, SOME), np.arange(max(count - 4, 0), count)].round().astype(int))


def _least_squares(place, at):
    middle, extent = place.mean(0), _extent(place)
    known = np.c_[(place - middle) / extent, np.ones(len(place))].astype(np.float64)
    if len(place) < 4 or np.linalg.matrix_rank(known.T @ known, tol=1e-9) < 4:
        return None
    solved = np.linalg.solve(known.T @ known, known.T @ at.astype(np.float64)).T
    out = rotations.transform(solved[:, :3] / extent)
    out[:3, 3] = solved[:, 3] - out[:3, :3] @ middle
    return out


def _away(place, at, matrix):
    return np.abs(rotations.transformed(place.astype(np.float64), matrix) - at).max(1)


def _extent(points) -> float:
    return max(float(np.ptp(points, axis=0).max()), 1e-30)


def _slack(at) -> float:
    return TOLERANCE * _extent(at) + 1e-6 * float(np.abs(at).max())


def _stored(mesh):
    """(places [M, 3], positions [M, 3]) of a mesh's vertices; None where it has none."""
    attribute, count = mesh.attributes.get(PLACE), len(mesh.vertices)
    if attribute is None or attribute.domain != 'POINT' or not count or len(attribute.data) != count:
        return None
    return arrays.read(attribute.data, "vector", np.float32, 3), arrays.points(mesh)


def _edited(mesh):
    """(places, positions) of some vertices of a mesh in Edit Mode.  Only the main thread may read them; other threads get what it has
    read."""
    if threading.current_thread() is not threading.main_thread():
        return None
    import bmesh

    edited = bmesh.from_edit_mesh(mesh)
    layer = edited.verts.layers.float_vector.get(PLACE)
    if layer is None or not len(edited.verts):
        return None
    edited.verts.ensure_lookup_table()
    some = [edited.verts[i] for i in _some(len(edited.verts))]
    return np.array([v[layer] for v in some], np.float32), np.array([v.co for v in some], np.float32)

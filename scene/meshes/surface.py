# SPDX-License-Identifier: GPL-3.0-or-later
"""Records the evaluated surface of objects, frame by frame, as arrays: rigs, shape keys and modifiers are applied."""
from dataclasses import dataclass, field

import bpy
import numpy as np

from ...fastgs_blender.surfaces.borders import welded
from ...fastgs_blender.surfaces.sampling import SurfaceSamples
from ...fastgs_blender.util.errors import FastGSError
from ...fastgs_blender.util.rotations import transformed
from .. import arrays
from ..frame_range import go_to
from ..objects import MESHABLE, is_splat

SIMULATED = {'CLOTH', 'SOFT_BODY', 'FLUID', 'DYNAMIC_PAINT', 'PARTICLE_SYSTEM', 'EXPLODE', 'OCEAN'}
"""Modifiers that can be evaluated on whole frames only, or must be played from their first frame."""


@dataclass(eq=False)
class Piece:
    """One object, or one instance of it, as it was found first.

    owner       name of the object that the user selected
    vertices    how many
    loops       vertex of each face corner: its topology
    triangles   [T, 3] vertices; corners [T, 3] loops; material [T] slot
    materials   of the slots, None where a slot is empty
    normals     of the corners as shaded [L, 3], world space, on that frame
    uv          maps by name [L, 2], and the name of the one that renders by default
    colours     colour attributes by name [L, 4], scene linear
    """

    owner: str
    vertices: int
    loops: np.ndarray
    triangles: np.ndarray
    corners: np.ndarray
    material: np.ndarray
    materials: list
    normals: np.ndarray
    uv: dict[str, np.ndarray] = field(default_factory=dict)
    default_uv: str = ""
    colours: dict[str, np.ndarray] = field(default_factory=dict)


class Recorder:
    """Follows the surfaces of objects through the frames of a scene.

    pieces      what was found on the first frame, in a fixed order
    positions   one array [V, 3] float32, world space, for each recorded time, in the order of recording
    """

    def __init__(self, context, objects: list[bpy.types.Object]):
        self._context = context
        self._owners = {obj.name for obj in objects}
        self._first = 0.0
        self._keys: list[tuple] = []
        self.pieces: list[Piece] = []
        self.positions: list[np.ndarray] = []
        self._times: list[float] = []

    def record(self, frame: float) -> None:
        """Go to a frame, whole or not, and add its surface.  Raises FastGSError where it is not the surface of the first frame."""
        go_to(self._context.scene, frame)
        found = {}
        depsgraph = self._context.evaluated_depsgraph_get()
        for instance in depsgraph.object_instances:
            owner = (instance.parent if instance.is_instance else instance.object).original
            obj = instance.object
            if owner.name not in self._owners or obj.type not in MESHABLE or is_splat(obj.original):
                continue
            key = (owner.name, obj.original.name, tuple(instance.persistent_id) if instance.is_instance else ())
            found[key] = self._measure(obj, owner.name, np.array(instance.matrix_world), key, frame)
        if not self.positions:
            self._first = frame
            self._keys = list(found)
            if not found:
                raise FastGSError(f"the selected objects have no surface on frame {frame:g}; select objects that have faces.")
        missing = set(self._keys) ^ set(found)
        if missing:
            raise FastGSError(f'"{min(missing)[0]}" has not the same parts on frame {frame:g} as on frame {self._first:g}: a surface '
                              "that appears or vanishes cannot be followed; bake a range of frames in which it does not.")
        self.positions.append(np.concatenate([found[key] for key in self._keys]))
        self._times.append(frame)

    def sort(self) -> None:
        """Put the positions into the order of their times."""
        order = np.argsort(self._times)
        self.positions, self._times = ([values[i] for i in order] for values in (self.positions, self._times))

    def _measure(self, obj, owner, matrix, key, frame):
        if not np.isfinite(matrix).all():
            raise FastGSError(f'"{owner}" has a transform that holds no finite numbers on frame {frame:g}; clear its location, rotation '
                              "and scale, or those of its parents.")
        try:
            mesh = obj.to_mesh()
        except RuntimeError as error:
            raise FastGSError(f'"{owner}" has no surface on frame {frame:g} ({error}).') from error
        try:
            points, loops = arrays.points(mesh), arrays.read(mesh.loops, "vertex_index", np.int32)
            if not self.positions:
                self._keys.append(key)
                self.pieces.append(_describe(obj, mesh, owner, loops, matrix))
            else:
                self._compare(owner, key, len(mesh.vertices), loops, frame)
        finally:
            obj.to_mesh_clear()
        if not np.isfinite(points).all():
            raise FastGSError(f'"{owner}" has vertices whose positions are not finite numbers on frame {frame:g}; repair its mesh.')
        return transformed(points, matrix).astype(np.float32)

    def _compare(self, owner, key, vertices, loops, frame):
        if key not in self._keys:
            return  # record() says so
        piece = self.pieces[self._keys.index(key)]
        if vertices == piece.vertices and np.array_equal(loops, piece.loops):
            return
        change = "other faces" if vertices == piece.vertices else f"{vertices:,} vertices instead of {piece.vertices:,}"
        raise FastGSError(f'"{owner}" has {change} on frame {frame:g} as compared with frame {self._first:g}: a surface whose topology '
                          "changes cannot be followed; disable the modifier that rebuilds it, or bake fewer frames.")

    def triangles(self) -> np.ndarray:
        """Vertex indices [T, 3] into the positions."""
        offsets = np.cumsum([0] + [p.vertices for p in self.pieces])
        return np.concatenate([p.triangles + offset for p, offset in zip(self.pieces, offsets, strict=False)])

    def normals(self, samples: SurfaceSamples) -> np.ndarray:
        """Shading normals [N, 3] of the first frame at the samples."""
        corners = np.concatenate([p.normals[p.corners] for p in self.pieces])[samples.triangle]
        normals = np.einsum("nkd,nk->nd", corners, samples.weights)
        return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)

    def open(self) -> np.ndarray:
        """Whether each triangle belongs to a surface with a border, and so may be seen from both sides."""
        offsets = np.cumsum([p.vertices for p in self.pieces])[:-1]
        points = np.split(self.positions[0].astype(np.float64), offsets)
        return np.concatenate([np.full(len(p.triangles), _has_border(welded(x)[p.triangles]))
                               for p, x in zip(self.pieces, points, strict=True)])

    def parts(self) -> np.ndarray:
        """For each triangle the number of the thing that it belongs to: objects with a common root are one."""
        roots = [_root(bpy.data.objects[p.owner]).name for p in self.pieces]
        number = np.unique(roots, return_inverse=True)[1]
        return np.repeat(number, [len(p.triangles) for p in self.pieces])

    def place(self, triangle: int) -> str:
        """A triangle in words: its object, and the vertex group (in rigs a bone) that has most of it."""
        number = int(np.searchsorted(np.cumsum([len(p.triangles) for p in self.pieces]), triangle, side="right"))
        piece, name = self.pieces[number], self._keys[number][1]
        first = triangle - sum(len(p.triangles) for p in self.pieces[:number])
        group = self._group(bpy.data.objects[name], piece.triangles[first])
        return f'"{piece.owner}"' + (f', vertex group "{group}",' if group else "")

    def _group(self, obj, vertices) -> str:
        mesh = obj.evaluated_get(self._context.evaluated_depsgraph_get()).to_mesh()
        try:
            weights = {}
            for index in vertices:
                for element in mesh.vertices[index].groups:
                    weights[element.group] = weights.get(element.group, 0.0) + element.weight
        finally:
            obj.evaluated_get(self._context.evaluated_depsgraph_get()).to_mesh_clear()
        names = {group.index: group.name for group in obj.vertex_groups}
        return names.get(max(weights, key=weights.get), "") if weights else ""

    def patches(self) -> np.ndarray:
        """For each triangle the number of its object and material."""
        offsets = np.cumsum([0] + [p.material.max(initial=0) + 1 for p in self.pieces])
        return np.concatenate([p.material + offset for p, offset in zip(self.pieces, offsets, strict=False)])


def bakeable(obj: bpy.types.Object) -> bool:
    """Whether an object may have a surface to bake."""
    instances = obj.type == 'EMPTY' and obj.instance_type == 'COLLECTION'
    return (obj.type in MESHABLE or instances) and not is_splat(obj)


def whole_frames_only(obj: bpy.types.Object) -> bool:
    """Whether an object is moved by a simulation, which cannot be evaluated on half frames."""
    while obj is not None:
        if obj.rigid_body or any(m.type in SIMULATED or (m.type == 'NODES' and _simulates(m.node_group)) for m in obj.modifiers):
            return True
        obj = obj.parent
    return False


def _simulates(group, depth=0) -> bool:
    return group is not None and depth < 8 and any(
        node.bl_idname == 'GeometryNodeSimulationInput' or _simulates(getattr(node, "node_tree", None), depth + 1) for node in group.nodes)


def _describe(obj, mesh, owner, loops, matrix) -> Piece:
    mesh.calc_loop_triangles()
    triangles = mesh.loop_triangles
    normals = arrays.read(mesh.corner_normals, "vector", np.float32, 3) @ np.linalg.pinv(matrix[:3, :3])
    piece = Piece(
        owner, len(mesh.vertices), loops, arrays.read(triangles, "vertices", np.int32, 3), arrays.read(triangles, "loops", np.int32, 3),
        arrays.read(triangles, "material_index", np.int32), [slot.material and slot.material.original for slot in obj.material_slots],
        normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12))
    for layer in mesh.uv_layers:
        piece.uv[layer.name] = arrays.read(layer.uv, "vector", np.float32, 2)
        if layer.active_render or not piece.default_uv:
            piece.default_uv = layer.name
    for attribute in mesh.color_attributes:
        values = arrays.read(attribute.data, "color", np.float32, 4)  # linear, for byte colours too
        piece.colours[attribute.name] = values if attribute.domain == 'CORNER' else values[loops]
    return piece


def _has_border(triangles) -> bool:
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), 1)
    edges = edges[edges[:, 0] != edges[:, 1]]
    return bool((np.unique(edges[:, 0] << 32 | edges[:, 1], return_counts=True)[1] == 1).any())


def _root(obj):
    while True:
        rig = next((m.object for m in obj.modifiers if m.type == 'ARMATURE' and m.object), None)
        above = obj.parent or rig
        if above is None:
            return obj
        obj = above

# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads Blender's collections, meshes and images as arrays."""
import bpy
import numpy as np


def read(collection, name: str, dtype: type = np.float32, width: int = 1) -> np.ndarray:
    """A property of all members of a collection: [n], or [n, width]."""
    values = np.empty(len(collection) * width, dtype)
    collection.foreach_get(name, values)
    return values if width == 1 else values.reshape(-1, width)


def points(mesh: bpy.types.Mesh) -> np.ndarray:
    """The places of a mesh's vertices [V, 3] float32."""
    return read(mesh.vertices, "co", np.float32, 3)


def triangles(mesh: bpy.types.Mesh) -> np.ndarray:
    """The vertices of a mesh's triangles [F, 3] int32."""
    mesh.calc_loop_triangles()
    return read(mesh.loop_triangles, "vertices", np.int32, 3)


def fill(mesh: bpy.types.Mesh, places: np.ndarray, faces: np.ndarray) -> None:
    """Give an empty mesh vertices [V, 3] and faces [F, k], of k corners each; its edges are made by its update()."""
    for collection, count in ((mesh.vertices, len(places)), (mesh.loops, faces.size), (mesh.polygons, len(faces))):
        collection.add(count)
    mesh.vertices.foreach_set("co", np.ascontiguousarray(places, np.float32).ravel())
    mesh.loops.foreach_set("vertex_index", np.ascontiguousarray(faces, np.int32).ravel())
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, faces.shape[1], dtype=np.int32))


def pixels(image: bpy.types.Image) -> np.ndarray:
    """The numbers of an image [h, w, channels] float32, the bottom row first."""
    width, height = image.size
    values = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(height, width, image.channels)

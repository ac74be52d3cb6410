# SPDX-License-Identifier: GPL-3.0-or-later
"""Rasterises the depth of meshes that hide splats in Rendered shading under our engine, where Blender draws no meshes."""
import numpy as np

from ...fastgs_blender.cameras.camera import Camera
from ...fastgs_blender.kernels.gl.frame_table import Depths
from ...fastgs_blender.util.backends import load_backend
from .picture import SceneDepth


def scene_depth(triangles: np.ndarray, camera: Camera, depths: Depths) -> SceneDepth | None:
    """The window depth of triangles [F, 3, 3] before a camera; None where none of them is visible."""
    backend = load_backend("cpu")
    depth = backend.numpy(backend.surface(triangles, camera))[::-1]
    if np.isinf(depth).all():
        return None
    values = depths.a + depths.b * depth if camera.orthographic else depths.a + depths.b / depth
    return SceneDepth(np.where(np.isinf(depth), 1, values).astype(np.float32), depths)

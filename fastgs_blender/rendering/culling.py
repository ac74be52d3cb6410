# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the Gaussians that a camera can see and sorts them by depth, in NumPy; kernels/cpu/visible.py does the same with numba."""
import numpy as np

from ..cameras.camera import Camera
from ..model.slicing import positions_at, sigmoid
from .crops import crop_share
from .instances import ViewedInstance
from .looks import Look, size_factor


def order_in_numpy(instances: list[ViewedInstance], camera: Camera, limit: float = 1.0, ranks=None) -> np.ndarray:
    """visibility.order() in NumPy."""
    keys, index, done = [np.zeros(0, np.float32)], [np.zeros(0, np.int32)], 0
    for instance in instances:
        if len(instance.model) and instance.in_range:
            depth, found = _visible(instance, camera, ranks(instance.model) < limit if limit < 1 else True)
            keys.append(depth)
            index.append((done + found).astype(np.int32))
        done += len(instance.model)
    return np.concatenate(index)[np.argsort(np.concatenate(keys), kind="stable")]


def spread(camera: Camera) -> tuple[float, float]:
    """The most pixels, in x and in y, that a unit of standard deviation covers at depth 1 anywhere in the picture."""
    if camera.orthographic:
        return abs(camera.fx), abs(camera.fy)
    x_low, x_high, y_low, y_high = camera.tangent_limits()
    return (abs(camera.fx) * np.hypot(1, max(abs(x_low), abs(x_high))), abs(camera.fy) * np.hypot(1, max(abs(y_low), abs(y_high))))


def scale_bound(matrix: np.ndarray) -> float:
    """The largest factor by which a matrix [3, 3] stretches any direction."""
    return float(np.linalg.norm(matrix, 2))


def _visible(instance: ViewedInstance, camera: Camera, wanted) -> tuple[np.ndarray, np.ndarray]:
    """Depths [V] float32 and indices [V] of an instance's Gaussians that can be seen, and are wanted ([N] bool or True)."""
    model, raster = instance.model, instance.model.raster
    with np.errstate(all="ignore"):
        sigma = sigmoid(model.opacity) * instance.look[Look.OPACITY] * model.temporal_kind.factor(instance.t, model.mu_tau, model.temporal)
        kept = 1 + np.exp(-model.opacity.astype(np.float64)) <= instance.look[Look.FAINTEST]
        kept &= (sigma >= raster.alpha_cut) & instance.in_ball(model.position) & wanted
        if len(instance.hidden):
            kept &= ~instance.hidden
        at = np.flatnonzero(kept)
        to_camera = instance.model_to_camera
        position = positions_at(model, instance.t, at)
        p = position @ to_camera[:3, :3].T + to_camera[:3, 3]
        z = p[:, 2]
        per_depth = np.ones_like(z) if camera.orthographic else 1 / z
        centre = p[:, :2] * (camera.fx, camera.fy) * per_depth[:, None] + (camera.cx, camera.cy)
        size = np.exp(model.scale[at].max(1).astype(np.float64))
        size *= size_factor(size, instance.look) * per_depth * scale_bound(to_camera[:3, :3])
        strength = sigma[at] * crop_share(instance.settings.crops, position)
        reach = 2 * np.log(strength / raster.alpha_cut)
        blur = instance.sampling.most_blur(raster.blur, position, np.ones_like(z) if camera.orthographic else z)
        radius = np.sqrt(reach[:, None] * ((size[:, None] * spread(camera)) ** 2 + blur[:, None]))
        seen = (z > instance.near) & (z <= instance.far) & (strength >= raster.alpha_cut)
        seen &= ((centre + radius >= 0) & (centre - radius <= (camera.width, camera.height))).all(1)
    return z[seen].astype(np.float32), at[seen]

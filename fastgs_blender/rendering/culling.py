# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the Gaussians that a camera can see and sorts them by depth, in NumPy; kernels/cpu/visible.py does the same with numba."""
import numpy as np

from ..cameras.camera import Camera
from ..model.slicing import positions_at, sigmoid
from ..util.rotations import transformed
from .crops import crop_share
from .instances import ViewedInstance
from .looks import Look, size_factor

SAMPLE = 1 << 15
"""About how many splats say what weight the heaviest share of all has."""
JITTER = 1 << 20
"""What the weights' bits are spread by, an eighth of their value: of many equal splats a share is drawn, too, each time the same."""


def order_in_numpy(instances: list[ViewedInstance], camera: Camera, share: float = 1.0, standing: dict | None = None) -> np.ndarray:
    """visibility.order() in NumPy; it keeps nothing."""
    found, done = [(np.zeros(0, np.float32), np.zeros(0, np.int32), np.zeros(0, np.float32))], 0
    for instance in instances:
        if len(instance.model) and instance.in_range:
            depth, at, weight = _visible(instance, camera)
            found.append((depth, (done + at).astype(np.int32), weight))
        done += len(instance.model)
    depth, index, weight = (np.concatenate(each) for each in zip(*found))
    if share >= 1:
        return index[np.argsort(depth, kind="stable")]
    kept = heaviest(weight, index, share)
    return index[kept][np.argsort(coarse_depths(depth[kept]), kind="stable")]


def heaviest(weight: np.ndarray, index: np.ndarray, share: float) -> np.ndarray:
    """Which of the splats of these weights [V] float32 belong to the heaviest share of them: [V] bool."""
    spread = index.view(np.uint32) * np.uint32(2654435769) >> np.uint32(12)  # below JITTER, unlike for neighbours
    bits = weight.view(np.uint32) + spread
    sample = bits[::len(bits) // SAMPLE + 1]
    least = int((1 - share) * len(sample))
    return bits > np.partition(sample, least)[least] if len(bits) else np.zeros(0, bool)


def coarse_depths(depth: np.ndarray) -> np.ndarray:
    """Depths [V] float32 >= 0 as whole numbers of 16 bits that ascend with them: uint32."""
    bits = depth.view(np.uint32) - depth.view(np.uint32).min(initial=2**32 - 1)
    return bits >> np.uint32(max(int(bits.max(initial=0)).bit_length() - 16, 0))


def spread(camera: Camera) -> tuple[float, float]:
    """The most pixels, in x and in y, that a unit of standard deviation covers at depth 1 anywhere in the picture."""
    if camera.orthographic:
        return abs(camera.fx), abs(camera.fy)
    x_low, x_high, y_low, y_high = camera.tangent_limits()
    return (abs(camera.fx) * np.hypot(1, max(abs(x_low), abs(x_high))), abs(camera.fy) * np.hypot(1, max(abs(y_low), abs(y_high))))


def scale_bound(matrix: np.ndarray) -> float:
    """The largest factor by which a matrix [3, 3] stretches any direction."""
    return float(np.linalg.norm(matrix, 2))


def _visible(instance: ViewedInstance, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of an instance's Gaussians that can be seen the depths [V] float32, the indices [V], and how much they weigh in the picture [V]
    float32: opacity times area in pixels, squared."""
    model, raster = instance.model, instance.model.raster
    with np.errstate(all="ignore"):
        sigma = sigmoid(model.opacity) * instance.look[Look.OPACITY] * model.temporal_kind.factor(instance.t, model.mu_tau, model.temporal)
        kept = 1 + np.exp(-model.opacity.astype(np.float64)) <= instance.look[Look.FAINTEST]
        kept &= (sigma >= raster.alpha_cut) & instance.in_ball(model.position)
        if len(instance.hidden):
            kept &= ~instance.hidden
        at = np.flatnonzero(kept)
        to_camera = instance.model_to_camera
        position = positions_at(model, instance.t, at)
        p = transformed(position, to_camera)
        z = p[:, 2]
        per_depth = np.ones_like(z) if camera.orthographic else 1 / z
        centre = p[:, :2] * (camera.fx, camera.fy) * per_depth[:, None] + (camera.cx, camera.cy)
        _, middle, size = np.exp(np.sort(model.scale[at].astype(np.float64), 1)).T
        factor = size_factor(size, instance.look) * per_depth * scale_bound(to_camera[:3, :3])
        middle, size = middle * factor, size * factor
        strength = sigma[at] * crop_share(instance.settings.crops, position)
        reach = 2 * np.log(strength / raster.alpha_cut)
        blur = instance.sampling.most_blur(raster.blur, position, np.ones_like(z) if camera.orthographic else z)
        radius = np.sqrt(reach[:, None] * ((size[:, None] * spread(camera)) ** 2 + blur[:, None]))
        seen = (z > instance.near) & (z <= instance.far) & (strength >= raster.alpha_cut)
        seen &= ((centre + radius >= 0) & (centre - radius <= (camera.width, camera.height))).all(1)
        focal = abs(camera.fx * camera.fy)
        weight = strength**2 * (size**2 * focal + raster.blur) * (middle**2 * focal + raster.blur)
        return z[seen].astype(np.float32), at[seen], weight[seen].astype(np.float32)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Projects and unprojects points with pinhole cameras, for the preparation of training."""
import numpy as np

from ...cameras.camera import Camera
from ...captures.capture import Capture
from ...util.backends import load_backend


def project(camera: Camera, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [n, 2] and depths [n] of world points [n, 3]."""
    return load_backend("cpu").project_points(xyz, camera)


def unproject(camera: Camera, places: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """World points [n, 3] behind pixels [n, 2] at depths [n]."""
    local = np.stack([(places[:, 0] - camera.cx) / camera.fx * depth, (places[:, 1] - camera.cy) / camera.fy * depth, depth], 1)
    return (local - camera.world_to_camera[:3, 3]) @ np.linalg.inv(camera.world_to_camera[:3, :3]).T


def visible(camera: Camera, xyz: np.ndarray) -> np.ndarray:
    """Which world points [n] are within the picture."""
    return within(camera, *project(camera, xyz))


def within(camera: Camera, places: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Which pixels [n, 2] at depths [n] are within the picture and before the camera."""
    x, y = places.T
    return (depth > 0) & (x > 0) & (y > 0) & (x < camera.width) & (y < camera.height)


def sample(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Values [n, C] of an image [h, w, C] at the pixels nearest to places [n, 2]."""
    column, row = (np.clip(places[:, k].astype(int), 0, image.shape[1 - k] - 1) for k in (0, 1))
    return image[row, column]


def depth_range(capture: Capture) -> tuple[float, float]:
    """Nearest and farthest depth of the scene if no points are known: around the point at which the cameras look together."""
    centres = capture.centres()
    distance = float(np.median(np.linalg.norm(centres - capture.focus, axis=1)))
    distance = distance if distance > 0.2 * capture.extent else 3 * capture.extent
    return 0.3 * distance, 4 * distance

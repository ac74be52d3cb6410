# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera that shows a model first: the author's, one of the capture's, one where cameras seem to have stood, or one outside."""
import numpy as np

from ..model.filmed_from import filmed_from
from ..model.framing import bounds, middle
from ..model.gaussians import GaussianModel
from ..model.surroundings import Viewpoint
from ..util import rotations
from ..util.errors import FastGSError
from .camera import Camera
from .poses import look_at
from .viewpoints import camera_of

RIGHT_DOWN_FORWARD = {"RDF": np.eye(3), "RFU": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), "RUB": np.diag([1.0, -1, -1])}
"""Rows: a camera's right, down and forward in the axes of a model."""
FOCAL = 1.2
"""Focal length of an estimated camera, by the shorter side of its picture."""


def up_of(model: GaussianModel) -> np.ndarray:
    """The unit vector [3] that points up in a model's axes."""
    return -RIGHT_DOWN_FORWARD[model.axes][1]


def opening(model: GaussianModel, width: int = 1280, height: int = 720) -> tuple[Camera, np.ndarray]:
    """(camera, what it looks at [3]), in the model's space; width and height are those of a camera that is estimated."""
    around, centre = model.surroundings, middle(model)
    if around.view or around.cameras:
        viewpoint = around.view or around.cameras[middle_camera(around.cameras, up_of(model))]
        camera = camera_of(viewpoint)
        pose = np.linalg.inv(camera.world_to_camera)
        eye, forward = pose[:3, 3], pose[:3, 2]
        distance = viewpoint.distance or float((centre - eye) @ forward)
        return camera, eye + max(distance, 1e-3 * float(np.linalg.norm(centre - eye)), 1e-9) * forward
    found = filmed_from(model, 0.0, up_of(model))
    if found is None:
        return overview(model, width, height), centre
    focal = FOCAL * min(width, height)
    return Camera(width, height, focal, focal, width / 2, height / 2, look_at(*found, up_of(model))), found[1]


def middle_camera(viewpoints: tuple[Viewpoint, ...], up: np.ndarray) -> int:
    """The number of the camera that stands nearest to the middle of all, among those that stand neither high nor low (`up` [3])."""
    places = np.array([viewpoint.position for viewpoint in viewpoints])
    heights = places @ np.asarray(up, np.float64)
    low, high = np.percentile(heights, 25, method="lower"), np.percentile(heights, 75, method="higher")
    away = np.linalg.norm(places - places.mean(0), axis=1)
    return int(np.argmin(np.where((heights >= low) & (heights <= high), away, np.inf)))


def overview(model: GaussianModel, width: int, height: int) -> Camera:
    """A camera outside the model that sees all of its centres at t = 0, looking along the axis that the model calls forward."""
    low, high = bounds(model)
    if low is None or high is None:
        raise FastGSError("the model has no Gaussians to look at.")
    rotation = RIGHT_DOWN_FORWARD[model.axes]
    centre, radius = (np.array(low) + high) / 2, max(float(np.linalg.norm(np.subtract(high, low))) / 2, 1e-6)
    focal, distance = FOCAL * min(width, height), 2.6 * radius + model.raster.near
    pose = rotations.transform(rotation, -rotation @ centre + [0, 0, distance])
    return Camera(width, height, focal, focal, width / 2, height / 2, pose)

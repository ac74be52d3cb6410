# SPDX-License-Identifier: GPL-3.0-or-later
"""The viewpoints of a capture's cameras, as a model's file records them."""
import numpy as np

from ..cameras.viewpoints import viewpoint_of
from ..model.surroundings import Viewpoint, evenly
from .capture import Capture


def viewpoints(capture: Capture) -> tuple[Viewpoint, ...]:
    """The poses from which the capture's training pictures were taken, each once; where there are more than MOST_CAMERAS, every n-th."""
    shots = list({shot.camera.world_to_camera.tobytes(): shot for shot in capture.training if shot.camera is not None}.values())
    focus = np.append(capture.focus, 1.0)
    return tuple(viewpoint_of(shot.camera, shot.view, max(float((shot.camera.world_to_camera @ focus)[2]), 0.0)) for shot in evenly(shots))

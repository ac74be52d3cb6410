# SPDX-License-Identifier: GPL-3.0-or-later
"""The opening picture of a page, which is seen until the player draws, and without JavaScript."""
from collections.abc import Callable

import numpy as np

from ...cameras.camera import Camera
from ...cameras.cameras_json import resized
from ...rendering import colour
from ...rendering.api import render
from ...rendering.instances import Instance
from ...rendering.passes import PassSettings
from ...util.picture_files import png
from .page import Page

SIDE = 640
"""Pixels of the longer side."""
Draw = Callable[[list[Instance], Camera], tuple[np.ndarray, np.ndarray]]


def linear(instances: list[Instance], camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Premultiplied scene-linear colour [h, w, 3] and alpha [h, w] of models in one colour space."""
    image = render(instances, camera, settings=PassSettings(film="transparent"))  # the page's background is put behind it
    return colour.scene_linear(image["rgb"], image["alpha"], instances[0].model.colour_space), image["alpha"]


def shown(page: Page, frame: int, camera: Camera, draw: Draw = linear) -> np.ndarray:
    """What a page shows on a frame before a camera: sRGB [h, w, 3], 0..1."""
    rgb, alpha = draw(page.instances(frame), camera)
    return np.clip(colour.linear_to_srgb(colour.over(rgb, alpha, page.background)), 0, 1)


def poster(page: Page, draw: Draw = linear) -> bytes:
    """The PNG of a page's first frame before its first camera."""
    camera = page.cameras[0]
    share = min(1.0, SIDE / max(camera.width, camera.height))
    small = resized(camera, max(1, round(camera.width * share)), max(1, round(camera.height * share)))
    return png(np.floor(shown(page, 0, small, draw) * 255 + 0.5).astype(np.uint8))

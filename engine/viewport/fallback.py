# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws splats where the GPU cannot: renders them on the CPU and shows the picture as a texture."""
from __future__ import annotations

import gpu
import numpy as np
from gpu_extras.presets import draw_texture_2d
from mathutils import Matrix

from ... import fastgs_blender as fg
from ...scene.colour import film
from ...scene.sky import Panorama
from ...scene.snapshot import Snapshot
from .. import scene_linear
from .textures import upload


def render(snapshot: Snapshot, camera: fg.Camera, working: np.ndarray, background) -> np.ndarray:
    """Premultiplied picture [h, w, 4], the bottom row first.

    working     [3, 3] from linear Rec.709 to the target's primaries
    background  colour [3] or Panorama under the splats, or None
    """
    if isinstance(background, Panorama):
        background = background.behind(camera)
    instances, _ = snapshot.load()
    images = scene_linear.render(instances, camera, working)
    return film(images["rgb"], images["alpha"], background)[::-1]


class Image:
    """The last picture.  `needed`: whether it is what the viewport shows; `fresh`: whether it waits to be drawn."""

    def __init__(self):
        self.needed = self.fresh = False
        self._values = self._texture = None

    @property
    def there(self) -> bool:
        """Whether there is a picture."""
        return self._values is not None

    def done(self, values: np.ndarray) -> None:
        """From the thread: a new picture."""
        self._values, self.fresh = values, True

    def draw(self) -> None:
        """Draw it over the whole of the active framebuffer."""
        if self.fresh:
            self.fresh = False
            self._texture = upload(np.ascontiguousarray(self._values))
        if self._texture is None:
            return
        gpu.state.blend_set('ALPHA_PREMULT')
        with gpu.matrix.push_pop(), gpu.matrix.push_pop_projection():
            gpu.matrix.load_matrix(Matrix.Identity(4))
            gpu.matrix.load_projection_matrix(Matrix.Identity(4))
            draw_texture_2d(self._texture, (-1, -1), 2, 2)
        gpu.state.blend_set('NONE')

    def free(self) -> None:
        """Free the texture."""
        self._values = self._texture = None
        self.needed = self.fresh = False

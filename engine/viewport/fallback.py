# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws viewports through the library's renderer, where Blender's shaders cannot draw and for passes: renders and shows a texture."""
from dataclasses import dataclass, field, replace

import gpu
import numpy as np
from gpu_extras.presets import draw_texture_2d
from mathutils import Matrix

from ... import fastgs_blender as fg
from ...fastgs_blender.rendering.colour import srgb_to_linear
from ...fastgs_blender.rendering.passes import PASSES, PassSettings
from ...scene import devices
from ...scene.colour import film
from ...scene.sky import Panorama
from ...scene.snapshot import Snapshot
from .. import scene_linear
from .textures import upload

COARSE = 3
"""Pixels, in x and in y, that one of a pass covers while the view moves."""


PICTURE = "rgb"
"""The pass that is the picture itself, in its own colours."""


@dataclass(frozen=True, eq=False)
class DataPass:
    """A pass that a viewport shows in place of the picture that Blender's shaders draw.

    name      in the library's table; PICTURE is shown over the background
    settings  PassSettings
    holdout   triangles [F, 3, 3] that hide splats, or None
    state     equal as long as none of it has changed
    surfaces  triangles [F, 3, 3] of the surfaces of objects, by their names, whose normals count
    """

    name: str
    settings: PassSettings
    holdout: np.ndarray | None
    state: tuple
    surfaces: dict[str, np.ndarray] = field(default_factory=dict)


def render(snapshot: Snapshot, camera: fg.Camera, working: np.ndarray, background, data: DataPass | None = None) -> np.ndarray:
    """Premultiplied picture [h, w, 4], the bottom row first.

    working     [3, 3] from linear Rec.709 to the target's primaries
    background  colour [3] or Panorama under the splats, or None
    data        a pass to show in its false colours, opaque, or the picture in its light; None: the picture
    """
    instances, _ = snapshot.load()
    backend = devices.backend(snapshot.device)[0]
    if data is not None and data.surfaces:
        instances = [replace(each, surface=data.surfaces.get(each.name)) for each in instances]
    if data is not None and data.name != PICTURE:
        image = fg.render(instances, camera, passes=(data.name,), backend=backend, settings=data.settings, holdout=data.holdout)[data.name]
        colour = srgb_to_linear(PASSES[data.name].display(image)) @ working.T
        return np.concatenate([colour, np.ones_like(colour[..., :1])], -1).astype(np.float32)[::-1]
    if isinstance(background, Panorama):
        background = background.behind(camera)
    options = {} if data is None else {"settings": data.settings, "holdout": data.holdout}
    images = scene_linear.render(instances, camera, working, backend=backend, **options)
    return film(images["rgb"], images["alpha"], background, images.get("holdout"))[::-1]


def coarse(camera: fg.Camera) -> fg.Camera:
    """The camera with fewer pixels."""
    width, height = max(camera.width // COARSE, 1), max(camera.height // COARSE, 1)
    x, y = width / camera.width, height / camera.height
    return replace(camera, width=width, height=height, fx=x * camera.fx, fy=y * camera.fy, cx=x * camera.cx, cy=y * camera.cy, window=None)


class Image:
    """The last picture that the library rendered for a viewport.  `needed`: the viewport shows it; `fresh`: it has not been drawn yet."""

    def __init__(self):
        self.needed = self.fresh = False
        self._values = self._texture = None

    @property
    def there(self) -> bool:
        """Whether there is a picture."""
        return self._values is not None

    def done(self, values: np.ndarray) -> None:
        """Take over a new picture; called by the thread."""
        self._values, self.fresh = values, True

    def draw(self) -> None:
        """Draw the picture over the whole of the active framebuffer."""
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

    def forget(self) -> None:
        """Free the texture, because its picture is out of date."""
        self._values = self._texture = None
        self.fresh = False

    def free(self) -> None:
        """Free the texture, and let the viewport try the GPU again."""
        self.forget()
        self.needed = False

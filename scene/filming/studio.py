# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders pictures of a scene in a private copy, so that the user's own scene never changes, even after errors."""
import tempfile
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ... import fastgs_blender as fg
from ...fastgs_blender.captures import generated
from ...fastgs_blender.rendering.colour import linear_to_srgb, straight
from ...fastgs_blender.util.picture_files import read_exr
from .. import camera as cameras
from .. import colour
from ..world import background

SKY = 1e9
"""Depth beyond which there is nothing."""


@dataclass(frozen=True, eq=False)
class Picture:
    """rgb [h, w, 3] float32 0..1 display sRGB, straight; alpha [h, w] or None for a filled film; cover [h, w] of the subject or None
    where the engine has no Cryptomatte; depth [h, w] along the camera's axis, inf for nothing, or None."""

    rgb: np.ndarray
    alpha: np.ndarray | None
    cover: np.ndarray | None
    depth: np.ndarray | None


class Studio:
    """A private copy of the scene that renders pictures; a context manager, which removes the copy at its end.

    samples   of Cycles and EEVEE, with a fast denoiser; 0: as the scene is set
    world     FILM it, LEAVE_OUT, or AUTO: left out where our engine renders the same one behind the model
    """

    def __init__(self, scene: bpy.types.Scene, width: int, height: int, samples: int = 0, world: str = 'FILM'):
        self._original, self._size, self._samples, self._world = scene, (width, height), samples, world

    def __enter__(self):
        self._folder = tempfile.TemporaryDirectory(prefix="fastgs-capture-")
        self.scene = self._original.copy()
        self.camera = bpy.data.objects.new("FAST-GS Capture", bpy.data.cameras.new("FAST-GS Capture"))
        self.scene.collection.objects.link(self.camera)
        self.layer = next((layer for layer in self.scene.view_layers if layer.use), self.scene.view_layers[0])
        self._set_up()
        return self

    def __exit__(self, *error):
        data = self.camera.data
        bpy.data.objects.remove(self.camera)
        bpy.data.cameras.remove(data)
        bpy.data.scenes.remove(self.scene)
        self._folder.cleanup()

    def _set_up(self):
        scene, render = self.scene, self.scene.render
        for layer in scene.view_layers:
            layer.use = layer == self.layer
        self.layer.use_pass_z = self.layer.use_pass_combined = True
        self.layer.use_pass_cryptomatte_object, self.layer.pass_cryptomatte_depth = True, 6
        render.resolution_x, render.resolution_y, render.resolution_percentage = *self._size, 100
        render.pixel_aspect_x = render.pixel_aspect_y = 1
        render.use_border = render.use_motion_blur = render.use_multiview = render.use_stamp = False
        render.use_compositing = render.use_sequencer = render.use_placeholder = False
        render.use_overwrite = render.use_persistent_data = render.use_file_extension = True
        if hasattr(render.image_settings, "media_type"):  # Blender 5.0 and later
            render.image_settings.media_type = 'MULTI_LAYER_IMAGE'
        render.image_settings.file_format, render.image_settings.color_depth = 'OPEN_EXR_MULTILAYER', '32'
        render.image_settings.exr_codec = 'NONE'
        render.filepath = str(Path(self._folder.name, "picture.exr"))
        scene.camera = self.camera
        if self._world != 'FILM':
            _, not_shown = background(scene, self.layer)
            render.film_transparent = render.film_transparent or self._world == 'LEAVE_OUT' or not_shown is None
        if self._samples:
            _be_quick(scene, self._samples)

    @property
    def depsgraph(self) -> bpy.types.Depsgraph:
        return self.layer.depsgraph

    def go_to(self, frame: int) -> None:
        self.scene.frame_set(frame)

    def filmed_by(self, obj: bpy.types.Object) -> fg.Camera:
        """The library's camera of one of the scene's own cameras, on the current frame."""
        width, height = self._size
        found = cameras.camera_of(obj.evaluated_get(self.depsgraph), cameras.RenderArea.full(width, height), self.depsgraph)
        if found.orthographic:
            raise fg.FastGSError(f'the camera "{obj.name}" is orthographic, and training needs perspective ones; choose other cameras.')
        return found

    def film(self, camera: fg.Camera, subject: set[str]) -> Picture:
        """Render that camera's picture of the current frame; subject: names of the objects that the mask shows."""
        self._stand(camera)
        with bpy.context.temp_override(scene=self.scene, view_layer=self.layer):  # else it takes the frame of the window's scene
            bpy.ops.render.render(write_still=True)
        planes, attributes = read_exr(self.scene.render.filepath)
        layer = self.layer.name + "."
        planes = {name.removeprefix(layer): plane for name, plane in planes.items()}
        rgb, alpha = self._colours(planes)
        manifest = next((value for name, value in attributes.items() if name.startswith("cryptomatte/") and name.endswith("/manifest")),
                        None)
        has_cover = manifest is not None and any(name.startswith("CryptoObject") for name in planes)
        depth = next((plane for name, plane in planes.items() if name.startswith("Depth.")), None)
        return Picture(rgb, alpha, generated.cover(planes, manifest, subject) if has_cover else None,
                       None if depth is None else np.where(depth < SKY, depth, np.inf).astype(np.float32))

    def _colours(self, planes):
        linear = np.stack([planes[f"Combined.{letter}"] for letter in "RGB"], -1)
        alpha = None
        if self.scene.render.film_transparent and "Combined.A" in planes:
            alpha = np.clip(planes["Combined.A"], 0, 1)
            linear = straight(linear, alpha)
        working = colour.rec709_to_working()
        if not np.allclose(working, np.eye(3), atol=1e-5):
            linear = linear @ np.linalg.inv(working).T
        return linear_to_srgb(np.nan_to_num(np.clip(linear, 0, 1)).astype(np.float32)), alpha

    def _stand(self, camera: fg.Camera):
        data, optics = self.camera.data, cameras.optics_of(camera)
        data.type, data.lens_unit, data.sensor_fit = 'PERSP', 'MILLIMETERS', 'HORIZONTAL'
        for name in ("lens", "sensor_width", "shift_x", "shift_y"):
            setattr(data, name, getattr(optics, name))
        data.clip_start, data.clip_end = camera.near, 1e5
        self.camera.matrix_world = Matrix(cameras.pose_of(camera).tolist())


def _be_quick(scene, samples):
    """Set few samples and a denoiser, with the same noise in every picture."""
    if scene.render.engine == 'CYCLES':
        cycles = scene.cycles
        cycles.samples, cycles.use_adaptive_sampling, cycles.seed, cycles.use_animated_seed = samples, False, 0, False
        cycles.max_bounces = min(cycles.max_bounces, 4)
        cycles.use_denoising = _can_denoise()
        if cycles.use_denoising:
            cycles.denoiser, cycles.denoising_prefilter = 'OPENIMAGEDENOISE', 'FAST'
    elif scene.render.engine.startswith("BLENDER_EEVEE"):
        scene.eevee.taa_render_samples = samples


def _can_denoise() -> bool:
    try:
        import _cycles
    except ImportError:
        return False
    return bool(getattr(_cycles, "with_openimagedenoise", False))

# SPDX-License-Identifier: GPL-3.0-or-later
"""Shows the background images of cameras (what they have filmed) on their frusta, at the current frame.

Blender itself shows a background image only in the camera's own view.  Pictures are drawn at the end of the frustum that Blender draws,
and write depth, so that they hide the splats behind them, which are drawn later.
"""
from functools import cache

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from ...fastgs_blender.util.rotations import transformed
from . import shaders

VERTEX = """
void main()
{
  v_uv = uv;
  gl_Position = to_clip * vec4(corner, 1.0);
}
"""
FRAGMENT = """
void main()
{
  vec4 seen = texture(picture, v_uv);
  if (seen.a < 0.002) {
    discard;
  }
  out_colour = vec4(straight ? seen.rgb * seen.a : seen.rgb, seen.a);
}
"""
UVS = [(1.0, 1.0), (1.0, 0.0), (0.0, 0.0), (0.0, 1.0)]

MOVING = bpy.app.version < (5, 3)
"""Whether pictures of films and sequences are shown: gpu.texture.from_image() of Blender 5.3.0 knows frame 0 alone."""

_textures: dict[str, tuple] = {}


def draw(context, depsgraph) -> None:
    """Draw the pictures of all cameras that a viewport shows, into the active framebuffer with its depth."""
    scene, space = context.scene, context.space_data
    if not scene.fastgs.show_pictures:
        clear()
        return
    if not space.overlay.show_overlays:
        return
    region = context.region_data
    looked_through = (space.camera if space.use_local_camera else scene.camera) if region.view_perspective == 'CAMERA' else None
    playing = context.screen is not None and context.screen.is_animation_playing
    for obj in depsgraph.objects:
        if obj.type == 'CAMERA' and obj.original != looked_through and obj.visible_in_viewport_get(space):
            texture = _texture(obj.original.data, scene.frame_current, playing)
            if texture is not None:
                place = np.array(obj.matrix_world.normalized())
                size = scene.fastgs.picture_size * growth(obj)
                draw_picture(texture, transformed(plane(obj.data, scene, size), place), region.perspective_matrix,
                             is_straight(obj.original.data))


def growth(camera) -> float:
    """The factor by which an object's scale enlarges the frustum that Blender draws: the harmonic mean of the three axes' lengths.

    That of an orthographic camera stays as it is.
    """
    lengths = np.linalg.norm(np.array(camera.matrix_world)[:3, :3], axis=0)
    return 3 / np.sum(1 / np.maximum(lengths, 1e-30)) if camera.data.type != 'ORTHO' else 1.0


def plane(camera, scene, size: float) -> np.ndarray:
    """The corners [4, 3] of the end of a camera's frustum in its own space, as Blender draws it at this share of its display size."""
    corners = np.array([tuple(corner) for corner in camera.view_frame(scene=scene)])
    if camera.type == 'ORTHO':
        return corners * (1, 1, size)
    sensor = camera.sensor_height if camera.sensor_fit == 'VERTICAL' else camera.sensor_width
    return corners / abs(corners[:, 2:]) * (size * camera.display_size * camera.lens / sensor)


def draw_picture(texture, corners: np.ndarray, to_clip, straight: bool = True) -> None:
    """A picture on four corners [4, 3]: right top, right bottom, left bottom, left top; straight: its colours are not multiplied by alpha.

    Nothing is drawn where it is transparent.
    """
    shader = _shader()
    points = [corners[i].tolist() for i in (0, 1, 3, 2)]
    batch = batch_for_shader(shader, 'TRI_STRIP', {"corner": points, "uv": [UVS[i] for i in (0, 1, 3, 2)]})
    with shaders.drawing('ALPHA_PREMULT', 'LESS_EQUAL', writes_depth=True):
        shader.bind()
        shader.uniform_float("to_clip", to_clip)
        shader.uniform_bool("straight", straight)
        shaders.fill(shader, batch, {"picture": texture})


def image_frame(user, frame: int) -> int:
    """Which of an image's frames an image user shows on a frame of the scene; before and after it the first and the last."""
    count = max(user.frame_duration, 1)
    at = frame - user.frame_start + 1
    at = (at - 1) % count + 1 if user.use_cyclic else min(max(at, 1), count)
    return at + user.frame_offset


def clear() -> None:
    """Free the textures."""
    _textures.clear()


def free_shader() -> None:
    """Free the shader."""
    _shader.cache_clear()


def _background(camera):
    """A camera's first background that is an image, or None."""
    return next((b for b in camera.background_images if b.source == 'IMAGE' and b.image is not None), None)


def is_straight(camera) -> bool:
    """Whether the texture of a camera's background has colours that are not multiplied by its alpha, as Blender keeps them."""
    image = _background(camera).image
    return image.alpha_mode == 'STRAIGHT' if image.is_float else image.alpha_mode != 'PREMUL'


def _texture(camera, frame: int, playing: bool):
    """The texture of a camera's first background, or None.  During playback it may be that of an earlier frame."""
    background = _background(camera)
    if background is None or not camera.show_background_images:
        return None
    image = background.image
    still = image.source == 'FILE'
    if not (still or MOVING):
        return None
    key = image.as_pointer(), 0 if still else image_frame(background.image_user, frame)
    found = _textures.get(camera.name_full)
    if found is not None and (found[0] == key or (playing and found[0][0] == key[0])):
        return found[1]
    texture = None
    if image.gl_load(frame=key[1]) == 0:
        texture = gpu.texture.from_image(image)
        image.gl_free()  # the next frame is then loaded anew; the texture itself lives on
    _textures[camera.name_full] = key, texture
    return texture


@cache
def _shader():
    info = gpu.types.GPUShaderCreateInfo()
    between = gpu.types.GPUStageInterfaceInfo("fastgs_frustum_iface")
    between.smooth('VEC2', "v_uv")
    info.vertex_in(0, 'VEC3', "corner")
    info.vertex_in(1, 'VEC2', "uv")
    info.vertex_out(between)
    info.push_constant('MAT4', "to_clip")
    info.push_constant('BOOL', "straight")
    info.sampler(0, 'FLOAT_2D', "picture")
    info.fragment_out(0, 'VEC4', "out_colour")
    info.vertex_source(VERTEX)
    info.fragment_source(FRAGMENT)
    return gpu.shader.create_from_info(info)

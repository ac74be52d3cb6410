# SPDX-License-Identifier: GPL-3.0-or-later
"""Background images of cameras on their frusta in viewports."""
from __future__ import annotations

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from gpu_context import draw_offscreen, open_gpu
from mathutils import Matrix

SIZE = 96, 64


@pytest.fixture
def film(tmp_path):
    """Five pictures, the left half of each as red as its number, the right half blue: the first one's path."""
    for number in range(1, 6):
        picture = np.zeros((8, 12, 4), np.float32)
        picture[:, :6, 0], picture[:, 6:, 2], picture[..., 3] = 50 * number / 255, 1, 1
        image = bpy.data.images.new("Film", 12, 8)
        image.pixels.foreach_set(picture.ravel())
        image.filepath_raw, image.file_format = str(tmp_path / f"film_{number:04}.png"), 'PNG'
        image.save()
    return str(tmp_path / "film_0001.png")


@pytest.fixture
def camera(film, scene):
    """A camera at the origin that looks along -z, with the film behind it from the scene's frame 10 on."""
    if bpy.app.version >= (5, 3):
        pytest.skip("Blender 5.3.0 gives add-ons no frames of sequences")
    obj = bpy.data.objects.new("Filmed", bpy.data.cameras.new("Filmed"))
    scene.collection.objects.link(obj)
    scene.render.resolution_x, scene.render.resolution_y = 300, 200
    obj.data.display_size = 2.0
    background = obj.data.background_images.new()
    background.image = bpy.data.images.load(film)
    background.image.source = 'SEQUENCE'
    background.image_user.frame_start, background.image_user.frame_duration = 10, 5
    obj.data.show_background_images = True
    return obj


@pytest.fixture
def drawn(module, scene):
    """drawn(after=None, **context): the pictures [h, w, 4] as seen by somebody who stands behind the camera, 4 units wide."""
    open_gpu(scene)
    frusta = module("engine.viewport.frusta")
    scene.fastgs.show_pictures = True
    see = Matrix(((2 / 4, 0, 0, 0), (0, 3 / 4, 0, 0), (0, 0, -0.05, 0), (0, 0, 0, 1)))
    space = next(area.spaces.active for screen in bpy.data.screens for area in screen.areas if area.type == 'VIEW_3D')
    space.overlay.show_overlays = True

    def draw(playing=False, perspective='ORTHO', after=None):
        view = SimpleNamespace(view_perspective=perspective, perspective_matrix=see)
        context = SimpleNamespace(scene=scene, space_data=space, region_data=view, screen=SimpleNamespace(is_animation_playing=playing))
        bpy.context.view_layer.update()

        def both(framebuffer):
            frusta.draw(context, bpy.context.evaluated_depsgraph_get())
            if after:
                after(framebuffer)

        return draw_offscreen(*SIZE, both)

    yield draw
    frusta.clear()


def linear(byte):
    return ((byte / 255 + 0.055) / 1.055) ** 2.4


def test_the_current_frame_is_on_the_frustum(camera, drawn, scene):
    """The picture is as wide as the camera's display size, upright, in scene-linear colours; it follows the scene's frame."""
    for frame, number in ((10, 1), (12, 3), (99, 5), (1, 1)):
        scene.frame_set(frame)
        image = drawn()
        shown = image[..., 3] > 0
        assert shown.sum() == pytest.approx((2 / 4 * 96) * (2 / 1.5 / (8 / 3) * 64), rel=0.03)
        np.testing.assert_allclose(image[shown.shape[0] // 2, 30, :3], (linear(50 * number), 0, 0), atol=2e-3)
        np.testing.assert_allclose(image[shown.shape[0] // 2, 66, :3], (0, 0, 1), atol=2e-3)


def test_who_shows_and_who_does_not(camera, drawn, scene):
    assert drawn()[..., 3].any()
    scene.camera = camera
    assert not drawn(perspective='CAMERA').any()
    for owner, name in ((scene.fastgs, "show_pictures"), (camera.data, "show_background_images")):
        setattr(owner, name, False)
        assert not drawn().any()
        setattr(owner, name, True)
    camera.hide_set(True)
    assert not drawn().any()


def test_size_and_place(camera, drawn, scene):
    area = (drawn()[..., 3] > 0).sum()
    scene.fastgs.picture_size = 0.5
    assert (drawn()[..., 3] > 0).sum() == pytest.approx(area / 4, rel=0.1)
    camera.location.x = 1.0
    small = drawn()[..., 3] > 0
    assert np.flatnonzero(small.any(0)).mean() == pytest.approx(48 + 24, abs=1)
    camera.parent = bpy.data.objects.new("World", None)  # as Set Scale leaves a capture: Blender's frusta grow with it
    scene.collection.objects.link(camera.parent)
    camera.parent.scale = (0.5, 0.5, 0.5)
    shown = drawn()[..., 3] > 0
    assert shown.sum() == pytest.approx(small.sum() / 4, rel=0.1)
    assert np.flatnonzero(shown.any(0)).mean() == pytest.approx(48 + 12, abs=1)


@pytest.mark.parametrize("kind", ["png", "exr"])
def test_transparent_pictures_show_what_is_behind_them(camera, drawn, module, tmp_path, kind):
    """The left third is clear, the middle half covered by red, the right blue; over nothing and over the grey of another picture."""
    picture = np.zeros((8, 12, 4), np.float32)
    picture[:, 4:8] = (1, 0, 0, 0.5)
    picture[:, 8:] = (0, 0, 1, 1)
    path = tmp_path / f"clear.{kind}"
    if kind == "exr":
        picture[..., :3] *= picture[..., 3:]  # as such files keep colours
        module("fastgs_blender.util.picture_files").write_exr(path, dict(zip("RGBA", np.moveaxis(picture, -1, 0))))
    else:
        module("fastgs_blender.util.picture_files").write_png(path, np.uint8(255 * picture))
    camera.data.background_images[0].image = bpy.data.images.load(str(path))
    shown = drawn()[32]
    left, middle, right = (shown[column] for column in (30, 48, 66))
    np.testing.assert_allclose(left, 0, atol=2e-3)
    np.testing.assert_allclose(middle, (0.5, 0, 0, 0.5), atol=5e-3)
    np.testing.assert_allclose(right, (0, 0, 1, 1), atol=2e-3)


def test_pictures_stand_still_during_playback(camera, drawn, scene):
    scene.frame_set(10)
    first = drawn()
    scene.frame_set(13)
    np.testing.assert_array_equal(drawn(playing=True), first)
    assert np.abs(drawn() - first).max() > 0.1


def test_pictures_hide_what_is_behind_them(camera, drawn):
    """Their depth is in the framebuffer, where splats look for it."""
    depths = []

    def read(framebuffer):
        buffer = framebuffer.read_depth(0, 0, *SIZE)
        buffer.dimensions = SIZE[0] * SIZE[1]
        depths.append(np.frombuffer(memoryview(buffer), np.float32).reshape(SIZE[::-1])[::-1].copy())

    image = drawn(after=read)
    assert (image[..., 3] > 0).any()
    distance = 2.0 * camera.data.lens / camera.data.sensor_width
    np.testing.assert_allclose(depths[0][image[..., 3] > 0], 0.5 + 0.5 * 0.05 * distance, atol=1e-5)
    assert (depths[0][image[..., 3] == 0] == 1).all()


def test_a_missing_picture_is_as_pink_as_everywhere_in_blender(camera, drawn, tmp_path):
    camera.data.background_images[0].image.filepath = str(tmp_path / "gone.png")
    red, green, blue, _ = drawn()[32, 48]
    assert red == blue > green == 0

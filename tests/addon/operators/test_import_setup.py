# SPDX-License-Identifier: GPL-3.0-or-later
"""Import into a new scene sets it up, and F12 then shows what the view shows; a scene in use stays as it is."""
from dataclasses import replace

import bpy
import image_files
import numpy as np
import pytest
from mathutils import Matrix, Vector

LENS = {"width": 64, "height": 48, "fx": 50.0, "fy": 50.0, "cx": 32.0, "cy": 24.0}


def new_scene(empty=False):
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=empty)
    return bpy.context.scene


@pytest.fixture
def path(fg, make_model, model_file, module):
    """A clip of 75 frames at 29.97, filmed from the left."""
    around = module("fastgs_blender.model.surroundings")
    left = around.Viewpoint(**LENS, name="a", distance=4.0, position=(-4.0, 0.0, 0.0), rotation=(0.5, -0.5, 0.5, -0.5))
    model = make_model(300, axes="RFU", clip=fg.Clip(75, 29.97))
    return model_file(replace(model, surroundings=around.Surroundings(None, (left,))))


def set_up(scene):
    return scene.frame_end == 75 and abs(scene.render.fps / scene.render.fps_base - 29.97) < 1e-4 and scene.render.engine == 'FASTGS'


def in_window(run):
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
        return run()


def view_matrices():
    """The 3D view's matrices, made from what it is set to: without a screen Blender computes them for nobody."""
    area = next(area for area in bpy.context.window_manager.windows[0].screen.areas if area.type == 'VIEW_3D')
    return area, area.spaces.active.region_3d


@pytest.mark.parametrize("shape", [(1920, 1080), (1000, 1000), (600, 1200)])
@pytest.mark.parametrize("empty", [False, True])
def test_a_new_scene_is_set_up_and_its_camera_sees_all_that_the_view_shows(path, shape, empty):
    scene = new_scene(empty)
    scene.render.resolution_x, scene.render.resolution_y = shape
    before = set(bpy.data.objects)
    in_window(lambda: bpy.ops.import_scene.fastgs(filepath=path))
    assert set_up(scene) and scene.camera is not None
    assert len(set(bpy.data.objects) - before) == (2 if empty else 1), "the startup file's camera is used"
    bpy.context.view_layer.update()
    area, view = view_matrices()
    region = next(region for region in area.regions if region.type == 'WINDOW')
    eye = view.view_location + view.view_rotation @ Vector((0, 0, view.view_distance))
    assert np.allclose(scene.camera.matrix_world.translation, eye, atol=1e-4)
    turn = view.view_rotation.to_matrix()
    assert np.allclose(scene.camera.matrix_world.to_3x3(), turn, atol=1e-5)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    p = np.array(scene.camera.evaluated_get(depsgraph).calc_matrix_camera(depsgraph, x=shape[0], y=shape[1]))
    sees = np.array([1 / p[0, 0], 1 / p[1, 1]])
    shows = 36 / area.spaces.active.lens * np.array([region.width, region.height]) / max(region.width, region.height)
    assert (sees > shows - 1e-5).all() and np.isclose(sees, shows, rtol=1e-4).any(), "as narrow as that allows"


def moved():
    bpy.data.objects["Camera"].location.x += 1


def more():
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("Mine", None))


def cycles():
    bpy.context.scene.render.engine = 'CYCLES'


def longer():
    bpy.context.scene.frame_end = 100


def another():
    bpy.data.scenes.new("Another")


@pytest.mark.parametrize("change", [moved, more, cycles, longer, another])
def test_a_scene_in_use_stays_until_it_is_asked_for(path, change):
    scene = new_scene()
    change()
    bpy.context.view_layer.update()
    render, camera = scene.render, scene.camera
    before = render.engine, render.fps, scene.frame_end, camera.matrix_world.copy()
    in_window(lambda: bpy.ops.import_scene.fastgs(filepath=path))
    assert (render.engine, render.fps, scene.frame_end, camera.matrix_world) == before and scene.camera == camera
    in_window(bpy.ops.fastgs.set_up_scene)
    assert set_up(scene) and scene.camera != camera and camera.matrix_world == before[3]


def test_what_was_chosen_counts(path):
    scene = new_scene()
    in_window(lambda: bpy.ops.import_scene.fastgs(filepath=path, use_engine=False, camera=False))
    assert scene.render.engine != 'FASTGS' and scene.frame_end == 75 and scene.camera.location.x > 7


def test_f12_after_the_import_shows_what_the_view_shows(fg, path, tmp_path):
    """The picture is the library's from the view's own place, at the view's own angle along the side that fits."""
    scene = new_scene()
    scene.render.resolution_x, scene.render.resolution_y = 96, 54
    scene.render.film_transparent = True
    in_window(lambda: bpy.ops.import_scene.fastgs(filepath=path))
    image_files.set_output(scene, "PNG")
    scene.render.filepath = str(tmp_path / "f12.png")
    bpy.ops.render.render(write_still=True)
    picture = image_files.read_png(scene.render.filepath)
    area, view = view_matrices()
    pose = np.array(Matrix.LocRotScale(
        view.view_location + view.view_rotation @ Vector((0, 0, view.view_distance)), view.view_rotation, None))
    region = next(region for region in area.regions if region.type == 'WINDOW')
    shows = 36 / area.spaces.active.lens * np.array([region.width, region.height]) / max(region.width, region.height)
    focal = min(48 / shows[0], 27 / shows[1])
    camera = fg.Camera(96, 54, focal, focal, 48, 27, np.diag([1.0, -1, -1, 1]) @ np.linalg.inv(pose), near=0.01)
    wanted = fg.render(fg.load(path), camera)
    assert np.abs(picture[..., 3] / 255 - wanted["alpha"]).max() < 0.02 and picture[..., 3].max() > 200

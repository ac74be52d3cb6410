# SPDX-License-Identifier: GPL-3.0-or-later
"""An import is seen at once: from a good side, framed by its subject, with nothing of the startup file before it."""
from dataclasses import replace
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Quaternion, Vector
from panel_recorder import Layout

LENS = {"width": 64, "height": 48, "fx": 50.0, "fy": 50.0, "cx": 32.0, "cy": 24.0}
LEFT = {"position": (-4.0, 0.0, 0.0), "rotation": (0.5, -0.5, 0.5, -0.5)}  # looks along +x of a world with z up, right is -y


@pytest.fixture
def startup():
    """Blender's startup file, in its window."""
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
        yield bpy.context.scene


@pytest.fixture
def around(module):
    return module("fastgs_blender.model.surroundings")


@pytest.fixture
def filmed(fg, make_model, around):
    """A model before a far backdrop, filmed from the left and, nearer to the middle of all cameras, from further left."""
    left, further, above = (around.Viewpoint(**LENS, name=name, distance=4.0, **LEFT) for name in "abc")
    further = replace(further, position=(-5.0, 0.0, 0.0), distance=5.0)
    above = replace(above, position=(-6.0, 0.0, 0.0), distance=6.0)
    model = make_model(300, axes="RFU")
    model.position[200:] *= 60 / np.linalg.norm(model.position[200:], axis=1, keepdims=True)
    return replace(model, surroundings=around.Surroundings(around.Backdrop(radius=50.0), (left, further, above)))


def view():
    return next(area for area in bpy.context.window.screen.areas if area.type == 'VIEW_3D').spaces.active.region_3d


def pose():
    """(eye, forward) of the 3D view."""
    turn = view().view_rotation
    return view().view_location + turn @ Vector((0, 0, view().view_distance)), turn @ Vector((0, 0, -1))


def test_it_is_seen_from_where_it_was_filmed(startup, filmed, model_file):
    assert bpy.ops.import_scene.fastgs(filepath=model_file(filmed)) == {'FINISHED'}
    eye, forward = pose()
    assert np.allclose(forward, (1, 0, 0), atol=1e-5) and np.allclose(view().view_location, (0, 0, 0), atol=1e-4)
    assert -5.001 < eye.x < -1.5  # where the middle camera stood, or nearer, so that the subject is large


def test_the_authors_view_comes_first_and_moves_with_the_object(startup, filmed, model_file, around):
    good = around.Viewpoint(**LENS, position=(0.0, -7.0, 0.0), rotation=(0.5**0.5, -(0.5**0.5), 0.0, 0.0), distance=7.0)
    bpy.ops.import_scene.fastgs(filepath=model_file(replace(filmed, surroundings=replace(filmed.surroundings, view=good))))
    eye, forward = pose()
    assert np.allclose(eye, (0, -7, 0), atol=1e-4) and np.allclose(forward, (0, 1, 0), atol=1e-5)
    bpy.context.object.matrix_world = Matrix.Translation((10, 0, 0)) @ Matrix.Scale(2, 4)
    assert bpy.ops.fastgs.frame_capture() == {'FINISHED'}
    eye, forward = pose()
    assert np.allclose(eye, (10, -14, 0), atol=1e-3) and np.allclose(view().view_location, (10, 0, 0), atol=1e-3)


def test_without_cameras_the_subject_is_framed_from_this_side(startup, make_model, model_file):
    model = make_model(300)
    model.position[:] += (20, 0, 0)
    model.position[:5] += 1000  # strays
    before = view().view_rotation.copy()
    bpy.ops.import_scene.fastgs(filepath=model_file(model))
    assert view().view_rotation == before and (view().view_location - Vector((20, 0, 0))).length < 0.5
    assert 1 < view().view_distance < 10


def test_without_cameras_long_gaussians_tell_where_they_stood(startup, make_model, model_file):
    """They point at a camera far to the left of the model, in the world of the object, which is moved."""
    model = make_model(1000, axes="RFU")
    turns = [Vector((-9, 0, 1) - place).to_track_quat('X', 'Z') for place in model.position.astype(float)]
    model = replace(model, rotation=np.array(turns), scale=np.log(np.full((1000, 3), 0.03)) + np.log([10, 1, 1]))
    bpy.ops.import_scene.fastgs(filepath=model_file(model))
    eye, forward = pose()
    assert forward.dot(Vector((9, 0, -1)).normalized()) > 0.97 and eye.x < -2 and view().view_location.length < 0.2
    bpy.context.object.matrix_world = Matrix.Translation((10, 0, 0)) @ Matrix.Rotation(np.pi / 2, 4, 'Z')
    assert bpy.ops.fastgs.frame_capture() == {'FINISHED'}
    assert pose()[1].dot(Vector((0, 9, -1)).normalized()) > 0.97 and (view().view_location - Vector((10, 0, 0))).length < 0.2


def test_views_through_a_camera_and_asked_ones_stay(startup, filmed, model_file):
    path, before = model_file(filmed), view().view_matrix.copy()
    bpy.ops.import_scene.fastgs(filepath=path, view='KEEP')
    assert view().view_matrix == before and not startup.objects["Cube"].hide_get()
    view().view_perspective = 'CAMERA'
    bpy.ops.import_scene.fastgs(filepath=path)
    assert view().view_perspective == 'CAMERA' and startup.camera.name == "Camera"


def test_looking_through_a_capture_camera(startup, filmed, model_file, capfd):
    bpy.ops.import_scene.fastgs(filepath=model_file(filmed), view='CAMERA')
    camera = startup.camera
    assert (camera.name, camera.data.fastgs.view, view().view_perspective) == ("b", "b", 'CAMERA')
    assert np.allclose(camera.matrix_world.translation, (-5, 0, 0), atol=1e-5)
    assert np.allclose(camera.matrix_world.to_quaternion() @ Vector((0, 0, -1)), (1, 0, 0), atol=1e-5)
    bpy.context.view_layer.objects.active = startup.objects["model"]
    assert bpy.ops.fastgs.look_through(index=0) == {'FINISHED'} and startup.camera.name == "a"

    plain = replace(filmed, surroundings=replace(filmed.surroundings, cameras=()))
    bpy.ops.import_scene.fastgs(filepath=model_file(plain, "plain.safetensors"), view='CAMERA')
    assert "where cameras" in capfd.readouterr().out and startup.camera.name == "a"
    with pytest.raises(RuntimeError, match="where.*cameras"):
        bpy.ops.fastgs.look_through()


@pytest.mark.parametrize("change", [None, "between", "moved", "renamed", "far"])
def test_the_startup_cube_is_hidden_where_it_is_nobodys_and_in_the_way(startup, filmed, model_file, change, capfd):
    cube = startup.objects["Cube"]
    if change == "moved":
        cube.location.x = 0.5
    if change == "renamed":
        cube.name = "Mine"
    if change in ("far", "between"):  # behind those who look at it, or before them, with the cube on the way
        filmed.position[:200] += (-30 if change == "far" else 30, 0, 0)
    bpy.context.view_layer.update()
    bpy.ops.import_scene.fastgs(filepath=model_file(filmed))
    assert cube.hide_get() is cube.hide_render is (change in (None, "between"))
    assert ("is hidden" in capfd.readouterr().out) is cube.hide_get()


def test_the_view_is_stored_in_the_file(startup, fg, filmed, model_file):
    path = model_file(filmed)
    bpy.ops.import_scene.fastgs(filepath=path)
    obj = bpy.context.object
    obj.matrix_world = Matrix.Translation((1, 2, 3)) @ Matrix.Scale(3, 4)
    view().view_rotation, view().view_location, view().view_distance = Quaternion((0.9, 0.3, 0.1, 0.2)).normalized(), (1, 2, 4), 9.0
    area = next(area for area in bpy.context.window.screen.areas if area.type == 'VIEW_3D')
    with bpy.context.temp_override(area=area):
        assert bpy.ops.fastgs.store_view() == {'FINISHED'}
    wanted = pose()
    stored = fg.load(path)
    assert all(np.array_equal(a, filmed.arrays[name]) for name, a in stored.arrays.items())
    assert stored.surroundings.view.distance == pytest.approx(3.0) and stored.surroundings.cameras == filmed.surroundings.cameras
    view().view_rotation, view().view_distance = (1, 0, 0, 0), 40.0
    bpy.ops.fastgs.frame_capture()
    for now, before in zip(pose(), wanted):
        assert np.allclose(now, before, atol=1e-3)
    fg.save(filmed, path.replace("safetensors", "ply"))
    bpy.ops.import_scene.fastgs(filepath=path.replace("safetensors", "ply"))
    with bpy.context.temp_override(area=area), pytest.raises(RuntimeError, match="fastgs convert"):
        bpy.ops.fastgs.store_view()


def test_the_colours_are_said_and_changed_by_a_button_alone(startup, filmed, model_file, capfd):
    path = model_file(filmed)
    bpy.ops.import_scene.fastgs(filepath=path)
    assert capfd.readouterr().out.count("Standard shows them as they were filmed") == 1
    assert startup.view_settings.view_transform == 'AgX'
    assert bpy.ops.fastgs.use_standard() == {'FINISHED'} and startup.view_settings.view_transform == 'Standard'
    bpy.ops.import_scene.fastgs(filepath=path)
    startup.view_settings.view_transform, startup.view_settings.exposure = 'AgX', 0.5  # somebody's choice
    bpy.ops.import_scene.fastgs(filepath=path)
    assert "Standard shows them" not in capfd.readouterr().out


def test_a_scene_that_shows_captures_otherwise_says_so_where_artists_look(startup, filmed, model_file, module):
    """In the sidebar and in the object's properties: a button for the engine, and one for the view transform."""
    bpy.ops.import_scene.fastgs(filepath=model_file(filmed))
    panels = module("ui.splats_panel").FASTGS_PT_splats, module("ui.object_panels").FASTGS_PT_object
    colours, other = "fastgs.use_standard", "wm.context_set_enum"
    for transform, engine, wanted in (('AgX', 'CYCLES', {colours, other}), ('AgX', 'FASTGS', {colours}), ('Standard', 'FASTGS', set())):
        startup.view_settings.view_transform = transform
        context = SimpleNamespace(object=bpy.context.object, scene=startup, engine=engine, screen=SimpleNamespace(areas=[]),
                                  region=SimpleNamespace(width=280))
        for panel in panels:
            layout = Layout()
            panel.draw(SimpleNamespace(layout=layout), context)
            assert {colours, other} & {text for kind, text, _ in layout.record if kind == "operator"} == wanted, (panel, transform, engine)


def test_a_still_changes_no_range_and_has_no_time(startup, make_model, model_file):
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model()), set_scene_range=True)
    assert (startup.frame_start, startup.frame_end, startup.render.fps) == (1, 250, 24)
    assert not bpy.ops.fastgs.fit_scene.poll()
    assert not bpy.types.FASTGS_PT_object_time.poll(bpy.context) and not bpy.types.FASTGS_PT_object_sound.poll(bpy.context)
    bpy.context.object.fastgs.frame_count = 2
    assert bpy.ops.fastgs.fit_scene.poll() and bpy.types.FASTGS_PT_object_time.poll(bpy.context)


def test_the_example_fills_the_view(startup):
    bpy.ops.fastgs.import_example()
    area = next(area for area in bpy.context.window.screen.areas if area.type == 'VIEW_3D')
    region = next(region for region in area.regions if region.type == 'WINDOW')
    obj, (eye, _) = bpy.context.object, pose()
    dancer = [place for place in (obj.matrix_world @ v.co for v in obj.data.vertices) if place.xy.length < 0.5 and 0.05 < place.z < 2.2]
    seen = np.array([view().view_rotation.inverted() @ (place - eye) for place in dancer])
    height = np.ptp(-seen[:, 1] / seen[:, 2]) * area.spaces.active.lens / 72 * max(region.width, region.height)
    assert region.height / 3 < height < region.height and obj.fastgs.camera_count == 12 and startup.objects["Cube"].hide_get()

# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera moves in Blender: smooth between their keys, ordinary keyframes, undone by deleting them."""
import numpy as np
import pytest
from camera_tracks import assert_smooth, keyed, track


@pytest.fixture
def bpy(addon):
    import bpy

    return bpy


@pytest.fixture
def cube(scene, bpy):
    """A mesh of size 2 around (1, 2, 3): what a move is about."""
    mesh = bpy.data.meshes.new("Cube")
    mesh.from_pydata([(x, y, z) for x in (0, 2) for y in (1, 3) for z in (2, 4)], [], [])
    obj = bpy.data.objects.new("Cube", mesh)
    scene.collection.objects.link(obj)
    obj.select_set(True)
    bpy.context.view_layer.objects.active = obj
    bpy.context.view_layer.update()
    return obj


def test_an_orbit_is_a_circle_of_ordinary_keys(bpy, scene, module, cube, add_camera):
    camera = add_camera(location=(1, -4, 3), rotation=(90, 0, 0))
    bpy.context.view_layer.update()
    scene.frame_start, scene.frame_end = 1, 61
    assert bpy.ops.fastgs.camera_orbit(turns=1.0, spacing=6) == {'FINISHED'}
    rows = track(scene, camera)
    np.testing.assert_allclose(np.linalg.norm(rows[:, :3] - [1, 2, 3], axis=1), 6, rtol=2e-3)
    away = ([1, 2, 3] - rows[:, :3]) / 6
    assert (rows[:, 3:6] * away).sum(1).min() > 0.9995
    assert_smooth(rows)
    frames = sorted({point.co.x for curve in keyed(module, camera) for point in curve.keyframe_points})
    assert frames == [1, 7, 13, 19, 25, 31, 37, 43, 49, 55, 61]


def test_eased_orbits_start_and_stop_gently(bpy, scene, cube, add_camera):
    camera = add_camera(location=(1, -4, 3))
    scene.frame_start, scene.frame_end = 1, 61
    bpy.context.view_layer.update()
    bpy.ops.fastgs.camera_orbit(turns=0.5, ease=1.0, spacing=4)
    speed = np.linalg.norm(np.diff(track(scene, camera)[:, :3], axis=0), axis=1)
    assert speed[0] < 0.05 * speed.max() > speed[-1]


def test_a_preview_is_a_curve_and_nothing_else(bpy, scene, cube, add_camera):
    camera = add_camera()
    bpy.ops.fastgs.camera_orbit(preview=True)
    curve = [o for o in scene.objects if o.type == 'CURVE']
    assert len(curve) == 1 and curve[0].hide_render and camera.animation_data is None
    bpy.ops.fastgs.camera_orbit()
    assert not [o for o in scene.objects if o.type == 'CURVE'] and camera.animation_data is not None


@pytest.mark.parametrize(("order", "wanted"), [('PLACE', [0, 1, 2, 3]), ('NAME', [2, 0, 3, 1])])
def test_a_path_goes_by_place_or_by_name(bpy, scene, add_camera, order, wanted):
    scene.frame_start, scene.frame_end = 1, 100
    for x, name in enumerate(("cam9", "cam100", "cam1", "cam20")):
        camera = add_camera(location=(x, 0, 0))
        camera.name = name
        camera.select_set(True)
    bpy.context.view_layer.objects.active = bpy.data.objects["cam9"]
    bpy.context.view_layer.update()
    assert bpy.ops.fastgs.camera_through(order=order, spacing=3) == {'FINISHED'}
    rows = track(scene, scene.camera)[:, 0]
    assert [np.abs(rows - x).argmin() for x in wanted] == sorted(np.abs(rows - x).argmin() for x in wanted)
    np.testing.assert_allclose(rows[[0, -1]], [wanted[0], wanted[-1]], atol=1e-3)


@pytest.mark.parametrize("mode", ['XYZ', 'QUATERNION', 'AXIS_ANGLE'])
def test_a_path_goes_through_the_selected_cameras(bpy, scene, module, add_camera, mode):
    scene.frame_start, scene.frame_end = 1, 91
    poses = []
    for i in range(4):
        camera = add_camera(location=(4 * np.cos(i), 4 * np.sin(i), 0.5 * i), rotation=(90, 0, 90 + np.degrees(i)), lens=35 + 5 * i)
        camera.name = f"cam{i}"
        camera.select_set(True)
        poses.append(camera)
    scene.camera.rotation_mode = mode
    bpy.context.view_layer.update()
    assert bpy.ops.fastgs.camera_through(spacing=3) == {'FINISHED'}
    moving = scene.camera
    assert moving not in poses
    rows = track(scene, moving)
    assert_smooth(rows)
    for camera in poses:
        nearest = np.linalg.norm(rows[:, :3] - np.array(camera.location), axis=1).argmin()
        np.testing.assert_allclose(rows[nearest, :3], camera.location, atol=0.03)
        assert rows[nearest, 3:6] @ -np.array(camera.matrix_world)[:3, 2] > 0.999 and abs(rows[nearest, 6] - camera.data.lens) < 0.5
    speed = np.linalg.norm(np.diff(rows[:, :3], axis=0), axis=1)
    assert speed.max() / speed.min() < 1.2


def test_keys_outside_the_range_stay_and_those_within_are_replaced(bpy, scene, module, cube, add_camera):
    camera = add_camera(location=(1, -4, 3))
    for at, x in ((0, 5.0), (20, 9.0), (200, 7.0)):
        camera.location.x = x
        camera.keyframe_insert("location", frame=at)
    bpy.ops.fastgs.camera_orbit(frame_start=10, frame_end=40, spacing=10)
    points = {p.co.x: p.co.y for p in keyed(module, camera).find("location", index=0).keyframe_points}
    assert sorted(points) == [0, 10, 20, 30, 40, 200] and points[0] == 5 and points[200] == 7 and points[20] != 9


def test_a_parented_camera_goes_the_same_way(bpy, scene, cube, add_camera):
    scene.frame_start, scene.frame_end = 1, 31
    camera = add_camera(location=(1, -4, 3))
    parent = bpy.data.objects.new("Parent", None)
    parent.location, parent.rotation_euler = (3, 1, -2), (0.4, 0.2, 1.0)
    scene.collection.objects.link(parent)
    camera.parent = parent
    bpy.context.view_layer.update()
    bpy.ops.fastgs.camera_orbit(radius=6.0, frame_start=1, frame_end=31, spacing=3)
    rows = track(scene, camera)
    np.testing.assert_allclose(np.linalg.norm(rows[:, :3] - [1, 2, 3], axis=1), 6, rtol=2e-3)


def test_leaving_the_capture_warns_and_can_be_forbidden(bpy, scene, module, cube, add_camera):
    for i in range(6):
        camera = add_camera(location=(1 + 3 * np.cos(i), 2 + 3 * np.sin(i), 3 + 0.2 * i))
        camera.data.fastgs.view = f"cam{i}"
    moving = add_camera(location=(1, -4, 3))
    bpy.context.view_layer.update()
    scene.frame_start, scene.frame_end = 1, 41
    options = dict(radius=6.0, elevation=0.0, frame_start=1, frame_end=41, margin=0.5)
    bpy.ops.fastgs.camera_orbit(**options)
    assert np.linalg.norm(track(scene, moving)[:, :3] - [1, 2, 3], axis=1).min() > 5.9
    bpy.ops.fastgs.camera_orbit(stay_inside=True, spacing=2, **options)
    assert np.linalg.norm(track(scene, moving)[:, :3] - [1, 2, 3], axis=1).max() < 4.0


def test_a_dolly_zoom_keeps_the_subject(bpy, scene, cube, add_camera):
    camera = add_camera(location=(1, -4, 3), lens=40)
    bpy.context.view_layer.update()
    scene.frame_start, scene.frame_end = 1, 25
    bpy.ops.fastgs.camera_dolly(distance=3.0, zoom=True, spacing=4)
    rows = track(scene, camera)
    np.testing.assert_allclose(rows[:, 6] / (2 - rows[:, 1]), 40 / 6, rtol=5e-3)
    np.testing.assert_allclose(rows[-1, :3], (1, -1, 3), atol=1e-4)
    with pytest.raises(RuntimeError, match="dolly zoom"):
        bpy.ops.fastgs.camera_dolly(distance=30.0, zoom=True)


@pytest.mark.parametrize(("move", "options"), [
    ("camera_orbit", dict(turns=0.6, ease=0.5)), ("camera_dolly", dict(distance=2.0, ease=1.0)),
    ("camera_dolly", dict(distance=2.0, zoom=True)), ("camera_through", {}), ("camera_through", dict(closed=True, ease=0.3))])
def test_moves_are_smooth_and_stay_editable(bpy, scene, module, cube, add_camera, move, options):
    """Ordinary keys and nothing else: a key that is moved moves the camera there, and leaves it alone beyond its neighbours."""
    for i in range(4):
        place = (1 + 6 * np.sin(i), 2 - 6 * np.cos(i), 3 + 0.3 * i)
        add_camera(location=place, rotation=(90, 0, np.degrees(i)), lens=35 + i).select_set(True)
    bpy.context.view_layer.update()
    scene.frame_start, scene.frame_end = 1, 81
    assert getattr(bpy.ops.fastgs, move)(spacing=8, frame_start=1, frame_end=81, **options) == {'FINISHED'}
    camera = scene.camera
    before = track(scene, camera, 4)
    assert_smooth(before)
    assert not camera.constraints and not camera.animation_data.drivers and all(not curve.modifiers for curve in keyed(module, camera))
    curve = keyed(module, camera).find("location", index=2)
    frames = [point.co.x for point in curve.keyframe_points]
    assert frames == [1, 11, 21, 31, 41, 51, 61, 71, 81] or frames == list(range(1, 82, 8))
    middle = len(frames) // 2
    point = curve.keyframe_points[middle]
    for part in ("co", "handle_left", "handle_right"):
        getattr(point, part).y += 0.5
    curve.update()
    moved = track(scene, camera, 4)[:, 2] - before[:, 2]
    at = np.arange(scene.frame_start, scene.frame_end + 1e-9, 0.25)
    assert abs(moved[at == frames[middle]][0] - 0.5) < 1e-4
    assert np.abs(moved[(at <= frames[middle - 1]) | (at >= frames[middle + 1])]).max() < 1e-4


def test_strays_and_a_far_background_are_not_what_a_move_is_about(bpy, scene, module, make_model, model_file):
    """As trained models have them: a third of the splats on a sphere far away."""
    model = make_model(900, spread=1.0)
    model.position[:600] += (5, 0, 0)
    rng = np.random.default_rng(0)
    sphere = rng.normal(size=(300, 3))
    model.position[600:] = 40 * sphere / np.linalg.norm(sphere, axis=1)[:, None]
    bpy.ops.import_scene.fastgs(filepath=model_file(model), orientation='KEEP')
    middle, radius = module("scene.cameras.subjects").subject_of(bpy.context)
    assert (middle - type(middle)((5, 0, 0))).length < 0.2 and 1.2 < radius < 2.2
    bpy.ops.fastgs.camera_orbit(new_camera=True)
    # all but a few of those that count are in the picture
    from bpy_extras.object_utils import world_to_camera_view

    splats = next(o for o in scene.objects if o.type == 'MESH')
    seen = [world_to_camera_view(scene, scene.camera, splats.matrix_world @ type(middle)(p)) for p in model.position[:600].tolist()]
    places = np.array(seen)
    inside = ((places[:, :2] > 0) & (places[:, :2] < 1)).all(1) & (places[:, 2] > 0)
    assert inside.mean() > 0.97 and np.ptp(places[:, 1]) > 0.3


@pytest.mark.parametrize("operator", ["camera_orbit", "camera_dolly"])
def test_a_range_too_long_is_refused_at_once(bpy, scene, add_camera, operator):
    add_camera()
    before = len(bpy.data.actions)
    for first, last in ((-2**31, 2**31 - 1), (1, 50_001), (5, 5), (5, 4)):
        with pytest.raises(RuntimeError, match="50000|after") as error:
            getattr(bpy.ops.fastgs, operator)(frame_start=first, frame_end=last)
        assert len(str(error.value).strip().splitlines()) == 1
    assert len(bpy.data.actions) == before


def test_an_export_too_long_is_refused_at_once(bpy, scene, add_camera, tmp_path):
    scene.camera = add_camera()
    with pytest.raises(RuntimeError, match="50000"):
        bpy.ops.fastgs.export_camera_path(filepath=str(tmp_path / "a.json"), use_range=True, frame_start=-2**31, frame_end=2**31 - 1)


@pytest.fixture
def filmed(bpy, fg, module, make_model, model_file, scene):
    """filmed(*degrees): an imported model at the origin, filmed from these angles around it."""
    from dataclasses import replace

    around = module("fastgs_blender.model.surroundings")
    lens = {"width": 64, "height": 48, "fx": 50.0, "fy": 50.0, "cx": 32.0, "cy": 24.0, "rotation": (1.0, 0.0, 0.0, 0.0)}

    def make(*degrees):
        cameras = [around.Viewpoint(**lens, name=str(a), distance=4.0, position=(5 * np.cos(np.radians(a)), 5 * np.sin(np.radians(a)), 1.0))
                   for a in degrees]
        model = replace(make_model(300, axes="RFU"), surroundings=around.Surroundings(None, tuple(cameras)))
        bpy.ops.import_scene.fastgs(filepath=model_file(model), view='KEEP', camera=False)
        scene.frame_start, scene.frame_end = 1, 101
        return bpy.context.object

    return make


@pytest.mark.slow
def test_an_orbit_that_leaves_the_filmed_side_says_so_and_offers_the_arc_that_does_not(bpy, scene, filmed, add_camera, capfd):
    """Filmed from -130 to -50 degrees: a turn that begins at -90 leaves the side, and 15 degrees beside it, after 55 of 360 degrees."""
    filmed(-130, -90, -50)
    camera = add_camera(location=(0, -6, 1))
    bpy.context.view_layer.update()
    bpy.ops.fastgs.camera_orbit(turns=1.0, spacing=5)
    said = capfd.readouterr().out
    assert "frame 17 on" in said and "110 degrees" in said and "Stay on Filmed Side" in said
    for turns in (1.0, -1.0):
        camera.animation_data_clear()
        bpy.ops.fastgs.camera_orbit(turns=turns, spacing=5, filmed_side=True)
        rows = track(scene, camera)
        angles = np.degrees(np.arctan2(rows[:, 1], rows[:, 0]))
        ends = (-145, -35) if turns > 0 else (-35, -145)
        assert np.allclose(angles[[0, -1]], ends, atol=3) and angles.min() > -148 and angles.max() < -32
        assert "leaves" not in capfd.readouterr().out
    camera.animation_data_clear()
    camera.location = (0, -6, 1)
    bpy.context.view_layer.update()
    bpy.ops.fastgs.camera_orbit(turns=0.1)
    assert "leaves" not in capfd.readouterr().out


@pytest.mark.parametrize("degrees", [(0, 90, 180, 270), (0, 115, 240)])
def test_what_was_filmed_from_all_around_has_no_side(bpy, filmed, add_camera, capfd, degrees):
    filmed(*degrees)
    add_camera(location=(0, -6, 1))
    bpy.context.view_layer.update()
    bpy.ops.fastgs.camera_orbit(turns=1.0)
    assert "leaves" not in capfd.readouterr().out


def test_a_side_that_long_gaussians_tell_is_kept_to(bpy, fg, scene, make_model, model_file, add_camera, capfd):
    """All of the model lies to one side of its origin: that is where it was filmed from."""
    rng = np.random.default_rng(0)
    model = make_model(400, axes="RFU", position=rng.uniform(-1, 1, (400, 3)) + [0, 4, 0])
    bpy.ops.import_scene.fastgs(filepath=model_file(model), view='KEEP', camera=False)
    scene.frame_start, scene.frame_end = 1, 101
    add_camera(location=(0, -2, 0))
    bpy.context.view_layer.update()
    bpy.ops.fastgs.camera_orbit(turns=0.5)
    assert "leaves the side" in capfd.readouterr().out
    bpy.ops.fastgs.camera_orbit(turns=0.5, filmed_side=True)
    assert "leaves the side" not in capfd.readouterr().out

# SPDX-License-Identifier: GPL-3.0-or-later
"""bpy.ops.fastgs.bake: what Blender shows becomes 4D Gaussians, and the user's scene stays as it was."""
import re
import threading
from pathlib import Path

import bpy
import numpy as np
import pytest
from by_hand import srgb

FRAMES = 12


def key(owner, path, values, index=-1):
    """Keyframes of a property on the first frames, linear between them."""
    for frame, value in enumerate(values, 1):
        if index < 0:
            setattr(owner, path, value)
        else:
            getattr(owner, path)[index] = value
        owner.keyframe_insert(path, index=index, frame=frame)


def surface_at(objects, frame):
    """A search tree of the evaluated surface on a frame, in world space."""
    from mathutils.bvhtree import BVHTree

    bpy.context.scene.frame_set(int(frame // 1), subframe=frame % 1)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    points, polygons = [], []
    for obj in objects:
        evaluated = obj.evaluated_get(depsgraph)
        mesh = evaluated.to_mesh()
        polygons += [[i + len(points) for i in p.vertices] for p in mesh.polygons]
        points += [evaluated.matrix_world @ v.co for v in mesh.vertices]
        evaluated.to_mesh_clear()
    return BVHTree.FromPolygons(points, polygons)


def distances(model, fg, tree, t, every=1):
    return np.array([tree.find_nearest(p)[3] for p in fg.slice_model(model, t).position[::every].tolist()])


def test_a_moving_turning_cube(bake, add, fg, scene):
    cube = add("cube", size=2)
    key(cube, "location", [(0.1 * f, 0, 0.5 * np.sin(f / 3)) for f in range(FRAMES)])
    key(cube, "rotation_euler", np.linspace(0, 2, FRAMES), 2)
    model = bake(cube)
    assert (model.clip.frame_count, model.clip.fps, model.clip.start_frame, model.axes) == (FRAMES, 24, 1, "RFU")
    for frame in (1, 4.5, 9, 11.5):
        assert distances(model, fg, surface_at([cube], frame), (frame - 1) / FRAMES).mean() < 0.02


def test_what_rigs_shape_keys_and_modifiers_make(bake, add, fg, scene):
    """Everything that keeps its topology is followed as it is evaluated."""
    grid = add("grid", x_subdivisions=8, y_subdivisions=8)
    grid.shape_key_add(name="Basis")
    shape = grid.shape_key_add(name="Hill")
    for point in shape.data:
        point.co.z = np.cos(point.co.x) * np.cos(point.co.y)
    key(shape, "value", np.linspace(0, 1, FRAMES))
    bpy.ops.object.armature_add(location=(4, 0, 0))
    rig = bpy.context.object
    tube = add("cylinder", location=(4, 0, 0.5), depth=1)
    group = tube.vertex_groups.new(name=rig.data.bones[0].name)
    group.add([v.index for v in tube.data.vertices if v.co.z > 0], 1.0, 'REPLACE')
    tube.modifiers.new("Rig", 'ARMATURE').object = rig
    tube.modifiers.new("Smooth", 'SUBSURF').levels = 1
    bone = rig.pose.bones[0]
    bone.rotation_mode = 'XYZ'
    key(bone, "rotation_euler", [(0, 0, 0.08 * f) for f in range(FRAMES)])
    model = bake(grid, tube, count=800)
    for frame in (1, 6.5, 12):
        assert distances(model, fg, surface_at([grid, tube], frame), (frame - 1) / FRAMES).mean() < 0.02
    assert surface_at([tube], 1).find_nearest((4, 1, 1))[0] != surface_at([tube], 12).find_nearest((4, 1, 1))[0]


def test_curves_text_and_instances(bake, add, fg, scene):
    bpy.ops.object.text_add()
    text = bpy.context.object
    text.data.extrude = 0.1
    ball = add("ico_sphere", location=(0, 0, 9), radius=0.2)
    collection = bpy.data.collections.new("Balls")
    scene.collection.objects.unlink(ball)
    collection.objects.link(ball)
    empties = []
    for x in (3, 5):
        empty = bpy.data.objects.new("Instance", None)
        empty.instance_type, empty.instance_collection, empty.location = 'COLLECTION', collection, (x, 0, -9)
        scene.collection.objects.link(empty)
        empties.append(empty)
    position = bake(text, *empties, count=600).position
    near = [np.linalg.norm(position - (x, 0, 0), axis=1) < 0.25 for x in (3, 5)]
    assert near[0].sum() > 40 and near[1].sum() > 40
    letters = position[~near[0] & ~near[1]]
    assert len(letters) > 200 and letters[:, 0].max() < 2.5


def test_the_scene_is_left_as_it_was(bake, add, paint, scene):
    cube, other = add("cube"), add("cube", location=(3, 0, 0))
    paint(cube)
    key(cube, "location", [(0, 0, 0.1 * f) for f in range(FRAMES)])
    scene.frame_set(3, subframe=0.25)
    bpy.context.view_layer.objects.active = other

    def state():
        return (scene.frame_current, scene.frame_subframe, scene.frame_start, scene.frame_end, scene.render.engine,
                [(o.name, o.select_get(), o.hide_render, o.matrix_world.copy().freeze()) for o in scene.objects],
                bpy.context.view_layer.objects.active, bpy.context.mode,
                {name: len(getattr(bpy.data, name)) for name in ("objects", "meshes", "materials", "scenes", "images", "worlds")})

    cube.select_set(True)
    other.select_set(False)
    bpy.context.view_layer.update()
    before = state()
    for lighting in ('NONE', 'CYCLES'):
        bake(cube, lighting=lighting, light_samples=6, light_frames=2, count=50, import_result=False, overwrite=True)
        assert state() == before


def test_the_result_is_imported(bake, add, scene, target):
    cube = add("cube")
    key(cube, "location", [(0, 0, 0.1 * f) for f in range(FRAMES)])
    bake(cube, frame_start=4, frame_end=9)
    made = bpy.context.object
    assert made is not cube and made.select_get() and not cube.select_get()
    assert bpy.path.abspath(made.fastgs.filepath) == target
    assert (made.fastgs.gaussian_count, made.fastgs.frame_count, made.fastgs.start_frame) == (400, 6, 4)
    assert np.allclose(made.matrix_world, np.eye(4))


def test_the_source_is_hidden_or_left_and_the_scene_remembers(bake, add, scene):
    cube = add("cube")
    bake(cube)
    assert not cube.hide_get() and not cube.hide_render
    bake(cube, hide_source=True, overwrite=True)
    assert cube.hide_get() and cube.hide_render and not bpy.context.object.hide_render
    other = add("cube")
    bake(other, overwrite=True)  # the scene remembers
    assert other.hide_get() and other.hide_render
    third = add("cube")
    bake(third, hide_source=False, overwrite=True)
    assert not third.hide_get() and not scene.fastgs.hide_baked


def test_the_worst_place_is_named(bake, add, scene, capfd):
    """The vertex group, in rigs a bone, and the frame at which the Gaussians are off most."""
    grid = add("grid", x_subdivisions=10, y_subdivisions=10)
    grid.name = "Kite"
    group = grid.vertex_groups.new(name="Tip")
    tip = [v.index for v in grid.data.vertices if v.co.x > 0.5 and v.co.y > 0.5]
    group.add(tip, 1.0, 'REPLACE')
    grid.shape_key_add(name="Basis")
    shape = grid.shape_key_add(name="Flap")
    for index in tip:
        shape.data[index].co.z += 0.5
    key(shape, "value", [0] * 5 + [1] + [0] * 6)
    bake(grid, samples_per_frame=1)
    assert re.search(r'Warning: .* worst at "Kite", vertex group "Tip", on frame [5-7]', capfd.readouterr().out)


def test_baked_and_rendered_at_its_place(bake, add, paint, add_camera, scene, render):
    """The picture of the Gaussians is that of the mesh: a red cube left, a green one right, nothing elsewhere."""
    left, right = add("cube", location=(-1, 0, 0), size=1), add("cube", location=(1, 0, 0), size=1)
    paint(left, (1, 0, 0))
    paint(right, (0, 1, 0))
    add_camera((0, -6, 0))
    scene.render.film_transparent = True
    bake(left, right, count=3000)
    picture = render("PNG").astype(int)
    assert np.array_equal(picture[24, 20], (255, 0, 0, 255)) or abs(picture[24, 20] - (255, 0, 0, 255)).max() <= 2
    assert abs(picture[24, 43] - (0, 255, 0, 255)).max() <= 2
    assert picture[24, 32, 3] == 0 and picture[2, 2, 3] == 0


@pytest.mark.parametrize(("change", "sentence"), [("vertices", "vertices instead of"), ("parts", "same parts")])
def test_changing_topology_is_refused_with_name_and_frame(bake, add, scene, target, change, sentence):
    cube = add("cube")
    cube.name = "Lava Lamp"
    if change == "vertices":
        array = cube.modifiers.new("Array", 'ARRAY')
        key(array, "count", [1] * 6 + [2] * 6)
    else:
        key(cube, "hide_viewport", [False] * 6 + [True] * 6)
    scene.frame_set(1)
    with pytest.raises(RuntimeError, match=f'"Lava Lamp".*{sentence}.*frame [67]'):
        bake(cube)
    assert not Path(target).exists() and scene.frame_current == 1
    assert len(scene.objects) == 1


def test_existing_files_and_bad_folders(bake, add, target):
    cube = add("cube")
    Path(target).write_text("mine")
    with pytest.raises(RuntimeError, match="exists already"):
        bake(cube)
    assert Path(target).read_text() == "mine"
    with pytest.raises(RuntimeError, match="folder.*exist"):
        bake(cube, filepath=str(Path(target).parent / "no" / "x.safetensors"))
    with pytest.raises(RuntimeError, match="comes before"):
        bake(cube, frame_start=5, frame_end=4, overwrite=True)
    assert len(bake(cube, overwrite=True)) == 400


def test_an_object_with_a_broken_transform_is_named(bake, add, target):
    cube = add("cube")
    cube.name, cube.location.x = "Lost", float("nan")
    with pytest.raises(RuntimeError, match='"Lost".*transform.*finite.*frame 1'):
        bake(cube)
    assert not Path(target).exists()


def test_nothing_to_bake(bake, add, scene, splat_object):
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", 'SUN'))
    scene.collection.objects.link(lamp)
    with pytest.raises(RuntimeError, match="poll"):
        bake(lamp)
    mesh = bpy.data.objects.new("Dust", bpy.data.meshes.new("Dust"))
    scene.collection.objects.link(mesh)
    with pytest.raises(RuntimeError, match="no faces"):
        bake(mesh)


def test_the_report_says_order_and_residual(bake, add, capfd):
    cube = add("cube")
    key(cube, "location", [(0.1 * f, 0, np.sin(f / 2)) for f in range(FRAMES)])
    bake(cube)
    assert "Hz" in capfd.readouterr().out
    key(cube, "location", [(0, 0, 3 * (-1) ** f) for f in range(FRAMES)])
    bake(cube, overwrite=True, samples_per_frame=1)
    warned = capfd.readouterr().out
    assert re.search(r"Warning: The motion is followed to .* and 1 % of the Gaussians are off by more than .* worst at \"Cube\"", warned)


def test_fast_motion_is_sampled_more_often_by_itself(bake, add, fg, capfd):
    """A cube that shakes five times within eleven frames: two times per frame do not suffice for the tolerances, four do."""
    cube = add("cube", size=2)
    for quarter in range(4 * FRAMES - 3):
        cube.location.z = np.sin(2 * np.pi * 5 * quarter / (4 * FRAMES - 4))
        cube.keyframe_insert("location", frame=1 + quarter / 4)
    bake(cube, samples_per_frame=2)
    assert "Warning: The motion" in capfd.readouterr().out
    model = bake(cube, overwrite=True)
    assert "Warning" not in capfd.readouterr().out
    for frame in (1.5, 4, 7.25, 9.5):
        away = distances(model, fg, surface_at([cube], frame), (frame - 1) / FRAMES)
        assert np.percentile(away, 99) <= 0.01 * 2


@pytest.mark.slow
@pytest.mark.parametrize(("action", "frames"), [("Robot_Running", (0, 9.5, 17, 21.5))])
def test_a_real_character(fg, target, action, frames):
    file = Path(__file__).resolve().parents[4] / "shared" / "data" / "robot" / "RobotExpressive.blend"
    if not file.is_file():
        pytest.skip("the folder of real inputs is absent")
    bpy.ops.wm.open_mainfile(filepath=str(file))
    scene = bpy.context.scene
    move = bpy.data.actions[action]
    bpy.data.objects["RobotArmature"].animation_data.action = move
    scene.frame_start, scene.frame_end = (int(x) for x in move.frame_range)
    robot = [obj for obj in scene.objects if obj.type == 'MESH']
    for obj in scene.objects:
        obj.select_set(obj in robot)
    bpy.ops.fastgs.bake(filepath=target, count=4000)
    model = fg.load(target)
    assert model.basis.terms <= 0.4 * 47
    height = 4.4
    for frame in frames:
        tree = surface_at(robot, frame)
        assert distances(model, fg, tree, frame / model.clip.frame_count, 5).mean() <= 0.005 * height
    expected = {tuple(srgb(m.diffuse_color[:3]).round(2).tolist()) for m in bpy.data.materials if m.name in ("Main", "Grey", "Black")}
    assert {tuple(c) for c in np.unique(model.features.astype(float).round(2), axis=0).tolist()} == expected


@pytest.mark.slow
def test_in_steps_beside_the_user(module, add, scene, fg):
    """As with a window: the work goes on in a thread, gives the same model, and can be broken off at any point."""
    baking = module("scene.meshes.baking")
    cube = add("cube")
    key(cube, "location", [(0.1 * f, 0, np.sin(f / 3)) for f in range(FRAMES)])
    scene.frame_set(5, subframe=0.5)
    settings = module("scene.meshes.options").bake_options(frame_start=1, frame_end=FRAMES, count=300)

    def finish(apart):
        steps, shares = baking.bake_steps(bpy.context, [cube], settings, apart), []
        while True:
            try:
                shares.append(next(steps))
            except StopIteration as end:
                return end.value, shares

    (blocking, _, _), _ = finish(False)
    (model, report, notes), told = finish(True)
    shares, stages = zip(*told, strict=True)
    assert list(dict.fromkeys(stages)) == ["recording the surface", "recording fast motion", "spreading the Gaussians",
                                           "reading the colours", "fitting the motion"], report
    assert list(shares) == sorted(shares) and shares[0] >= 0 and shares[-1] <= 1 and report.gaussians == 300 and not notes
    assert all(np.array_equal(a, b) for a, b in zip(model.arrays.values(), blocking.arrays.values(), strict=True))
    for stop in range(1, len(shares), 7):
        steps = baking.bake_steps(bpy.context, [cube], settings, True)
        for _ in range(stop):
            next(steps, None)  # how often a thread is waited for, and so how many steps there are, depends on the machine
        steps.close()
        assert (scene.frame_current, scene.frame_subframe) == (5, 0.5)
        assert not any(t.name == "FAST-GS work" for t in threading.enumerate())

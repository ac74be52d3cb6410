# SPDX-License-Identifier: GPL-3.0-or-later
"""*Make Mesh*: an ordinary mesh object that moves with its splat object, in time with it, in renders, simulations and exports."""
from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest


def height(x, y, t):
    """The true surface: a bowl that goes up and down, and tilts."""
    return 0.4 * np.sin(2 * np.pi * t) + 0.3 * (x**2 + y**2) + 0.2 * x * np.sin(4 * np.pi * t)


@pytest.fixture(scope="module")
def bowl(fg):
    """The surface's model, of 30 frames."""
    x, y = (side.ravel() for side in np.meshgrid(*[np.linspace(-1, 1, 21)] * 2))
    i = (np.arange(20)[:, None] * 21 + np.arange(20)).ravel()
    triangles = np.concatenate([np.stack([i, i + 1, i + 22], 1), np.stack([i, i + 22, i + 21], 1)])
    frames = np.arange(0, 29.5, 0.5)
    return fg.bake(np.stack([np.stack([x, y, height(x, y, f / 30)], 1) for f in frames]), triangles, (0.8, 0.3, 0.2), frames=frames,
                   frame_count=30, count=4000)[0]


@pytest.fixture
def splat(scene, bowl, model_file):
    """A splat object that shows the bowl, begins on frame 1, and stands away from the origin."""
    bpy.ops.import_scene.fastgs(filepath=model_file(bowl))
    scene.frame_start, scene.frame_end = 1, 30
    obj = bpy.context.object
    obj.location = 1, 2, 3
    scene.frame_set(4)
    return obj


@pytest.fixture
def made(splat, scene):
    """The object that the operator makes."""
    assert bpy.ops.fastgs.make_mesh(detail=64) == {'FINISHED'}
    found, = (obj for obj in scene.objects if obj.fastgs.surface_of == splat)
    return found


def places(obj):
    """An evaluated object's vertices in the world."""
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    at = np.empty(3 * len(evaluated.data.vertices), np.float32)
    evaluated.data.vertices.foreach_get("co", at)
    matrix = np.array(evaluated.matrix_world)
    return at.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]


def off(obj, t):
    """Mean distance of the vertices from the true surface at the model's time, as a share of its size."""
    x, y, z = (places(obj) - [1, 2, 3]).T
    return np.abs(z - height(x, y, t)).mean() / 2


@pytest.mark.slow
def test_it_follows_frames_sub_frames_and_the_clips_speed(scene, splat, made):
    count = len(made.data.vertices)
    for frame, part in ((1, 0.0), (30, 0.0), (12, 0.5), (20, 0.25)):
        scene.frame_set(frame, subframe=part)
        assert off(made, (frame + part - 1) / 30) < 0.005 and len(places(made)) == count
    splat.fastgs.start_frame, splat.fastgs.speed = 11, 2.0
    scene.frame_set(20)
    assert off(made, 18 / 30) < 0.005
    splat.fastgs.use_capture_frame = True
    splat.fastgs.capture_frame = 7.5
    bpy.context.view_layer.update()
    assert off(made, 7.5 / 30) < 0.005


def test_it_is_an_ordinary_object_with_colours_and_smooth_normals(made, splat, scene):
    assert made.type == 'MESH' and made.parent == splat and all(polygon.use_smooth for polygon in made.data.polygons)
    colour = np.empty(4 * len(made.data.vertices), np.float32)
    made.data.color_attributes["Color"].data.foreach_get("color", colour)
    wanted = [((c + 0.055) / 1.055) ** 2.4 for c in (0.8, 0.3, 0.2)]
    assert colour.reshape(-1, 4)[:, :3] == pytest.approx(np.broadcast_to(wanted, (len(made.data.vertices), 3)), abs=0.02)
    assert 2 < len(made.data.shape_keys.key_blocks) < 12


def test_someone_elses_keys_of_the_capture_frame_stay(made, scene):
    made["Capture Frame"] = 12.0
    made.keyframe_insert('["Capture Frame"]', frame=1)
    scene.frame_set(25)
    assert off(made, 12 / 30) < 0.005


def test_files_hold_all_of_it(made, scene, tmp_path):
    scene.frame_set(9)
    name, before = made.name, places(made)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert places(bpy.data.objects[name]) == pytest.approx(before, abs=1e-5)
    bpy.context.scene.frame_set(20)
    assert off(bpy.data.objects[name], 19 / 30) < 0.005


def test_it_is_one_step_of_undo(splat, scene):
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.fastgs.make_mesh(detail=16)
    bpy.ops.ed.undo_push(message="Make Mesh")
    bpy.ops.ed.undo()
    assert not any(obj.fastgs.surface_of for obj in bpy.context.scene.objects)


@pytest.mark.parametrize("shape", ["AUTO", "CLOSED"])
def test_what_was_filmed_from_one_side_becomes_open_and_says_so(scene, fg, bowl, model_file, capfd, shape):
    above = fg.Viewpoint(width=64, height=64, fx=32, fy=32, cx=32, cy=32, position=(0, 0, 4), rotation=(0, 1, 0, 0), distance=4)
    bpy.ops.import_scene.fastgs(filepath=model_file(replace(bowl, surroundings=fg.Surroundings(cameras=(above,)), provenance={})))
    bpy.ops.fastgs.make_mesh(detail=24, shape=shape)
    mesh = next(obj.data for obj in scene.objects if obj.fastgs.surface_of)
    sides = [key for face in mesh.polygons for key in face.edge_keys]
    assert (len(sides) < 2 * len(mesh.edges)) == (shape == 'AUTO')  # an edge with one face lies on a border
    assert ("one side" in capfd.readouterr().out) == (shape == 'AUTO')


@pytest.mark.slow
def test_alembic_writes_it_as_it_moves(made, scene, tmp_path):
    for obj in scene.objects:
        obj.select_set(obj == made)
    path = str(tmp_path / "made.abc")
    bpy.ops.wm.alembic_export(filepath=path, selected=True, start=1, end=30, flatten=True, as_background_job=False)
    wanted = {}
    for frame in (1, 8, 19, 30):
        scene.frame_set(frame)
        wanted[frame] = places(made)
    bpy.ops.wm.alembic_import(filepath=path, as_background_job=False)
    back = bpy.context.object
    assert back != made and back.modifiers[0].type == 'MESH_SEQUENCE_CACHE'
    for frame, at in wanted.items():
        scene.frame_set(frame)
        assert places(back) == pytest.approx(at, abs=1e-5)


@pytest.mark.slow
@pytest.mark.skipif(not bpy.app.build_options.usd, reason="this Blender has no USD")
def test_usd_without_shape_keys_writes_it_as_it_moves(made, scene, tmp_path):
    for obj in scene.objects:
        obj.select_set(obj == made)
    path = str(tmp_path / "made.usdc")
    bpy.ops.wm.usd_export(filepath=path, selected_objects_only=True, export_animation=True, export_shapekeys=False)
    wanted = {}
    for frame in (1, 8, 19, 30):
        scene.frame_set(frame)
        wanted[frame] = places(made)
    bpy.ops.wm.usd_import(filepath=path)
    back, = (obj for obj in bpy.context.selected_objects if obj.type == 'MESH')
    assert back != made and "Color" in back.data.color_attributes
    for frame, at in wanted.items():
        scene.frame_set(frame)
        assert places(back) == pytest.approx(at, abs=1e-5)


@pytest.mark.slow
def test_cloth_lies_on_a_ball_that_goes_up_and_down(scene, fg, model_file):
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4)
    ball = bpy.context.object
    points, triangles = np.array([v.co for v in ball.data.vertices]), np.array([face.vertices for face in ball.data.polygons])
    bpy.data.objects.remove(ball)
    frames = np.arange(0, 11.5, 0.5)
    up = 0.4 * np.sin(2 * np.pi * frames / 12)[:, None, None] * [0, 0, 1]
    bpy.ops.import_scene.fastgs(filepath=model_file(fg.bake(points + up, triangles, frames=frames, frame_count=12, count=5000)[0]))
    splat = bpy.context.object
    bpy.ops.fastgs.make_mesh(detail=64)
    made, = (obj for obj in scene.objects if obj.fastgs.surface_of == splat)
    made.modifiers.new("Collision", 'COLLISION')
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=24, y_subdivisions=24, size=2.4, location=(0, 0, 1.9))
    cloth = bpy.context.object
    cloth.modifiers.new("Cloth", 'CLOTH')
    for frame in range(1, 31):
        scene.frame_set(frame)
        away = np.linalg.norm(places(cloth) - places(made).mean(0), axis=1).min()
        assert away > 0.95
    assert away < 1.1


@pytest.mark.slow
def test_a_ball_bounces_off_it(made, scene):
    """The bowl goes down, and up again under the ball, which must not fall through."""
    bpy.ops.rigidbody.world_add()
    scene.rigidbody_world.collection = bpy.data.collections.new("Bodies")
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.15, location=(1.05, 2.02, 4.3))
    ball = bpy.context.object
    for obj, kind, shape in ((made, 'PASSIVE', 'MESH'), (ball, 'ACTIVE', 'SPHERE')):
        scene.rigidbody_world.collection.objects.link(obj)
        obj.rigid_body.type, obj.rigid_body.collision_shape, obj.rigid_body.restitution = kind, shape, 0.8
    made.rigid_body.mesh_source, made.rigid_body.use_deform = 'DEFORM', True
    over = []
    for frame in range(1, 31):
        scene.frame_set(frame)
        x, y, z = ball.evaluated_get(bpy.context.evaluated_depsgraph_get()).matrix_world.translation - made.matrix_world.translation
        over.append(z - height(x, y, (frame - 1) / 30))
    touch = int(np.argmin(over))
    assert 0.1 < min(over) < 0.25 and 3 < touch < 29 and max(over[touch:]) > over[touch] + 0.02


def test_splats_are_neither_hidden_by_it_nor_overlaid(made, module, scene):
    hidden_by = module("scene.holdout").hidden_by
    scene.fastgs.use_meshes = True
    assert hidden_by(bpy.context.evaluated_depsgraph_get()) is None
    scene.fastgs.render_meshes = 'CYCLES'
    mesh_scene = module("scene.mesh_scene")
    for catcher in (False, True):
        made.is_shadow_catcher = catcher
        layer = mesh_scene.of(scene).view_layers[0]
        layer.update()
        mesh_scene.hide(layer.depsgraph)
        evaluated = made.evaluated_get(layer.depsgraph)
        assert evaluated.visible_camera == catcher and evaluated.visible_glossy and evaluated.visible_shadow


def test_what_shows_nothing_says_so(splat, scene):
    splat.fastgs.before = 'HIDE'
    splat.fastgs.start_frame = 100
    with pytest.raises(RuntimeError, match="nothing.*frame"):
        bpy.ops.fastgs.make_mesh()

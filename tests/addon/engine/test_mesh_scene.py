# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene in which meshes are rendered: physics that it has no part in, and that it goes with the scene of the splats."""
import bpy
import image_files
import numpy as np
import pytest
from joined import tree_of


@pytest.mark.parametrize("late", [False, True])
def test_rigid_bodies_and_their_children_are_where_they_fall(scene, screen, wall, add_camera, choose, module, tmp_path, late):
    """The mesh fills the hole that it has in the splats, whether the body or *Render With Meshes* came first."""
    add_camera(lens=30.0)
    scene.frame_start, scene.frame_end = 1, 12
    ball = wall(-0.8, -1.0, (0, 1, 0), size=0.6)
    ball.location.z = 1.0
    child = wall(1.6, 0.0, (0, 0, 1), size=0.6)  # from its parent
    child.parent, child.rotation_euler, child.location = ball, (0, 0, 0), (1.6, 0, 0)
    if late:
        choose()
    bpy.context.view_layer.objects.active = ball
    bpy.ops.rigidbody.object_add()
    second = scene.view_layers.new("Second")
    inside = bpy.data.collections.new("Inside")
    scene.collection.children.link(inside)
    inside.objects.link(wall(0, -1.5, (1, 1, 1), size=0.4))
    scene.collection.objects.unlink(inside.objects[0])
    second.layer_collection.children["Inside"].exclude = True
    other = choose()
    module("scene.composite").follow(scene)
    assert other.rigidbody_world is None and scene.rigidbody_world and ball.rigid_body
    for frame in range(1, 13):
        scene.frame_set(frame)  # renders do not simulate
    image_files.set_output(scene, "PNG16")
    scene.render.filepath = str(tmp_path / "fall_")
    node = next(node for node in tree_of(scene).nodes if node.bl_idname == 'CompositorNodeRLayers' and node.scene == scene)
    for layer, white in ((scene.view_layers[0].name, True), (second.name, False)):
        node.layer = layer
        bpy.ops.render.render(animation=True)
        rows = []
        for frame in (1, 8, 12):
            picture = image_files.read_png(tmp_path / f"fall_{frame:04d}.png")
            assert picture[..., :3].max(2).min() > 0.3, "no hole"
            assert (picture[..., 2] > 0.9).any() and (picture[24, 32, :3] > 0.9).all() == white
            rows.append(np.flatnonzero((picture[..., 1] > 0.9).any(1) if not white else (picture[:, :28, 1] > 0.9).any(1)).mean())
        assert rows[1] > rows[0] + 3 and rows[2] > rows[1] + 5
    scene.fastgs.render_meshes = 'OFF'
    assert scene.rigidbody_world and ball.rigid_body and len(bpy.data.scenes) == 1


def test_it_has_the_gravity_of_the_scene(scene, screen, add_camera, choose):
    add_camera()
    other = choose()
    scene.gravity, scene.use_gravity = (0, 0, 3), False
    bpy.ops.render.render()
    assert tuple(other.gravity) == (0, 0, 3) and not other.use_gravity


def test_it_goes_with_the_scene_of_the_splats(scene, screen, add_camera, choose, module):
    add_camera()
    choose()
    bpy.context.window.scene = bpy.data.scenes.new("Kept")
    bpy.data.scenes.remove(scene)
    module("scene.composite")._sync_all()
    assert [each.name for each in bpy.data.scenes] == ["Kept"]

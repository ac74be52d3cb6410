# SPDX-License-Identifier: GPL-3.0-or-later
"""Modifiers Change: Splats.  Renders show the points of a splat object as Geometry Nodes, lattices and armatures have changed them."""
from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import bpy
import numpy as np
import panel_recorder
import pytest

ROTATED = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])


@pytest.fixture
def model(fg, make_model):
    """A cloud that moves in curves, turns and fades; in Blender's axes."""
    rng = np.random.default_rng(5)
    n = 150
    windows = np.tile([-1.0, 2.0, -3.0, -3.0], (n, 1))
    windows[::3, 1] = 0.3
    return make_model(n, seed=4, basis=fg.Fourier(3), motion=rng.normal(size=(n, 6, 3)) * 0.2, axes="RFU", clip=fg.Clip(20, 24),
                      rotation_basis=fg.Polynomial(1), rotation_motion=rng.normal(size=(n, 1, 4)),
                      appearance=fg.SH(1), features=rng.normal(0, 0.5, (n, 12)), temporal_kind=fg.Window(), temporal=windows)


@pytest.fixture
def points(model, model_file, add_camera, scene):
    """The model as an object whose Gaussians are all points, before a camera."""
    bpy.ops.import_scene.fastgs(filepath=model_file(model))
    obj = bpy.context.object
    obj.fastgs.points = 'ALL'
    obj.location, obj.rotation_euler = (0.2, 0, 0.1), (0, 0, 0.4)
    add_camera()
    scene.render.film_transparent = True
    bpy.context.view_layer.update()
    return obj


def nodes(obj, build, name="Edit"):
    """A Geometry Nodes modifier whose tree build(tree, node, link) makes between its input and its output."""
    tree = bpy.data.node_groups.new(name, 'GeometryNodeTree')
    tree.interface.new_socket("Geometry", in_out='INPUT', socket_type='NodeSocketGeometry')
    tree.interface.new_socket("Geometry", in_out='OUTPUT', socket_type='NodeSocketGeometry')
    start, end = tree.nodes.new('NodeGroupInput'), tree.nodes.new('NodeGroupOutput')
    tree.links.new(build(tree, start.outputs[0]), end.inputs[0])
    modifier = obj.modifiers.new(name, 'NODES')
    modifier.node_group = tree
    return modifier


def wave(tree, geometry):
    """Moves points by a sine of their x, halves the opacity of those with even ids, turns colours round, hides every seventh."""
    def node(kind, *values, **settings):
        made = tree.nodes.new(kind)
        for name, value in settings.items():
            setattr(made, name, value)
        for number, value in enumerate(values):
            if isinstance(value, bpy.types.NodeSocket):
                tree.links.new(value, [s for s in made.inputs if s.enabled][number])
            elif value is not None:
                [s for s in made.inputs if s.enabled][number].default_value = value
        return made.outputs[0]

    def named(name, kind):
        return node('GeometryNodeInputNamedAttribute', name, data_type=kind)

    def store(geometry, name, kind, value):
        return node('GeometryNodeStoreNamedAttribute', geometry, None, name, value, data_type=kind, domain='POINT')

    along = node('ShaderNodeVectorMath', node('ShaderNodeVectorMath', node('GeometryNodeInputPosition'), (5.0, 0, 0), operation='MULTIPLY'),
                 operation='SINE')
    offset = node('ShaderNodeVectorMath', along, (0.3, 0, 0), operation='MULTIPLY')
    geometry = node('GeometryNodeSetPosition', geometry, None, None, offset)
    odd = node('ShaderNodeMath', named("id", 'INT'), 2.0, operation='MODULO')
    share = node('ShaderNodeMath', node('ShaderNodeMath', odd, 0.5, operation='MULTIPLY'), 0.5, operation='ADD')
    geometry = store(geometry, "opacity", 'FLOAT', node('ShaderNodeMath', named("opacity", 'FLOAT'), share, operation='MULTIPLY'))
    parts = tree.nodes.new('ShaderNodeSeparateXYZ')
    tree.links.new(named("color", 'FLOAT_COLOR'), parts.inputs[0])
    turned = tree.nodes.new('ShaderNodeCombineXYZ')
    for a, b in ((0, 1), (1, 2), (2, 0)):
        tree.links.new(parts.outputs[a], turned.inputs[b])
    geometry = store(geometry, "color", 'FLOAT_COLOR', turned.outputs[0])
    seventh = node('FunctionNodeCompare', node('ShaderNodeMath', named("id", 'INT'), 7.0, operation='MODULO'), 0.5, data_type='FLOAT',
                   operation='LESS_THAN')
    return store(geometry, "hidden", 'BOOLEAN', seventh)


def own_edit(fg, module, model, t, hide=True):
    """The library's own edit of the model, the same as wave()."""
    edits = module("fastgs_blender.model.edits")
    now, ids = edits.state_of(model, t), np.arange(len(model))
    offset = np.zeros((len(model), 3))
    offset[:, 0] = 0.3 * np.sin(5 * now.position[:, 0])
    colour = module("fastgs_blender.rendering.colour")
    linear = colour.srgb_to_linear(np.clip(now.colour, 0, None))
    return edits.Edit(t, now.position + offset, opacity=now.opacity * (0.5 + 0.5 * (ids % 2)),
                      colour=colour.linear_to_srgb(np.roll(linear, 1, axis=1)), hidden=ids % 7 == 0)


def picture(module, instances, camera):
    return module("engine.passes").images(instances, camera, [])["Combined"]


def test_points_carry_the_gaussians_of_the_frame(fg, module, model, points, scene):
    scene.frame_set(6, subframe=0.5)
    mesh, t = points.data, 5.5 / 20
    s = fg.slice_model(model, t, cull=False)

    def read(name, member, width):
        values = np.empty(len(mesh.vertices) * width, np.int32 if name == "id" else np.float32)
        mesh.attributes[name].data.foreach_get(member, values)
        return values.reshape(-1, width)[:len(model)]

    assert np.array_equal(read("id", "value", 1)[:, 0], np.arange(len(model)))
    assert np.allclose(read("position", "vector", 3), s.position, atol=1e-5)
    assert np.allclose(read("scale", "vector", 3), s.scale, rtol=1e-5)
    assert np.allclose(read("opacity", "value", 1)[:, 0], s.opacity, atol=1e-6)
    assert np.allclose(read("velocity", "vector", 3), s.velocity * 24 / 20, rtol=1e-3, atol=1e-4)
    assert np.allclose(read("still_position", "vector", 3), fg.slice_model(model, 0.0, cull=False).position, atol=1e-5)
    age = read("age", "value", 1)[:, 0]
    assert age.min() >= 0 and age.max() <= 1 and age.std() > 0.01
    linear = module("fastgs_blender.rendering.colour").srgb_to_linear(np.clip(0.5 + 0.28209479 * model.features[:, :3], 0, 1))
    inside = (np.abs(model.features[:, :3]) < 1.7).all(1)
    assert np.allclose(read("color", "color", 4)[inside, :3], linear[inside], atol=1e-4)
    points.fastgs.points = 'SOME'
    bpy.context.view_layer.update()
    assert "opacity" not in points.data.attributes and "velocity" not in points.data.attributes


def test_unchanged_points_are_the_model_itself(module, points, scene, render):
    points.fastgs.points = 'SOME'
    before = render()["ViewLayer.Combined"]
    points.fastgs.points = 'ALL'
    nodes(points, lambda tree, geometry: geometry)
    assert np.array_equal(before, render()["ViewLayer.Combined"])
    instances, _ = module("scene.snapshot").take(bpy.context.evaluated_depsgraph_get()).load()
    assert instances[0].origin is None


def test_f12_is_the_librarys_own_edit(fg, module, model, points, scene, render, now):
    """A tree that moves, fades, recolours and hides, at whole and at half frames."""
    nodes(points, wave)
    instances = module("fastgs_blender.rendering.instances")
    for frame, part in ((1, 0.0), (6, 0.5), (12, 0.0)):
        scene.frame_set(frame, subframe=part)
        got = render()["ViewLayer.Combined"]
        placement = np.array(points.matrix_world, np.float64)
        edited = own_edit(fg, module, model, (frame - 1 + part) / 20).applied(model)
        wanted = picture(module, [instances.Instance(edited, placement, 0.0)], now(scene.camera))
        taken, _ = module("scene.snapshot").take(bpy.context.evaluated_depsgraph_get()).load()
        exact = picture(module, taken, now(scene.camera))
        assert wanted[..., 3].max() > 0.5
        assert np.abs(exact - wanted).max() < 1e-4 and np.abs(got - wanted).max() < 1e-3  # the file's half floats
        plain = picture(module, [instances.Instance(model, placement, (frame - 1 + part) / 20)], now(scene.camera))
        assert np.abs(plain - wanted).max() > 0.1


def test_keys_of_the_capture_frame_reach_the_points(fg, module, model, points, scene):
    """Values that are keyed are known after an evaluation only: the points follow, in the same frame change."""
    nodes(points, wave)
    points.fastgs.use_capture_frame = True
    for frame, value in ((1, 0.0), (11, 5.0)):
        points.fastgs.capture_frame = value
        points.fastgs.keyframe_insert("capture_frame", frame=frame)
    action = points.animation_data.action
    curves = action.fcurves if hasattr(action, "fcurves") else action.layers[0].strips[0].channelbags[0].fcurves
    for point in curves[0].keyframe_points:
        point.interpolation = 'LINEAR'
    scene.frame_set(5)
    edits = module("fastgs_blender.model.edits")
    taken, _ = module("scene.snapshot").take(bpy.context.evaluated_depsgraph_get()).load()
    wanted = own_edit(fg, module, model, 2.0 / 20).applied(model)
    assert np.allclose(taken[0].model.position, wanted.position, atol=1e-5)
    assert edits.state_of(model, 0.1).t == pytest.approx(0.1)


def test_deleted_points_are_gone_and_other_engines_see_the_edit(fg, module, model, points, scene):
    def halve(tree, geometry):
        delete, compare, index = (tree.nodes.new(kind) for kind in (
            'GeometryNodeDeleteGeometry', 'FunctionNodeCompare', 'GeometryNodeInputIndex'))
        compare.data_type, compare.operation = 'INT', 'LESS_THAN'
        a, b = [s for s in compare.inputs if s.enabled][:2]
        tree.links.new(index.outputs[0], a)
        b.default_value = 75
        tree.links.new(geometry, delete.inputs[0])
        tree.links.new(compare.outputs[0], delete.inputs["Selection"])
        return delete.outputs[0]

    nodes(points, halve)
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    taken, _ = module("scene.snapshot").take(depsgraph).load()
    sigma = 1 / (1 + np.exp(-taken[0].model.opacity))
    assert (sigma[:75] < 1e-6).all() and (sigma[75:] > 0.01).sum() > 30
    mesh = points.evaluated_get(depsgraph).data
    numbers = np.empty(len(mesh.vertices), np.int32)
    mesh.attributes["Gaussian"].data.foreach_get("value", numbers)
    faces = np.unique([i for face in mesh.polygons for i in face.vertices])
    assert len(faces) and numbers[faces].min() >= 75


def test_a_frame_is_edited_once(module, points, render, scene, monkeypatch):
    """Blender evaluates a frame for the viewport and for F12, for which also twice: what points cost is paid once, until they change."""
    carried, edited = module("scene.point_edits").Carried, []
    edit = carried._edit
    monkeypatch.setattr(carried, "_edit", lambda self, model: edited.append(self.t) or edit(self, model))
    modifier = nodes(points, wave)
    for frame in (8, 9):
        scene.frame_set(frame)
        render()
    assert edited == pytest.approx([7 / 20, 8 / 20])
    modifier.node_group.nodes["Vector Math.002"].inputs[1].default_value[0] = 0.6
    render()
    assert len(edited) == 3


@pytest.mark.parametrize("kind", ["LATTICE", "ARMATURE"])
def test_deformed_gaussians_move_and_turn(fg, module, model, points, scene, now, kind):
    """A quarter turn by a lattice or a bone looks like the object turned by a quarter, looked at from one side (no harmonics)."""
    if kind == "LATTICE":
        lattice = bpy.data.lattices.new("Lattice")
        for axis in "uvw":
            setattr(lattice, f"interpolation_type_{axis}", 'KEY_LINEAR')
        cage = bpy.data.objects.new("Lattice", lattice)
        scene.collection.objects.link(cage)
        cage.parent, cage.scale = points, (6, 6, 6)
        modifier = points.modifiers.new("Lattice", 'LATTICE')
        modifier.object = cage
        for point in lattice.points:
            point.co_deform = ROTATED @ np.array(point.co_deform)
    else:
        armature = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
        scene.collection.objects.link(armature)
        armature.matrix_world = points.matrix_world
        bpy.context.view_layer.objects.active = armature
        bpy.ops.object.mode_set(mode='EDIT')
        bone = armature.data.edit_bones.new("Bone")
        bone.head, bone.tail = (0, 0, 0), (0, 0, 1)
        bpy.ops.object.mode_set(mode='OBJECT')
        points.vertex_groups.new(name="Bone").add(range(len(points.data.vertices)), 1.0, 'REPLACE')
        modifier = points.modifiers.new("Armature", 'ARMATURE')
        modifier.object = armature
        armature.pose.bones["Bone"].rotation_mode = 'XYZ'
        armature.pose.bones["Bone"].rotation_euler = (0, np.pi / 2, 0)  # a bone's y lies along it
    scene.frame_set(8)
    taken, _ = module("scene.snapshot").take(bpy.context.evaluated_depsgraph_get()).load()
    turn = np.eye(4)
    turn[:3, :3] = ROTATED
    state = module("fastgs_blender.model.edits").state_of(model, 7 / 20)
    assert np.abs(taken[0].model.position - state.position @ ROTATED.T).max() < 1e-4
    instances = module("fastgs_blender.rendering.instances")
    grey = {"appearance": fg.RGB(), "features": np.full((len(model), 3), 0.5)}
    got = picture(module, [replace(taken[0], model=replace(taken[0].model, **grey))], now(scene.camera))
    placement = np.array(points.matrix_world, np.float64) @ turn
    wanted = picture(module, [instances.Instance(replace(model, **grey), placement, 7 / 20)], now(scene.camera))
    assert np.abs(got - wanted).max() < 5e-3
    points.fastgs.follow_points = False
    bpy.context.view_layer.update()
    taken, _ = module("scene.snapshot").take(bpy.context.evaluated_depsgraph_get()).load()
    still = picture(module, [replace(taken[0], model=replace(taken[0].model, **grey))], now(scene.camera))
    assert np.abs(still - wanted).max() > 0.05


def test_motion_blur_shows_what_nodes_move(module, points, scene, render):
    """Points that move with the scene's time leave a streak; without a modifier that moves them they leave none."""
    points.fastgs.use_capture_frame = True  # the capture itself stands still

    def slide(tree, geometry):
        time, where, combine = (tree.nodes.new(kind) for kind in (
            'GeometryNodeInputSceneTime', 'GeometryNodeSetPosition', 'ShaderNodeCombineXYZ'))
        tree.links.new(time.outputs["Frame"], combine.inputs[0])
        tree.links.new(geometry, where.inputs[0])
        tree.links.new(combine.outputs[0], where.inputs["Offset"])
        return where.outputs[0]

    modifier = nodes(points, slide)
    points.location.x = -5
    scene.frame_set(5)
    sharp = render()["ViewLayer.Combined"]
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
    blurred = render()["ViewLayer.Combined"]
    modifier.show_render = False
    points.location.x = 0
    still = render()["ViewLayer.Combined"]
    scene.render.use_motion_blur = False
    assert np.abs(still - render()["ViewLayer.Combined"]).max() < 1e-3
    rows = blurred[..., 3].max(0)
    assert sharp[..., 3].max() > 0.5 and (rows > 0.05).sum() > (sharp[..., 3].max(0) > 0.05).sum() + 5


def test_points_survive_saving_undo_and_copies(module, model, points, scene, tmp_path):
    nodes(points, wave)
    bpy.context.view_layer.update()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    obj = next(o for o in bpy.data.objects if o.fastgs.filepath)
    bpy.context.scene.frame_set(9)
    take = module("scene.snapshot").take
    first = take(bpy.context.evaluated_depsgraph_get()).load()[0][0]
    assert first.origin is not None
    copy = obj.copy()  # the mesh is shared, the time is its own
    copy.fastgs.start_frame = 4
    bpy.context.scene.collection.objects.link(copy)
    bpy.context.view_layer.update()
    both = {i.name: i for i in take(bpy.context.evaluated_depsgraph_get()).load()[0]}
    assert np.allclose(both[obj.name].model.position, first.model.position, atol=1e-5)
    assert np.abs(both[copy.name].model.position - first.model.position).max() > 1e-3


def test_panel_shows_points_and_effects(module, points):
    layout = panel_recorder.Layout()
    module("ui").object_panels.FASTGS_PT_object_points.draw(SimpleNamespace(layout=layout), bpy.context)
    kinds = [row[1] for row in layout.record]
    assert {"points", "follow_points", "still_frame", "fastgs.add_effect"} <= set(kinds)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered frames against the reference renderer: objects, instances, layers, passes and time."""
from dataclasses import replace

import bpy
import by_hand
import image_files
import numpy as np
import pytest
from mathutils import Matrix

EYE = (0, -5, 0)


@pytest.fixture
def expected(fg):
    """expected(parts, passes=("rgb", "alpha")): the reference's pictures, seen by add_camera's default camera."""
    eye = by_hand.camera(fg, by_hand.look_at(EYE, (0, 0, 0)))

    def pictures(parts, passes=("rgb", "alpha"), **camera):
        return fg.render(parts, replace(eye, **camera), passes=passes, backend="reference")

    return pictures


def placement(seed, scale=(0.6, 1.3, 0.9)):
    """A rotated, non-uniformly scaled, moved object."""
    rng = np.random.default_rng(seed)
    q = rng.normal(size=4)
    w, x, y, z = q / np.linalg.norm(q)
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]) * scale
    matrix[:3, 3] = rng.uniform(-0.4, 0.4, 3)
    return matrix


def merged(fg, model, matrix):
    """A model of isotropic or any Gaussians with a placement worked into its arrays (by the eigenvectors of M Sigma M^T)."""
    s = fg.slice_model(model, 0.0, cull=False)
    w, x, y, z = s.rotation.T
    rotation = np.stack([
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1).reshape(-1, 3, 3)
    factor = matrix[:3, :3] @ rotation * s.scale[:, None, :]
    values, vectors = np.linalg.eigh(factor @ factor.transpose(0, 2, 1))
    vectors[np.linalg.det(vectors) < 0, :, 0] *= -1
    quaternions = np.array([Matrix(v.tolist()).to_quaternion()[:] for v in vectors])
    return replace(model, position=s.position @ matrix[:3, :3].T + matrix[:3, 3], rotation=quaternions,
                   scale=0.5 * np.log(values))


def test_combined_is_the_model(scene, make_model, model_file, splat_object, add_camera, render, expected):
    model = make_model()
    splat_object(model_file(model))
    add_camera()
    scene.render.film_transparent = True
    want = expected(model)
    by_hand.assert_same_picture(render()["ViewLayer.Combined"], by_hand.combined(want["rgb"], want["alpha"]))


def test_overlapping_objects_are_one_cloud(scene, fg, make_model, model_file, splat_object, add_camera, render, expected):
    """Two interpenetrating objects, turned and scaled unevenly, look like one file that holds both."""
    models, places = [make_model(50, seed=1), make_model(50, seed=2)], [placement(5), placement(6)]
    for i, (model, place) in enumerate(zip(models, places, strict=True)):
        splat_object(model_file(model, f"{i}.safetensors"), f"Object {i}", place)
    add_camera()
    scene.render.film_transparent = True
    clouds = [merged(fg, model, place) for model, place in zip(models, places, strict=True)]
    one = fg.GaussianModel(**{name: np.concatenate([c.arrays[name] for c in clouds]) for name in clouds[0].arrays})
    want = expected(one)
    by_hand.assert_same_picture(render()["ViewLayer.Combined"], by_hand.combined(want["rgb"], want["alpha"]))
    apart = [expected(cloud)["alpha"] for cloud in clouds]
    assert (np.minimum(*apart) > 0.3).any(), "the objects should overlap"


def test_harmonics_turn_with_the_object(scene, fg, make_model, model_file, splat_object, add_camera, render, expected):
    """Turning object and camera together changes nothing; turning the object alone does."""
    rng = np.random.default_rng(4)
    sh = fg.SH(2)
    model = make_model(30, seed=7, features=rng.normal(0, 0.6, (30, sh.width)), appearance=sh)
    turn = np.array(Matrix.Rotation(0.7, 4, (1, 2, 3)))
    obj = splat_object(model_file(model), matrix=turn)
    camera = add_camera()
    scene.render.film_transparent = True
    camera.matrix_world = Matrix((turn @ np.array(camera.matrix_basis)).tolist())
    want = expected(model)
    together = by_hand.combined(want["rgb"], want["alpha"])
    by_hand.assert_same_picture(render()["ViewLayer.Combined"], together)
    colour = want["rgb"][24, 32] / want["alpha"][24, 32]
    obj.matrix_world = Matrix.Identity(4)
    turned = render()["ViewLayer.Combined"][24, 32]
    assert np.abs(turned[:3] / turned[3] - by_hand.linear(colour)).max() > 0.05


@pytest.mark.parametrize(("depth", "name"), [('EXPECTED', "depth"), ('MEDIAN', "median_depth")])
def test_depth(scene, make_model, model_file, splat_object, add_camera, render, expected, depth, name):
    model = make_model()
    splat_object(model_file(model))
    add_camera()
    scene.fastgs.depth = depth
    scene.view_layers[0].use_pass_z = True
    want = expected(model, (name, "alpha"))
    actual = render()["ViewLayer.Depth"][..., 0]
    assert (actual[np.isinf(want[name])] == np.float32(1e10)).all() and np.isinf(want[name]).any()
    solid = want["alpha"] > 0.6
    off = np.abs(actual[solid] - want[name][solid])
    assert np.median(off) < 1e-5 and np.mean(off > 1e-2) < 0.02
    assert 3.5 < actual[solid].min() < actual[solid].max() < 6.5


def test_alpha_pass_knows_nothing_of_the_world(scene, make_model, model_file, splat_object, add_camera, render, expected):
    model = make_model()
    splat_object(model_file(model))
    add_camera()
    layer = scene.view_layers[0]
    assert "ViewLayer.Splat Alpha" not in render()
    layer.fastgs.use_pass_alpha = True
    image = render()
    assert (image["ViewLayer.Combined"][..., 3] == 1).all()
    by_hand.assert_same_picture(image["ViewLayer.Splat Alpha"], expected(model)["alpha"])


def test_passes_are_compositor_sockets(scene, make_model, model_file, splat_object, add_camera, render, compositor):
    """They come and go with their switches, they carry the pass, and Combined keeps its own alpha."""
    splat_object(model_file(make_model()))
    add_camera()
    layer = scene.view_layers[0]

    def sockets():
        return [socket.name for socket in compositor.layers.outputs if socket.enabled and not socket.is_unavailable]

    assert sockets() == ["Image", "Alpha"]
    layer.use_pass_z = layer.fastgs.use_pass_alpha = True
    assert sorted(sockets()) == ["Alpha", "Depth", "Image", "Splat Alpha"]
    passes = render()
    for name in ("Depth", "Splat Alpha"):
        compositor.show(name)
        np.testing.assert_allclose(render("PNG16")[..., 0], np.clip(passes[f"ViewLayer.{name}"][..., 0], 0, 1), atol=2e-5)
    compositor.show("Alpha")
    assert (render("PNG16")[..., 0] == 1).all()
    layer.fastgs.use_pass_alpha = False
    assert "Splat Alpha" not in sockets()


def test_a_pass_is_one_entry_of_the_librarys_table(
        scene, module, make_model, model_file, splat_object, add_camera, render, expected, compositor, monkeypatch):
    """An entry, and the switch that is made from it when the extension is registered, are a pass: rendered, written, a socket."""
    table, group = module("fastgs_blender.rendering.passes"), module("scene.properties").FASTGS_PG_view_layer
    assert "use_pass_alpha" in group.__annotations__, "made from the table"
    monkeypatch.setitem(table.PASSES, "half", table.Pass(
        "half", lambda blended: blended.alpha / 2, blender="Half", letters="X", switch="fastgs.use_pass_half"))
    model, layer = make_model(), scene.view_layers[0]
    splat_object(model_file(model))
    add_camera()
    group.use_pass_half = bpy.props.BoolProperty(update=module("scene.updates").passes)
    try:
        layer.fastgs.use_pass_half = True
        by_hand.assert_same_picture(render()["ViewLayer.Half"], expected(model)["alpha"] / 2)
        assert "Half" in [socket.name for socket in compositor.layers.outputs if socket.enabled]
    finally:
        layer.fastgs.use_pass_half = False
        del group.use_pass_half


def test_two_view_layers(scene, make_model, model_file, splat_object, add_camera, render, expected):
    """Each layer shows what it does not exclude; hidden objects show nowhere."""
    files = {name: make_model(seed=seed) for seed, name in enumerate(("left", "right", "hidden"))}
    for name, model in files.items():
        collection = bpy.data.collections.new(name)
        scene.collection.children.link(collection)
        splat_object(model_file(model, f"{name}.safetensors"), name, collection=collection)
    bpy.data.objects["hidden"].hide_render = True
    add_camera()
    scene.render.film_transparent = True
    first, second = scene.view_layers[0], scene.view_layers.new("Second")
    first.layer_collection.children["right"].exclude = True
    second.layer_collection.children["left"].exclude = True
    image = render()
    for layer, name in (("ViewLayer", "left"), ("Second", "right")):
        want = expected(files[name])
        by_hand.assert_same_picture(image[f"{layer}.Combined"], by_hand.combined(want["rgb"], want["alpha"]))
    second.use = False
    assert "Second.Combined" not in render()


def test_hiding_in_the_viewport_does_not_hide_in_the_render(scene, make_model, model_file, splat_object, add_camera, render):
    obj = splat_object(model_file(make_model()))
    add_camera()
    scene.render.film_transparent = True
    shown = render()["ViewLayer.Combined"]
    obj.hide_viewport = True
    np.testing.assert_array_equal(render()["ViewLayer.Combined"], shown)


def test_collection_instances(scene, make_model, model_file, splat_object, add_camera, render, expected):
    model = make_model(30, spread=0.5)
    source = bpy.data.collections.new("Source")
    splat_object(model_file(model), collection=source, matrix=Matrix.Translation((0.1, 0, 0.2)))
    for i, matrix in enumerate((placement(1), placement(2, (1, 1, 1)))):
        empty = bpy.data.objects.new(f"Instance {i}", None)
        empty.instance_type, empty.instance_collection = 'COLLECTION', source
        empty.matrix_world = Matrix(matrix.tolist())
        scene.collection.objects.link(empty)
    add_camera()
    scene.render.film_transparent = True
    inside = np.array(Matrix.Translation((0.1, 0, 0.2)))
    want = expected([(model, placement(1) @ inside, 0), (model, placement(2, (1, 1, 1)) @ inside, 0)])
    by_hand.assert_same_picture(render()["ViewLayer.Combined"], by_hand.combined(want["rgb"], want["alpha"]))


def test_several_kinds_of_geometry_are_still_one_object(scene, make_model, model_file, splat_object, add_camera, render):
    """An object whose geometry nodes make a mesh and a point cloud comes twice in the depsgraph, and is drawn once."""
    obj = splat_object(model_file(make_model()))
    obj.data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    add_camera()
    scene.render.film_transparent = True
    once = render()["ViewLayer.Combined"]
    tree = bpy.data.node_groups.new("Both", 'GeometryNodeTree')
    for direction in ('INPUT', 'OUTPUT'):
        tree.interface.new_socket(name="Geometry", in_out=direction, socket_type='NodeSocketGeometry')
    nodes = {kind: tree.nodes.new(kind) for kind in ('NodeGroupInput', 'GeometryNodePoints', 'GeometryNodeJoinGeometry', 'NodeGroupOutput')}
    for source in ('NodeGroupInput', 'GeometryNodePoints'):
        tree.links.new(nodes[source].outputs[0], nodes['GeometryNodeJoinGeometry'].inputs[0])
    tree.links.new(nodes['GeometryNodeJoinGeometry'].outputs[0], nodes['NodeGroupOutput'].inputs[0])
    for ours in obj.modifiers:
        ours.use_pin_to_last = False
    obj.modifiers.new("Both", 'NODES').node_group = tree
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert len([i for i in depsgraph.object_instances if i.object.original == obj]) == 2
    np.testing.assert_array_equal(render()["ViewLayer.Combined"], once)


def test_parents_and_constraints_place_the_object(scene, make_model, model_file, splat_object, add_camera, render, expected):
    model = make_model(30, spread=0.5)
    obj = splat_object(model_file(model))
    parent = bpy.data.objects.new("Parent", None)
    parent.matrix_world = Matrix(placement(3).tolist())
    scene.collection.objects.link(parent)
    obj.parent = parent
    add_camera()
    scene.render.film_transparent = True
    want = expected([(model, placement(3), 0)])
    by_hand.assert_same_picture(render()["ViewLayer.Combined"], by_hand.combined(want["rgb"], want["alpha"]))


@pytest.fixture
def moving(fg, make_model, splat_object, model_file, scene, add_camera):
    """(model, object): a cloud on the paper's Fourier paths with the paper's temporal opacity, 20 frames at 24 fps."""
    rng = np.random.default_rng(11)
    n, basis = 30, fg.Fourier(2)
    model = make_model(n, motion=rng.normal(0, 0.3, (n, basis.terms, 3)), basis=basis, mu_tau=rng.uniform(0, 1, n),
                       temporal=np.log(rng.uniform(2, 30, (n, 1))), temporal_kind=fg.Radial(), clip=fg.Clip(20, 24.0))
    add_camera()
    scene.render.film_transparent = True
    scene.render.fps, scene.render.fps_base = 24, 1
    return model, splat_object(model_file(model))


def assert_shows(render, expected, model, t):
    """The rendered frame is the model at time t, and t is told from its neighbours."""
    want = expected([(model, np.eye(4), t)])
    picture = by_hand.combined(want["rgb"], want["alpha"])
    by_hand.assert_same_picture(render()["ViewLayer.Combined"], picture)
    other = expected([(model, np.eye(4), t + 0.1 / model.clip.frame_count)])["alpha"]
    assert np.abs(other - want["alpha"]).max() > 6e-3


@pytest.mark.parametrize(("frame", "subframe"), [(1, 0), (10, 0), (10, 0.5), (13, 0.125)])
def test_time_is_exact_between_frames(scene, moving, render, expected, frame, subframe):
    scene.frame_set(frame, subframe=subframe)
    assert_shows(render, expected, moving[0], (frame + subframe - 1) / 20)


def test_time_runs_in_seconds(scene, moving, render, expected):
    scene.render.fps, scene.render.fps_base = 30, 1.001
    scene.frame_set(8)
    assert_shows(render, expected, moving[0], 7 / (30 / 1.001) * 24 / 20)


def test_time_stretching_stretches_splats_as_it_does_keyframes(scene, moving, render, expected):
    scene.render.frame_map_old, scene.render.frame_map_new = 100, 200
    scene.frame_set(9)
    assert_shows(render, expected, moving[0], (4.5 - 1) / 20)


def test_retiming_is_per_object(scene, moving, fg, make_model, model_file, splat_object, render, expected):
    model, _ = moving
    twin = splat_object(model_file(model), "Twin", Matrix.Translation((0.3, 0, 0)))
    twin.fastgs.start_frame, twin.fastgs.speed, twin.fastgs.offset = 4.5, -0.5, -2
    scene.frame_set(8)
    want = expected([(model, np.eye(4), 7 / 20), (model, np.array(Matrix.Translation((0.3, 0, 0))), (19 - 1.75 - 2) / 20)])
    by_hand.assert_same_picture(render()["ViewLayer.Combined"], by_hand.combined(want["rgb"], want["alpha"]))


def test_retiming_can_be_keyframed(scene, moving, render, expected):
    model, obj = moving
    obj.fastgs.speed = 0
    for frame, offset in ((1, 0), (2, 8)):
        obj.fastgs.offset = offset
        obj.fastgs.keyframe_insert("offset", frame=frame)
    curve = image_files.fcurves(obj)[0]
    for key in curve.keyframe_points:
        key.interpolation = 'LINEAR'
    scene.frame_set(1, subframe=0.25)
    assert_shows(render, expected, model, 2 / 20)


@pytest.mark.parametrize(("settings", "t"), [
    (dict(after='HOLD'), 19 / 20), (dict(after='LOOP'), 3.5 / 20), (dict(after='PING_PONG'), 14.5 / 20),
    (dict(before='HOLD', start_frame=60), 0), (dict(before='LOOP', start_frame=30), 14.5 / 20),
])
def test_outside_the_clip(scene, moving, render, expected, settings, t):
    model, obj = moving
    for name, value in settings.items():
        setattr(obj.fastgs, name, value)
    scene.frame_set(24, subframe=0.5)
    assert_shows(render, expected, model, t)


def test_hidden_outside_the_clip(scene, moving, render):
    moving[1].fastgs.after = 'HIDE'
    scene.frame_set(25)
    assert not render()["ViewLayer.Combined"].any()
    scene.frame_set(20, subframe=0.75)
    assert render()["ViewLayer.Combined"].any()


def test_animation(scene, moving, module, fg, tmp_path, expected, monkeypatch):
    """Every frame is its own; the file is read once."""
    reads = []
    monkeypatch.setattr(fg, "open_source", lambda path, read=fg.open_source: reads.append(path) or read(path))
    image_files.set_output(scene, "EXR")
    scene.frame_start, scene.frame_end = 1, 4
    scene.render.filepath = str(tmp_path / "frame_")
    bpy.ops.render.render(animation=True)
    for frame in range(1, 5):
        want = expected([(moving[0], np.eye(4), (frame - 1) / 20)])
        image = image_files.read_exr(tmp_path / f"frame_{frame:04d}.exr")
        by_hand.assert_same_picture(image["ViewLayer.Combined"], by_hand.combined(want["rgb"], want["alpha"]))
    assert len(reads) == 1


def test_same_frame_same_bytes(scene, moving, render):
    scene.frame_set(7)
    first, second = render()["ViewLayer.Combined"], render()["ViewLayer.Combined"]
    np.testing.assert_array_equal(first, second)


def test_threads_follow_the_scene(scene, moving, module, render):
    """One thread or all of them: the same bytes, and Blender's own setting decides."""
    threads = module("fastgs_blender.util.threads")
    many = render()["ViewLayer.Combined"]
    automatic = threads.thread_count()
    scene.render.threads_mode, scene.render.threads = 'FIXED', 3
    few = render()["ViewLayer.Combined"]
    assert threads.thread_count() == 3
    scene.render.threads_mode = 'AUTO'
    render()
    assert threads.thread_count() == automatic
    np.testing.assert_array_equal(few, many)

# SPDX-License-Identifier: GPL-3.0-or-later
"""bpy.ops.fastgs.bake: what Blender shows becomes 4D Gaussians, and the user's scene stays as it was."""
import threading
from pathlib import Path

import bpy
import numpy as np
import pytest

FRAMES = 12


@pytest.fixture
def target(tmp_path):
    return str(tmp_path / "baked.safetensors")


@pytest.fixture
def bake(scene, fg, target):
    """bake(*objects, **options) -> the model: select the objects, run the operator, read its file."""
    scene.frame_start, scene.frame_end = 1, FRAMES

    def run(*objects, **options):
        for obj in scene.objects:
            obj.select_set(obj in objects)
        bpy.ops.fastgs.bake(**{"filepath": target, "count": 400, **options})
        return fg.load(target)

    return run


@pytest.fixture
def add(scene):
    """add("primitive", **options): one of Blender's mesh primitives."""

    def make(kind, **options):
        getattr(bpy.ops.mesh, f"primitive_{kind}_add")(**options)
        return bpy.context.object

    return make


@pytest.fixture
def paint():
    """paint(obj, colour, name="Paint"): a new material on an object, in scene-linear colour; returns it and its shader node."""

    def make(obj, colour=(0.8, 0.8, 0.8), name="Paint"):
        material = bpy.data.materials.new(name)
        if bpy.app.version < (5, 0, 0):
            material.use_nodes = True
        shader = material.node_tree.nodes["Principled BSDF"]
        shader.inputs["Base Color"].default_value = (*colour, 1)
        obj.data.materials.append(material)
        return material, shader

    return make


def key(owner, path, values, index=-1):
    """Keyframes of a property on the first frames, linear between them."""
    for frame, value in enumerate(values, 1):
        if index < 0:
            setattr(owner, path, value)
        else:
            getattr(owner, path)[index] = value
        owner.keyframe_insert(path, index=index, frame=frame)


def srgb(linear):
    x = np.asarray(linear, float)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


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
    with pytest.raises(RuntimeError, match=f'"Lava Lamp" has .*{sentence}.* on frame [67]'):
        bake(cube)
    assert not Path(target).exists() and scene.frame_current == 1
    assert len(scene.objects) == 1


def test_existing_files_and_bad_folders(bake, add, target):
    cube = add("cube")
    Path(target).write_text("mine")
    with pytest.raises(RuntimeError, match="exists already"):
        bake(cube)
    assert Path(target).read_text() == "mine"
    with pytest.raises(RuntimeError, match="folder does not exist"):
        bake(cube, filepath=str(Path(target).parent / "no" / "x.safetensors"))
    with pytest.raises(RuntimeError, match="comes before"):
        bake(cube, frame_start=5, frame_end=4, overwrite=True)
    assert len(bake(cube, overwrite=True)) == 400


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
    assert "Warning: The motion is followed to" in capfd.readouterr().out


# Colour


def colours_of(model):
    """The model's colours, rounded, most frequent first."""
    values, counts = np.unique(model.features.round(3), axis=0, return_counts=True)
    return values[np.argsort(-counts)]


def test_base_colours_of_slots_and_no_material(bake, add, paint):
    cube, plain = add("cube"), add("cube", location=(4, 0, 0))
    paint(cube, (0.2, 0.4, 0.6))
    paint(cube, (0.9, 0.1, 0.0), "Second")
    for polygon in cube.data.polygons[:3]:
        polygon.material_index = 1
    found = {tuple(c) for c in colours_of(bake(cube, plain))}
    assert found == {tuple(srgb(c).round(3).astype(np.float32)) for c in ((0.2, 0.4, 0.6), (0.9, 0.1, 0.0), (0.8, 0.8, 0.8))}


@pytest.mark.parametrize(("is_float", "space"), [(False, 'sRGB'), (False, 'Non-Color'), (True, 'Linear')])
def test_image_texture_through_uv(bake, add, paint, is_float, space):
    """The left half of the picture on the left half of the plane, in its true colour whatever the image's colour space."""
    plane = add("plane", size=2)
    material, shader = paint(plane)
    image = bpy.data.images.new("Picture", 64, 64, float_buffer=is_float)
    if space in image.colorspace_settings.bl_rna.properties["name"].enum_items:
        image.colorspace_settings.name = space
    pixels = np.ones((64, 64, 4), np.float32)
    pixels[:, :32, :3], pixels[:, 32:, :3] = (0.25, 0.5, 0.75), (0.75, 0.25, 0)
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image, node.extension = image, 'EXTEND'
    material.node_tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    model = bake(plane)
    left, right = (model.features[model.position[:, 0] * side > 0.15] for side in (-1, 1))
    stored_as_seen = not is_float and space == 'sRGB'
    for half, colour in ((left, (0.25, 0.5, 0.75)), (right, (0.75, 0.25, 0))):
        assert np.allclose(half, colour if stored_as_seen else srgb(colour), atol=4e-3)  # 8 bits


def test_mapping_extension_and_alpha_of_an_image(bake, add, paint):
    plane = add("plane", size=2)
    material, shader = paint(plane)
    image = bpy.data.images.new("Leaf", 8, 8, alpha=True)
    pixels = np.ones((8, 8, 4), np.float32)
    pixels[:4, :, 3] = 0
    image.pixels.foreach_set(pixels.ravel())
    nodes, links = material.node_tree.nodes, material.node_tree.links
    texture, mapping, place = (nodes.new(kind) for kind in ("ShaderNodeTexImage", "ShaderNodeMapping", "ShaderNodeTexCoord"))
    texture.image, texture.interpolation = image, 'Closest'
    mapping.inputs["Location"].default_value[1] = 0.25
    links.new(place.outputs["UV"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    links.new(texture.outputs["Alpha"], shader.inputs["Alpha"])
    y = bake(plane, count=2000).position[:, 1]
    # v + 0.25 lies in the opaque upper half for v in 0.25 .. 0.75: y in -0.5 .. 0.5
    assert abs(y).max() < 0.55 and np.abs(y).mean() == pytest.approx(0.25, abs=0.02)


def test_colour_attribute_mixed_in_nodes(bake, add, paint):
    grid = add("grid", x_subdivisions=10, y_subdivisions=10, size=2)
    material, shader = paint(grid)
    attribute = grid.data.color_attributes.new("Tint", 'FLOAT_COLOR', 'POINT')
    attribute.data.foreach_set("color", np.ravel([(v.co.x * 0.5 + 0.5, 0.5, 0, 1) for v in grid.data.vertices]))
    nodes, links = material.node_tree.nodes, material.node_tree.links
    tint, mix, path = nodes.new("ShaderNodeVertexColor"), nodes.new("ShaderNodeMix"), nodes.new("NodeReroute")
    tint.layer_name = "Tint"
    mix.data_type, mix.blend_type = 'RGBA', 'MULTIPLY'
    factor, a, b = (next(s for s in mix.inputs if s.identifier == k) for k in ("Factor_Float", "A_Color", "B_Color"))
    factor.default_value = 1.0
    b.default_value = (0.5, 0.5, 0.5, 1)
    links.new(tint.outputs["Color"], path.inputs[0])
    links.new(path.outputs[0], a)
    links.new(next(s for s in mix.outputs if s.identifier == "Result_Color"), shader.inputs["Base Color"])
    model = bake(grid)
    assert np.allclose(model.features[:, 0], srgb((model.position[:, 0] * 0.5 + 0.5) * 0.5), atol=0.05)
    assert np.allclose(model.features[:, 1], srgb(0.25), atol=1e-3)


def test_what_only_a_renderer_can_evaluate_is_named(bake, add, paint, capfd):
    cube = add("cube")
    material, shader = paint(cube, name="Marble")
    material.diffuse_color = (0.1, 0.2, 0.3, 1)
    noise = material.node_tree.nodes.new("ShaderNodeTexNoise")
    material.node_tree.links.new(noise.outputs["Color"], shader.inputs["Base Color"])
    model = bake(cube)
    assert np.allclose(model.features, srgb((0.1, 0.2, 0.3)), atol=1e-6)
    assert 'material "Marble"' in capfd.readouterr().out


def test_light_and_shadow(bake, add, paint, scene):
    """Under a sun a floor is bright, dark where a ball hides it, and black on nobody's side that light reaches."""
    floor, ball = add("plane", size=6), add("uv_sphere", radius=0.8, location=(0, 0, 1.6))
    paint(floor, (0.5, 0.5, 0.5))
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", 'SUN'))
    sun.data.energy = np.pi  # white paper at a right angle reflects 1
    scene.collection.objects.link(sun)
    model = bake(floor, lighting='CYCLES', light_samples=12, light_frames=1, count=1500)
    away = np.linalg.norm(model.position[:, :2], axis=1)
    assert np.allclose(model.features[away > 1.8], srgb(0.5), atol=0.02)
    assert model.features[away < 0.4].max() < 0.4
    assert ball.name in scene.objects


# A real character


@pytest.mark.parametrize(("action", "frames"), [("Robot_Running", (0, 9.5, 17, 21.5))])
def test_a_real_character(fg, target, action, frames):
    file = Path(__file__).resolve().parents[3] / "shared" / "data" / "robot" / "RobotExpressive.blend"
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


def test_in_steps_beside_the_user(module, add, scene, fg):
    """As with a window: the work goes on in a thread, gives the same model, and can be broken off at any point."""
    bake_module = module("operators.bake")
    cube = add("cube")
    key(cube, "location", [(0.1 * f, 0, np.sin(f / 3)) for f in range(FRAMES)])
    scene.frame_set(5, subframe=0.5)
    settings = bake_module.Settings(1, FRAMES, count=300)

    def finish(in_background):
        steps, shares = bake_module.bake_steps(bpy.context, [cube], settings, in_background), []
        while True:
            try:
                shares.append(next(steps))
            except StopIteration as end:
                return end.value, shares

    (blocking, _, _), _ = finish(False)
    (model, report, notes), shares = finish(True)
    assert shares == sorted(shares) and shares[0] >= 0 and shares[-1] <= 1 and report.gaussians == 300 and not notes
    assert all(np.array_equal(a, b) for a, b in zip(model.arrays.values(), blocking.arrays.values(), strict=True))
    for stop in range(1, len(shares), 7):
        steps = bake_module.bake_steps(bpy.context, [cube], settings, True)
        for _ in range(stop):
            next(steps)
        steps.close()
        assert (scene.frame_current, scene.frame_subframe) == (5, 0.5)
        assert not any(t.name == "FAST-GS bake" for t in threading.enumerate())

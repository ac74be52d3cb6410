# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes in Blender: beside Cycles' on a baked mesh, and what the compositor makes of them."""
import bpy
import image_files
import numpy as np
import pytest

FRAMES = 12


@pytest.fixture
def twins(scene, bake, add, add_camera):
    """A cube that travels before a camera that moves, and the splats that it is baked to."""
    cube = add("cube", size=2)
    for frame in range(1, FRAMES + 1):
        cube.location, cube.rotation_euler = (0.05 * frame, 0.1 * frame - 0.6, -0.03 * frame), (0.4, 0.2, 0.6)
        cube.keyframe_insert("location", frame=frame)
    for curve in image_files.fcurves(cube):
        for point in curve.keyframe_points:
            point.interpolation = 'LINEAR'
    cube.pass_index = 7
    bake(cube, count=12000, basis='FOURIER')  # which holds steady travel exactly
    splats = next(obj for obj in scene.objects if obj.fastgs.filepath)
    splats.pass_index = 7
    add_camera((0.3, -6, 0.5), (85, 0, 0))
    scene.camera.location = 0.3, -6, 0.5
    scene.camera.keyframe_insert("location", frame=1)
    scene.camera.location = 0.8, -6, 0.5
    scene.camera.keyframe_insert("location", frame=FRAMES)
    scene.frame_set(6)
    return splats


def test_sorting_by_pixel(scene, make_model, model_file, splat_object, add_camera, render):
    """Two sheets that cross: each is in front on its side, and what the setting leaves alone is the picture of before."""
    turns = [[np.cos(a), 0, 0, np.sin(a)] for a in (0.35, -0.35)]
    model = make_model(2, position=np.zeros((2, 3)), rotation=np.array(turns), scale=np.log(np.tile([1.0, 0.01, 0.6], (2, 1))),
                       opacity=np.full(2, 5.0), features=np.array([[1.0, 0, 0], [0, 0, 1.0]]))
    splat_object(model_file(model))
    add_camera()
    scene.render.film_transparent = True
    first = render()["ViewLayer.Combined"]
    scene.fastgs.sorting = 'PIXEL'
    found = render()["ViewLayer.Combined"]
    row = found[24, :, 0] > found[24, :, 2]
    left, right = row[26:31], row[33:38]
    assert left.all() != right.all() and left.any() != right.any()
    scene.fastgs.sorting = 'CENTRE'
    assert np.array_equal(render()["ViewLayer.Combined"], first) and np.abs(first - found).max() > 0.3


def test_passes_are_those_of_cycles(scene, twins, render):
    """On an opaque mesh: depth to 0.5 %, normals to 5 degrees (median), vectors to 0.05 px (mean), place, mist and index."""
    splats = twins
    scene.render.resolution_x, scene.render.resolution_y = 160, 120
    layer = scene.view_layers[0]
    layer.use_pass_z = layer.use_pass_mist = layer.use_pass_position = layer.use_pass_normal = layer.use_pass_vector = True
    layer.use_pass_object_index = layer.fastgs.use_pass_alpha = layer.fastgs.use_pass_count = True
    scene.world = bpy.data.worlds.new("World")
    scene.world.mist_settings.start, scene.world.mist_settings.depth, scene.world.mist_settings.falloff = 3, 6, 'LINEAR'
    ours = render()
    scene.render.engine = 'CYCLES'
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.device = 8, False, 'CPU'
    splats.hide_render = True
    theirs = render()
    index = "Object Index" if bpy.app.version >= (5, 0, 0) else "IndexOB"
    solid = (ours["ViewLayer.Splat Alpha"][..., 0] > 0.99) & (theirs[f"ViewLayer.{index}"][..., 0] == 7)
    assert 0.1 < solid.mean() < 0.6

    def both(name):
        return ours[f"ViewLayer.{name}"][solid], theirs[f"ViewLayer.{name}"][solid]

    near, exact = both("Depth")
    assert np.mean(np.abs(near / exact - 1)) < 0.005
    a, b = both("Normal")
    angle = np.degrees(np.arccos(np.clip((a * b).sum(-1) / np.linalg.norm(b, axis=-1), -1, 1)))
    assert np.median(angle) < 5
    a, b = both("Vector")
    assert np.abs(a - b).mean() < 0.05 and np.abs(b).mean(0).min() > 0.2, "beside Cycles', which moves"
    a, b = both("Position")
    assert np.median(np.linalg.norm(a - b, axis=-1)) < 0.03
    a, b = both("Mist")
    assert np.median(np.abs(a - b)) < 0.01
    assert (ours["ViewLayer.Mist"][0] == 1).all() and (theirs["ViewLayer.Mist"][0] == 1).all()
    assert (both(index)[0] == 7).mean() == 1 and (ours[f"ViewLayer.{index}"][0] == 0).all()
    assert ours["ViewLayer.Gaussian Count"][..., 0][solid].min() >= 1
    assert scene.frame_current == 6


def test_the_cryptomatte_node_finds_objects(scene, make_model, model_file, splat_object, add_camera, render, compositor):
    """Blender's own node, asked for an object's name, gives that object's share of each pixel."""
    splat_object(model_file(make_model(seed=1), "a.safetensors"), "Größe")
    splat_object(model_file(make_model(seed=2), "b.safetensors"), "other")
    add_camera()
    layer = scene.view_layers[0]
    layer.use_pass_cryptomatte_object, layer.pass_cryptomatte_depth = True, 4
    layer.fastgs.use_pass_alpha = True
    scene.render.film_transparent = True
    image = render()
    assert "ViewLayer.CryptoObject01" in image and "ViewLayer.CryptoObject02" not in image
    cover = sum(image[f"ViewLayer.CryptoObject{i:02d}"][..., [1, 3]].sum(-1) for i in range(2))
    np.testing.assert_allclose(cover, image["ViewLayer.Splat Alpha"][..., 0], atol=1e-5)
    tree = compositor.layers.id_data
    node = tree.nodes.new('CompositorNodeCryptomatteV2')
    node.source, node.scene = 'RENDER', scene
    matte = {}
    for name in ("Größe", "other"):
        node.matte_id = name
        output = next(each for each in tree.nodes if each.bl_idname in ('NodeGroupOutput', 'CompositorNodeComposite'))
        tree.links.new(node.outputs["Matte"], output.inputs[0])
        matte[name] = render("PNG16")[..., 0]
    np.testing.assert_allclose(sum(matte.values()), cover, atol=1e-4)
    assert all(share.max() > 0.3 for share in matte.values())

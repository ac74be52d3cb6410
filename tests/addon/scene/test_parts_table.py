# SPDX-License-Identifier: GPL-3.0-or-later
"""What docs/parts.md says of a part, cell by cell: each row of its table is a test here, which has the row's name."""
from __future__ import annotations

import base64
import json
import re
import zlib
from pathlib import Path

import bpy
import numpy as np
import pytest

N, MINE = 80, np.arange(80) % 4 == 0
"""Gaussians of the file, and which of them become the part."""
PAGE = Path(__file__).resolve().parents[3] / "docs" / "parts.md"


@pytest.fixture
def truth(fg, make_model):
    """The whole model: the part's Gaussians lie to the right, the others to the left; all move upwards."""
    rng = np.random.default_rng(1)
    position = rng.uniform(-0.5, 0.5, (N, 3)) + np.where(MINE[:, None], (1.0, 0, 0), (-1.0, 0, 0))
    return make_model(N, position=position, scale=np.full((N, 3), np.log(0.08)), opacity=np.full(N, 3.0), basis=fg.Polynomial(1),
                      motion=np.tile([0.0, 0.0, 0.5], (N, 1, 1)), mu_tau=np.zeros(N), clip=fg.Clip(10, 24.0), axes="RFU")


@pytest.fixture
def pair(truth, model_file, add_camera, scene, module):
    """(the object, its part) before a camera 64 pixels and 4 units wide, on the third frame."""
    add_camera(type='ORTHO', ortho_scale=4.0)
    scene.render.film_transparent = True
    bpy.ops.import_scene.fastgs(filepath=model_file(truth))
    obj = bpy.context.object
    obj.fastgs.start_frame = 1
    module("scene.selection").select(obj, MINE)
    assert bpy.ops.fastgs.separate(name="Ball") == {'FINISHED'}
    scene.frame_set(3)
    return obj, bpy.context.object


def halves(image):
    """The light in the left and the right half of a picture."""
    return image[:, :32].sum(), image[:, 32:].sum()


def alpha(render):
    return halves(render()["ViewLayer.Combined"][..., 3])


def test_hidden(pair, render):
    whole = alpha(render)
    pair[1].hide_render = True
    left, right = alpha(render)
    assert left == pytest.approx(whole[0], rel=1e-5) and right == 0 < whole[1]


def test_transform(pair, render):
    before = render()["ViewLayer.Combined"][..., 3]
    pair[1].location.z = 0.5
    after = render()["ViewLayer.Combined"][..., 3]
    np.testing.assert_allclose(after[:, :32], before[:, :32], atol=1e-6)
    np.testing.assert_allclose(after[:-8, 32:], before[8:, 32:], atol=1e-4)


def test_look(pair, render):
    before = render()["ViewLayer.Combined"]
    pair[1].fastgs.tint, pair[1].fastgs.opacity = (1, 0, 0), 0.5
    after = render()["ViewLayer.Combined"]
    np.testing.assert_allclose(after[:, :32], before[:, :32], atol=1e-6)
    assert after[:, 32:, 1].max() < 1e-5 < before[:, 32:, 1].max() and after[:, 32:, 3].sum() < 0.9 * before[:, 32:, 3].sum()


def test_scene_light(pair, render):
    """How much of the captured light and of lamps it takes is its own."""
    before = render()["ViewLayer.Combined"]
    pair[1].fastgs.captured_light = 0.0
    after = render()["ViewLayer.Combined"]
    np.testing.assert_allclose(after[:, :32], before[:, :32], atol=1e-6)
    assert after[:, 32:, :3].max() < 1e-3 < before[:, 32:, :3].max()
    np.testing.assert_allclose(after[..., 3], before[..., 3], atol=1e-6)


def taken(module):
    """What viewports show."""
    return module("scene.snapshot").take(bpy.context.evaluated_depsgraph_get(), rendered=False)


def test_density(pair, render, module):
    before = alpha(render)
    pair[1].fastgs.viewport_density = 0.5
    assert alpha(render) == pytest.approx(before, rel=1e-5)
    assert {item.name: item.settings.density for item in taken(module).instances} == {"Ball": 0.5, pair[0].name: 1.0}
    pair[1].fastgs.density = 0.3
    after = alpha(render)
    assert after[0] == pytest.approx(before[0], rel=1e-5) and after[1] < 0.6 * before[1]


def test_time(pair, module, scene):
    """Start, speed, offset, freeze and trim are its own; 0.1 of t are a frame."""
    def ahead():
        bpy.context.view_layer.update()
        instances = {item.name: instance.t for item, instance in taken(module).pairs()[0]}
        return instances["Ball"] - instances[pair[0].name]

    own = pair[1].fastgs
    for name, value, before, frames in (("start_frame", -1, 1, 2), ("offset", 3, 0, 3), ("speed", 2, 1, 2), ("speed", 0, 1, -2)):
        setattr(own, name, value)
        assert ahead() == pytest.approx(0.1 * frames, abs=1e-6), name
        setattr(own, name, before)
    own.use_capture_frame, own.capture_frame = True, 7
    assert ahead() == pytest.approx(0.5, abs=1e-6)  # frozen on its seventh frame
    own.use_capture_frame, own.start_frame = False, -1
    pair[1].fastgs.before, pair[1].fastgs.trim_start = 'HIDE', 8
    pair[1].fastgs.start_frame = 9
    scene.frame_set(3)
    assert len(module("scene.snapshot").take(bpy.context.evaluated_depsgraph_get()).load()[0]) == 1


def test_crops_filters_and_erasing(pair, render, module):
    whole = alpha(render)
    item = pair[1].fastgs.filters.add()
    item.kind, item.low, item.high, item.mode = 'OPACITY', 0.0, 1.0, 'HIDE'
    assert alpha(render)[1] == 0
    item.use = False
    module("scene.selection").erase(pair[1], MINE & (np.arange(N) < 40))
    left, right = alpha(render)
    assert left == pytest.approx(whole[0], rel=1e-5) and 0 < right < 0.7 * whole[1]
    bpy.ops.fastgs.show_hidden()
    bpy.ops.fastgs.add_crop_box()
    pair[1].fastgs.crops[0].mode = 'REMOVE'
    left, right = alpha(render)
    assert left == pytest.approx(whole[0], rel=1e-5) and right < 0.2 * whole[1]


def test_passes(pair, render, scene):
    """Object Index, and a Cryptomatte id of its own."""
    pair[0].pass_index, pair[1].pass_index = 3, 9
    layer = bpy.context.view_layer
    layer.use_pass_object_index = layer.use_pass_cryptomatte_object = layer.use_pass_z = True
    found = render()
    index = next(value for name, value in found.items() if name.endswith("IndexOB") or "Object Index" in name)[..., 0]
    assert {3.0} == set(np.unique(index[:, :32])) - {0.0} and {9.0} == set(np.unique(index[:, 32:])) - {0.0}
    ids = next(value for name, value in found.items() if "CryptoObject00" in name)[..., 0].view(np.uint32)
    assert len(set(np.unique(ids[:, :32])) - {0}) == len(set(np.unique(ids[:, 32:])) - {0}) == 1
    assert not (set(np.unique(ids[:, :32])) & set(np.unique(ids[:, 32:]))) - {0}


def test_motion_blur(pair, render, scene):
    """Both move by their model's motion and by their own."""
    scene.render.use_motion_blur = True
    pair[1].location.x = 0
    for frame, x in ((2, 0.0), (4, 0.8)):
        pair[1].location.x = x
        pair[1].keyframe_insert("location", frame=frame)
    found = render()["ViewLayer.Combined"][..., 3]
    scene.render.use_motion_blur = False
    still = render()["ViewLayer.Combined"][..., 3]
    assert np.abs(found[:, 36:] - still[:, 36:]).max() > 0.05 and found.sum() == pytest.approx(still.sum(), rel=0.05)


def test_viewports(pair, module, now, scene):
    """One order of both, by models that hold their own Gaussians alone."""
    sorting, atlas = module("engine.viewport.sorting"), module("engine.viewport.atlas")
    shown = module("scene.snapshot").take(bpy.context.evaluated_depsgraph_get(), rendered=False)
    found = sorting.sort(shown, now(scene.camera), 1.0, atlas.Atlas())
    assert sorted(len(instance.model) for instance in found.instances) == [20, 60] and found.count == N


def test_other_engines(pair):
    """Its own points stand for it: they lie where its Gaussians are."""
    for obj, side in zip(pair, (-1, 1), strict=True):
        at = np.array([corner[0] for corner in obj.bound_box])
        assert (at * side > 0).all()
    assert pair[0].data != pair[1].data


def test_native_copy(pair, module):
    with bpy.context.temp_override(object=pair[1], active_object=pair[1], selected_objects=[pair[1]]):
        assert bpy.ops.fastgs.native_copy(kind='DISCS') == {'FINISHED'}
    copy = module("scene.splats.native").copies()[0]
    assert copy.parent == pair[1] and len(copy.data.vertices) == 6 * MINE.sum()


def test_geometry_nodes(pair, render, module, scene):
    """Modifiers Change: Splats gives the part a point for each of its Gaussians, and what is done to them is seen."""
    before = alpha(render)
    pair[1].fastgs.points = 'ALL'
    bpy.context.view_layer.update()
    assert len(pair[1].data.vertices) == MINE.sum() + 4
    modifier = pair[1].modifiers.new("Away", 'NODES')
    tree = modifier.node_group = bpy.data.node_groups.new("Away", 'GeometryNodeTree')
    for way in ('INPUT', 'OUTPUT'):
        tree.interface.new_socket("Geometry", in_out=way, socket_type='NodeSocketGeometry')
    start, place, end = (tree.nodes.new(kind) for kind in ('NodeGroupInput', 'GeometryNodeSetPosition', 'NodeGroupOutput'))
    place.inputs["Offset"].default_value = (-2.0, 0, 0)
    tree.links.new(start.outputs[0], place.inputs[0])
    tree.links.new(place.outputs[0], end.inputs[0])
    left, right = alpha(render)
    assert right < 0.02 * before[1] and left > 1.05 * before[0]


def test_camera_visibility_and_shadow_switches(pair, render, module):
    """Ray Visibility is the part's own: whether renders show it, and whether it throws shadows (tests/library/rendering/test_shadow.py)."""
    whole = alpha(render)
    pair[1].visible_camera = False
    left, right = alpha(render)
    assert right == 0 and left == pytest.approx(whole[0], rel=1e-5)
    pair[1].visible_camera = True
    pair[1].visible_shadow = False
    bpy.context.view_layer.update()
    assert {item.name: item.settings.casts for item in taken(module).instances} == {"Ball": False, pair[0].name: True}
    assert alpha(render) == pytest.approx(whole, rel=1e-5)


def test_instances(pair, render, scene):
    """An empty that instances a collection with the part alone."""
    home = bpy.data.collections.new("Home")
    home.objects.link(pair[1])
    pair[1].hide_render = False
    empty = bpy.data.objects.new("Copy", None)
    empty.instance_type, empty.instance_collection, empty.location.x = 'COLLECTION', home, -2.0
    scene.collection.objects.link(empty)
    pair[0].hide_render = True
    left, right = alpha(render)
    assert left == pytest.approx(right, rel=0.02) and right > 0


def test_export_of_a_frame(pair, fg, tmp_path, truth):
    """Everything, or the part alone, where it stands; as objects of their own in glTF, and again when it is imported."""
    pair[1].location.z = 1
    for name, selected, count in (("all.ply", False, N), ("part.ply", True, MINE.sum())):
        assert bpy.ops.export_scene.fastgs(filepath=str(tmp_path / name), content='FRAME', selected=selected) == {'FINISHED'}
        model = fg.load(tmp_path / name)
        assert len(model) == count
    wanted = truth.position[MINE] + (0, 0, 0.5 * 0.2 + 1)
    np.testing.assert_allclose(np.sort(as_blender(model), 0), np.sort(wanted, 0), atol=1e-3)
    assert bpy.ops.export_scene.fastgs(filepath=str(tmp_path / "both.glb"), content='FRAME', static_format='GLTF') == {'FINISHED'}
    both = fg.load(tmp_path / "both.glb")
    np.testing.assert_allclose(np.sort(as_blender(both)[both.parts["Ball"]], 0), np.sort(wanted, 0), atol=1e-3)
    assert both.parts[pair[0].name].sum() == N - MINE.sum()
    bpy.ops.import_scene.fastgs(filepath=str(tmp_path / "both.glb"))
    assert sorted(obj.fastgs.gaussian_count for obj in (bpy.context.object, *bpy.context.object.children)) == [20, 60]


def as_blender(model):
    """Positions in Blender's axes."""
    return model.position if model.axes == "RFU" else np.stack([model.position[:, 0], model.position[:, 2], -model.position[:, 1]], 1)


def test_export_of_the_model(pair, fg, tmp_path):
    """The active object's own Gaussians, with their motion."""
    assert bpy.ops.export_scene.fastgs(filepath=str(tmp_path / "ball.safetensors"), content='MODEL') == {'FINISHED'}
    model = fg.load(tmp_path / "ball.safetensors")
    assert len(model) == MINE.sum() and (model.position[:, 0] > 0).all() and model.motion.any()


def test_parts_in_our_files(pair, fg, tmp_path, truth, module, render):
    """The object's model holds its part by name; its import makes both objects again, and the same picture."""
    before = render()["ViewLayer.Combined"]
    bpy.context.view_layer.objects.active = pair[0]
    path = tmp_path / "both.safetensors"
    assert bpy.ops.export_scene.fastgs(filepath=str(path), content='MODEL') == {'FINISHED'}
    model = fg.load(path)
    assert model.parts.names == ("Ball",) and np.array_equal(model.parts["Ball"], MINE)
    for obj in pair:
        bpy.data.objects.remove(obj)
    assert bpy.ops.import_scene.fastgs(filepath=str(path), view='KEEP') == {'FINISHED'}
    whole = bpy.context.object
    (part,) = whole.children
    assert (part.name, part.fastgs.gaussian_count, whole.fastgs.gaussian_count) == ("Ball", 20, 60) and whole.select_get()
    whole.fastgs.start_frame = part.fastgs.start_frame = 1
    np.testing.assert_allclose(render()["ViewLayer.Combined"], before, atol=2e-6)


def test_delete_for_good(pair, fg, tmp_path, render, module):
    """Writes a file of the part alone, which the part shows from then on; the other object keeps its own."""
    module("scene.selection").erase(pair[1], np.arange(N) == 4)
    before = render()["ViewLayer.Combined"]
    assert bpy.ops.fastgs.delete_for_good(filepath=str(tmp_path / "ball.safetensors")) == {'FINISHED'}
    assert len(fg.load(tmp_path / "ball.safetensors")) == MINE.sum() - 1
    assert (pair[1].fastgs.part, pair[1].fastgs.mask) == ("", "") and pair[0].fastgs.part
    np.testing.assert_allclose(render()["ViewLayer.Combined"], before, atol=2e-6)


def test_web_page(pair, fg, tmp_path, scene, module, monkeypatch):
    """Two objects of the page, each with a file of its own Gaussians."""
    for part, name, value in (("sensitivity", "WIDTH", 64), ("rate", "SHOTS", 8), ("rate", "JUDGED", 3), ("rate", "SHOWN", 64)):
        monkeypatch.setattr(module(f"fastgs_blender.formats.{part}"), name, value)
    scene.frame_start, scene.frame_end = 1, 3
    assert bpy.ops.fastgs.export_page(filepath=str(tmp_path / "page.html")) == {'FINISHED'}
    text = (tmp_path / "page.html").read_text("utf-8")
    blocks = dict(re.findall(r'<script type="[a-z/]+" id="([\w-]+)">(.*?)</script>', text, re.DOTALL))
    files = [base64.b64decode(blocks[name]) for name in json.loads(blocks["scene"])["parts"]]
    counts = []
    for number, data in enumerate(files):
        path = tmp_path / f"{number}.safetensors"
        path.write_bytes(data if data[:1] != b"\x78" else zlib.decompress(data))
        counts.append(len(fg.load(path)))
    assert sorted(counts) == [20, 60]


def test_undo(pair, module):
    """Separate, which made the part, and Join Parts are one step each."""
    bits, whole = module("scene.selection").bits, pair[0].name
    bpy.ops.ed.undo_push(message="Separated")
    for obj in pair:
        obj.select_set(True)
    bpy.context.view_layer.objects.active = pair[0]
    assert bpy.ops.fastgs.join_parts() == {'FINISHED'}
    bpy.ops.ed.undo_push(message="Joined")
    assert "Ball" not in bpy.data.objects and bpy.data.objects[whole].fastgs.part == ""
    bpy.ops.ed.undo()
    assert bits(bpy.data.objects["Ball"], "part").tolist() == MINE.tolist()
    assert bits(bpy.data.objects[whole], "part").tolist() == (~MINE).tolist()
    bpy.ops.ed.redo()
    assert "Ball" not in bpy.data.objects


def test_saved_and_opened(pair, module, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    assert shown_counts(module) == [20, 60] and bpy.data.objects["Ball"].parent.name == "model"


@pytest.fixture
def library(pair, tmp_path):
    """A .blend with both objects; the open file is another one, with the same camera."""
    path = str(tmp_path / "library.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path, copy=True)
    for obj in pair:
        bpy.data.objects.remove(obj)
    return path


def shown_counts(module):
    bpy.context.view_layer.update()
    instances, left_out = module("scene.snapshot").take(bpy.context.evaluated_depsgraph_get()).load()
    assert not left_out
    return sorted(len(instance.model) for instance in instances)


@pytest.mark.parametrize("link", [False, True], ids=["append", "link"])
def test_append_and_link(library, module, scene, link):
    with bpy.data.libraries.load(library, link=link) as (_, wanted):
        wanted.objects = ["Ball"]
    scene.collection.objects.link(wanted.objects[0])
    assert shown_counts(module) == [20]
    scene.collection.objects.link(wanted.objects[0].parent)
    assert shown_counts(module) == [20, 60]


def test_override(library, module, scene):
    """The override's part and mask can be changed, and the library's stay."""
    with bpy.data.libraries.load(library, link=True) as (_, wanted):
        wanted.objects = ["Ball"]
    linked = wanted.objects[0]
    scene.collection.objects.link(linked)  # Blender 5.3 makes overrides of what is used
    mine = linked.override_create(remap_local_usages=True)
    module("scene.selection").erase(mine, np.arange(N) < 40)
    assert mine.fastgs.part == linked.fastgs.part and not linked.fastgs.mask
    (instance,), _ = module("scene.snapshot").take(bpy.context.evaluated_depsgraph_get()).load()
    assert instance.hidden.sum() == 10 and len(instance.model) == 20
    bpy.context.view_layer.objects.active = mine
    assert bpy.ops.fastgs.show_whole() == {'FINISHED'} and linked.fastgs.part
    assert shown_counts(module) == [N]


def test_duplicates_and_another_scene(pair, module, scene):
    """A copy shows the same; linked into another scene the part stands there alone."""
    twin = pair[1].copy()
    scene.collection.objects.link(twin)
    assert shown_counts(module) == [20, 20, 60]
    other = bpy.data.scenes.new("Other")
    other.collection.objects.link(pair[1])
    with bpy.context.temp_override(scene=other, view_layer=other.view_layers[0]):
        assert shown_counts(module) == [20]


def test_every_row_of_the_table_is_tested():
    rows = re.findall(r"^\| [^|]+ \| [^|]+ \| `(test_\w+)` \|$", PAGE.read_text("utf-8"), re.MULTILINE)
    tests = {name for name in globals() if name.startswith("test_")} - {"test_every_row_of_the_table_is_tested"}
    assert len(rows) > 15 and set(rows) == tests

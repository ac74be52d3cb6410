# SPDX-License-Identifier: GPL-3.0-or-later
"""Crop boxes in Blender: what final renders and viewports show of a cropped object, the operators, and what is written for good."""
from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix


@pytest.fixture
def row(fg):
    """Ten Gaussians along x from -0.9 to 0.9, in a clip of ten frames in which they move by one to the right."""
    x = np.linspace(-0.9, 0.9, 10)
    return fg.GaussianModel(
        position=np.stack([x, 0 * x, 0 * x], 1), rotation=np.tile([1.0, 0, 0, 0], (10, 1)), scale=np.full((10, 3), np.log(0.02)),
        opacity=np.full(10, 4.0), features=np.full((10, 3), 0.8), motion=np.tile([1.0, 0, 0], (10, 1, 1)), basis=fg.Polynomial(1),
        mu_tau=np.zeros(10), clip=fg.Clip(10, 24.0), axes="RFU")


@pytest.fixture
def obj(row, model_file, scene, add_camera):
    """The row, imported, before a camera that looks along y at 4 units' width."""
    bpy.ops.import_scene.fastgs(filepath=model_file(row))
    add_camera(type='ORTHO', ortho_scale=4.0)
    scene.frame_start = bpy.context.object.fastgs.start_frame = 1
    return bpy.context.object


def add_box(obj, low, high, mode='KEEP', parent=None):
    """A mesh that reaches from low to high along x, as a crop box."""
    mesh = bpy.data.meshes.new("Box")
    mesh.from_pydata([(x, y, z) for x in (low, high) for y in (-1, 1) for z in (-1, 1)], [], [])
    box = bpy.data.objects.new("Box", mesh)
    bpy.context.scene.collection.objects.link(box)
    box.parent = parent
    item = obj.fastgs.crops.add()
    item.object, item.mode = box, mode
    return box


@pytest.fixture
def seen(render):
    """seen(): where along x the final render shows something, in Blender's units."""

    def places():
        alpha = render()["ViewLayer.Combined"][..., 3].max(0)
        columns = np.flatnonzero(alpha > 0.2)
        runs = np.split(columns, np.flatnonzero(np.diff(columns) > 1) + 1)
        return [round(float((run.mean() + 0.5) / 64 * 4 - 2), 1) for run in runs if len(run)]

    return places


def row_between(low, high, shift=0.0):
    return [round(x, 1) for x in np.linspace(-0.9, 0.9, 10) + shift if low <= x <= high]


def test_f12_shows_what_the_boxes_leave(obj, seen, scene):
    scene.render.film_transparent = True
    assert seen() == row_between(-1, 1)
    keep = add_box(obj, -0.6, 0.2)
    assert seen() == row_between(-0.6, 0.2)
    add_box(obj, -0.2, 0.0, 'REMOVE')
    assert seen() == [-0.5, -0.3, 0.1]
    obj.fastgs.crops[1].use = False
    keep.location.x = 0.6
    assert seen() == row_between(0.0, 0.8)
    keep.hide_set(True)  # the box need not be seen
    keep.location.x = 0.2
    assert seen() == row_between(-0.4, 0.4)
    keep.hide_render = keep.hide_viewport = True
    keep.location.x = 0.4
    assert seen() == row_between(-0.2, 0.6)


def test_time_and_place_count(obj, seen, scene):
    """The Gaussians' centres on the current frame decide; a box that is the object's child moves with it; animated boxes move."""
    scene.render.film_transparent = True
    box = add_box(obj, -0.6, 0.2)
    scene.frame_set(3)  # two tenths of the clip
    assert seen() == row_between(-0.6, 0.2, shift=0.2)
    box.parent = obj
    obj.location.x = 0.6
    assert seen() == row_between(0.0, 0.8, shift=0.8)
    obj.location.x = 0.0
    for frame, x in ((1, 0.0), (3, 0.4)):
        box.location.x = x
        box.keyframe_insert("location", frame=frame)
    assert seen() == row_between(-0.2, 0.6, shift=0.2)


def test_instances_are_cropped_alike(obj, seen, scene):
    """The box belongs to the object: its instances show the same of it elsewhere."""
    scene.render.film_transparent = True
    add_box(obj, -0.6, -0.2)
    collection = bpy.data.collections.new("Instanced")
    collection.objects.link(obj)
    scene.collection.objects.unlink(obj)
    instance = bpy.data.objects.new("Instance", None)
    instance.instance_type, instance.instance_collection = 'COLLECTION', collection
    instance.location.x = 1.0
    scene.collection.objects.link(instance)
    assert seen() == row_between(0.4, 0.8, shift=1.0)


def test_a_flat_box_keeps_nothing(obj, seen, scene):
    scene.render.film_transparent = True
    add_box(obj, 0.1, 0.1)
    assert seen() == []
    obj.fastgs.crops[0].mode = 'REMOVE'
    assert len(seen()) == 10


def test_viewports_ask_for_another_order_when_a_box_moves(obj, module):
    """What a viewport asks its thread for says where the boxes are, and the answer holds what they leave."""
    names = ("scene.snapshot", "engine.viewport.sorting", "engine.viewport.atlas")
    snapshot, sorting, atlas = (module(name) for name in names)
    camera = module("fastgs_blender").Camera(64, 48, 16, 16, 32, 24, np.diag([1.0, -1, -1, 1]) @ np.array(
        Matrix.Rotation(-np.pi / 2, 4, 'X') @ Matrix.Translation((0, 5, 0))), orthographic=True)

    def now():
        depsgraph = bpy.context.evaluated_depsgraph_get()
        now = snapshot.take(depsgraph)
        return now.state, sorting.sort(now, camera, 1.0, atlas.Atlas()).count

    whole, count = now()
    assert count == 10
    box = add_box(obj, -0.6, 0.2)
    cropped, count = now()
    assert count == 4 and cropped != whole
    box.location.x = 0.2
    assert now()[0] != cropped


def test_operators(obj, module, seen, scene):
    """A new box is an empty around all of it, that moves with it; taken off the list it stays in the scene."""
    scene.render.film_transparent = True
    assert bpy.ops.fastgs.add_crop_box() == {'FINISHED'}
    box = obj.fastgs.crops[0].object
    assert box.type == 'EMPTY' and box.parent == obj and box.select_get() and bpy.context.object == obj
    assert len(seen()) == 10
    box.scale.x *= 0.5
    assert 3 < len(seen()) < 8
    with pytest.raises(RuntimeError, match="no number 1"):
        bpy.ops.fastgs.remove_crop_box(index=1)
    assert bpy.ops.fastgs.remove_crop_box(index=0) == {'FINISHED'}
    assert not obj.fastgs.crops and box.name in scene.objects and len(seen()) == 10
    assert not bpy.ops.fastgs.remove_crop_box.poll() and not bpy.ops.fastgs.delete_for_good.poll()


def test_delete_for_good_writes_what_is_left(obj, fg, seen, scene, tmp_path):
    """The Gaussians that are in the box on any frame become a file of their own; the one of before is as it was."""
    scene.render.film_transparent = True
    before = Path(obj.fastgs.filepath).read_bytes()
    add_box(obj, 0.82, 2.0)  # reached by those that begin to the right of -0.1, in the last frame at the latest
    target = tmp_path / "left.safetensors"
    with pytest.raises(RuntimeError, match="another name"):
        bpy.ops.fastgs.delete_for_good(filepath=obj.fastgs.filepath)
    assert bpy.ops.fastgs.delete_for_good(filepath=str(target)) == {'FINISHED'}
    assert [round(float(x), 1) for x in fg.load(target).position[:, 0]] == row_between(-0.11, 1)
    assert obj.fastgs.filepath == str(target) and obj.fastgs.gaussian_count == 6 and not obj.fastgs.crops
    assert seen() == row_between(-0.11, 1)
    assert (tmp_path / "model.safetensors").read_bytes() == before


def test_it_refuses_to_write_nothing(obj, tmp_path):
    add_box(obj, 5.0, 6.0)
    with pytest.raises(RuntimeError, match="shows nothing"):
        bpy.ops.fastgs.delete_for_good(filepath=str(tmp_path / "left.safetensors"))
    assert not (tmp_path / "left.safetensors").exists() and len(obj.fastgs.crops) == 1


def test_boxes_are_stored_and_copied_with_the_object(obj, tmp_path):
    box = add_box(obj, -0.6, 0.2, 'REMOVE')
    copy = obj.copy()
    assert copy.fastgs.crops[0].object == box
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    item = next(o for o in bpy.data.objects if o.fastgs.crops).fastgs.crops[0]
    assert item.object.name == "Box" and item.mode == 'REMOVE' and item.use


def test_spheres_meshes_and_soft_edges(obj, seen, scene, render):
    """An ellipsoid within the bounds, and the inside of a mesh as its modifiers and its animation make it."""
    scene.render.film_transparent = True
    obj.select_set(True)
    bpy.ops.fastgs.add_crop_box(shape='SPHERE')
    ball = obj.fastgs.crops[0].object
    ball.parent, ball.location, ball.scale = None, (0.0, 0.0, 0.0), (0.55, 0.55, 0.55)
    assert ball.empty_display_type == 'SPHERE' and seen() == row_between(-0.55, 0.55)
    ball.location.z = 0.5  # the row runs near the ball's border
    assert seen() == row_between(-0.2, 0.2)
    obj.fastgs.crops.clear()
    mesh = bpy.data.meshes.new("Hollow")
    mesh.from_pydata([(x, y, z) for x in (-0.65, 0.65) for y in (-1, 1) for z in (-1, 1)], [],
                     [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    block = bpy.data.objects.new("Block", mesh)
    scene.collection.objects.link(block)
    for other in (block, obj):
        other.select_set(True)
    bpy.context.view_layer.objects.active = obj
    bpy.ops.fastgs.add_crop_box(shape='MESH')
    item = obj.fastgs.crops[0]
    assert (item.object, item.shape) == (block, 'MESH') and seen() == row_between(-0.65, 0.65)
    array = block.modifiers.new("Array", 'ARRAY')
    array.relative_offset_displace[0] = 1.4  # a second block, beside a gap
    block.location.x = -0.9
    assert seen() == [-0.9, -0.7, -0.5, -0.3, 0.3, 0.5, 0.7, 0.9]
    block.modifiers.clear()
    block.location.x = 0.0
    item.soft = 1.0
    alpha = render()["ViewLayer.Combined"][..., 3].max(0)
    place = [alpha[round((x + 2) / 4 * 64 - 0.5)] for x in (0.1, 0.3, 0.5)]
    assert place[0] > place[1] + 0.1 > place[2] + 0.2
    block.select_set(False)
    with pytest.raises(RuntimeError, match="mesh.*selected"):
        bpy.ops.fastgs.add_crop_box(shape='MESH')


def test_filters_and_what_they_select(obj, seen, scene):
    scene.render.film_transparent = True
    for preset in ('FLOATERS', 'LARGE', 'FAINT', 'MOVING', 'STATIC', 'SHORT', 'COLOUR'):
        assert bpy.ops.fastgs.add_filter(preset=preset) == {'FINISHED'}
        assert obj.fastgs.filters[-1].low < obj.fastgs.filters[-1].high
        bpy.ops.fastgs.remove_filter(index=0)
    bpy.ops.fastgs.add_filter(preset='STATIC')
    assert seen() == []  # all of the row moves
    item = obj.fastgs.filters[0]
    item.kind, item.low, item.high, item.mode = 'COLOUR', 0.0, 0.5, 'HIDE'
    item.colour = (0.8, 0.8, 0.8)
    assert seen() == []
    assert bpy.ops.fastgs.select_filtered(index=0) == {'FINISHED'}
    assert not item.use and obj.fastgs.selection and len(seen()) == 10
    with pytest.raises(RuntimeError, match="no number 7"):
        bpy.ops.fastgs.select_filtered(index=7)


def test_a_lost_box_crops_nothing(obj, seen, scene):
    scene.render.film_transparent = True
    bpy.data.objects.remove(add_box(obj, -0.6, 0.2))
    assert len(seen()) == 10

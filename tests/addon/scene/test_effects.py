# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects: node groups that change a splat object's Gaussians, from the menu and from the asset library."""
from __future__ import annotations

import bpy
import numpy as np
import pytest

EFFECTS = ("DISSOLVE", "WIND", "SCATTER", "SWEEP", "FREEZE")
NOTHING = {"DISSOLVE": "Amount", "WIND": "Strength", "SCATTER": "Amount", "SWEEP": "Amount", "FREEZE": "Amount"}
"""The input of each effect that, at 0, lets everything be."""


@pytest.fixture
def obj(fg, make_model, model_file):
    rng = np.random.default_rng(3)
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(
        300, seed=1, axes="RFU", basis=fg.Polynomial(1), motion=rng.normal(size=(300, 1, 3)), clip=fg.Clip(20, 24))))
    return bpy.context.object


def shown(module):
    """(the instance that is rendered, the state of its model, that of its origin)."""
    bpy.context.view_layer.update()
    instance = module("scene.snapshot").take(bpy.context.evaluated_depsgraph_get()).load()[0][0]
    state_of, t = module("fastgs_blender.model.edits").state_of, (bpy.context.scene.frame_current - 1) / 20
    return instance, state_of(instance.model, instance.t), state_of(instance.source, t)


@pytest.mark.parametrize("effect", EFFECTS)
def test_an_effect_is_a_modifier_that_changes_what_is_shown(module, obj, scene, effect):
    scene.frame_set(9)
    assert bpy.ops.fastgs.add_effect(effect=effect) == {'FINISHED'}
    modifier = obj.modifiers.active
    assert obj.fastgs.points == 'ALL' and list(obj.modifiers)[-1].node_group.name.startswith("FAST-GS Proxy")
    instance, after, before = shown(module)
    assert instance.origin is not None
    changes = {name: np.abs(getattr(after, name) - getattr(before, name)).reshape(300, -1).max(1)
               for name in ("position", "opacity", "scale", "colour")}
    assert {name for name, change in changes.items() if change.max() > 0.01} == {
        "DISSOLVE": {"position", "opacity"}, "WIND": {"position"}, "SCATTER": {"position", "scale"}, "SWEEP": {"opacity", "colour"},
        "FREEZE": {"position"}}[effect]
    for item in modifier.node_group.interface.items_tree:
        assert item.description or item.name == "Geometry"
    module("scene.splats.effects").set_input(modifier, NOTHING[effect], 0.0)
    assert shown(module)[0].origin is None
    bpy.ops.fastgs.add_effect(effect=effect)
    assert obj.modifiers.active.node_group == modifier.node_group  # one group for all


def test_amounts_go_from_all_to_nothing(module, obj):
    for effect in ("DISSOLVE", "SWEEP"):
        bpy.ops.fastgs.add_effect(effect=effect)
        modifier, left = obj.modifiers.active, []
        for amount in (0.25, 0.5, 0.75, 1.0):
            module("scene.splats.effects").set_input(modifier, "Amount", amount)
            _, after, before = shown(module)
            left.append((after.opacity / before.opacity).mean())
        assert 0.9 > left[1] > 0.1 and left == sorted(left, reverse=True) and left[3] < 1e-4
        obj.modifiers.remove(modifier)


def test_what_is_far_stands_still(module, obj, scene):
    """Around an empty everything moves; far from it Gaussians stand as on the still frame, on every frame."""
    obj.fastgs.still_frame = 4.0
    centre = bpy.data.objects.new("Centre", None)
    scene.collection.objects.link(centre)
    centre.location = (0.5, 0, 0)
    bpy.ops.fastgs.add_effect(effect='FREEZE')
    modifier = obj.modifiers.active
    for name, value in (("Centre", centre), ("Distance", 0.6), ("Width", 0.2)):
        module("scene.splats.effects").set_input(modifier, name, value)
    for frame in (3, 15):
        scene.frame_set(frame)
        instance, after, before = shown(module)
        rest = module("fastgs_blender.model.edits").state_of(instance.source, 4 / 20)
        away = np.linalg.norm(rest.position - [0.5, 0, 0], axis=1)
        near, far = away < 0.6, away > 0.8
        assert near.sum() > 5 and far.sum() > 50
        assert np.allclose(after.position[near], before.position[near], atol=1e-5)
        assert np.allclose(after.position[far], rest.position[far], atol=1e-5)


def test_the_library_holds_the_effects_as_assets(module, obj, tmp_path):
    assets, effects = module("scene.splats.effect_assets"), module("scene.splats.effects")
    own = effects.group('WIND')  # the open file has one, which stays what it is
    trees = sorted(tree.name for tree in bpy.data.node_groups)
    assets.write(tmp_path / "effects.blend")
    assert sorted(tree.name for tree in bpy.data.node_groups) == trees and effects.group('WIND') == own
    with bpy.data.libraries.load(str(tmp_path / "effects.blend"), assets_only=True) as (there, here):
        assert sorted(there.node_groups) == sorted(effect.name for effect in effects.EFFECTS.values())
        here.node_groups = ["Splat Scatter"]
    tree = here.node_groups[0]
    assert tree.asset_data.description and tree.asset_data.catalog_id in (tmp_path / "blender_assets.cats.txt").read_text()
    obj.fastgs.points = 'ALL'
    obj.modifiers.new("From the Library", 'NODES').node_group = tree
    assert shown(module)[0].origin is not None


def test_the_library_is_listed_while_the_extension_is_enabled(module):
    assets, libraries = module("scene.splats.effect_assets"), bpy.context.preferences.filepaths.asset_libraries
    before = len(libraries)
    assets.ensure()
    assets.ensure()
    assert len(libraries) == before + 1 and assets.file().exists() and libraries[-1].name == "FAST-GS"
    assets.unregister()
    assert len(libraries) == before


def test_effects_need_splats(scene, add):
    add("cube")
    assert not bpy.ops.fastgs.add_effect.poll()

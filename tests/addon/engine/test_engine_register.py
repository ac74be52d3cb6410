# SPDX-License-Identifier: GPL-3.0-or-later
"""Registration of the engine: the engine itself, its properties, and its place in Blender's own panels."""
import subprocess
import sys

import bpy
import pytest
from held_runs import GUARD


def test_the_engine_can_be_chosen_and_is_what_it_says(scene):
    assert scene.render.engine == 'FASTGS'
    engine = next(cls for cls in bpy.types.RenderEngine.__subclasses__() if getattr(cls, "bl_idname", "") == "FASTGS")
    assert engine.bl_use_postprocess and engine.bl_use_eevee_viewport
    assert not (engine.bl_use_gpu_context or engine.bl_use_preview or engine.bl_use_shading_nodes_custom)


@pytest.mark.parametrize("group", ["FASTGS_PG_object", "FASTGS_PG_scene", "FASTGS_PG_view_layer"])
def test_properties_follow_blenders_rules(module, group):
    """A name, a description without a dot at the end, and fixed numbers, so that old files keep their meaning."""
    cls = getattr(module("scene.properties"), group)
    own = [p for p in cls.bl_rna.properties if p.identifier in cls.__annotations__]
    assert own
    for p in own:
        assert p.name and p.description and not p.description.endswith(".")
        if p.type == 'ENUM':
            numbers = [item[3] for item in cls.__annotations__[p.identifier].keywords["items"]]
            assert numbers == list(range(len(numbers)))
            assert [item.value for item in p.enum_items] == numbers


def test_times_settings_can_be_keyframed(scene, splat_object):
    obj = splat_object("//x.ply")
    for name in ("start_frame", "speed", "offset", "before", "after"):
        assert obj.fastgs.keyframe_insert(name, frame=1)


@pytest.mark.parametrize(("panel", "shown"), [
    ("RENDER_PT_color_management", True), ("RENDER_PT_format", True), ("DATA_PT_lens", True), ("DATA_PT_camera", True),
    ("EEVEE_WORLD_PT_surface", True), ("OBJECT_PT_visibility", True), ("VIEWLAYER_PT_layer", True),
    ("RENDER_PT_freestyle", False), ("VIEWLAYER_PT_filter", False), ("DATA_PT_camera_dof", False),
])
def test_blenders_panels(scene, panel, shown):
    assert ('FASTGS' in getattr(bpy.types, panel).COMPAT_ENGINES) == shown


def test_a_script_with_the_engine_ends_in_peace(addon):
    """Nothing is unregistered by hand: in some versions of the bpy module a registered engine crashes or hangs the exit."""
    code = f"import bpy, addon_utils; assert addon_utils.enable({addon.__name__!r}); bpy.context.scene.render.engine = 'FASTGS'"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=GUARD, capture_output=True)

# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels: their texts, when they are shown, and that all properties and operators that they draw exist."""
import os
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from panel_recorder import Layout, text_width
from panel_widths import REGIONS, WIDTHS


def drawn(cls, **context):
    """What a panel or an operator's options draw in a context."""
    space = next(area.spaces.active for screen in bpy.data.screens for area in screen.areas if area.type == 'VIEW_3D')
    defaults = dict(space_data=space, object=bpy.context.object, scene=bpy.context.scene, mode='OBJECT',
                    selected_objects=bpy.context.selected_objects, view_layer=bpy.context.view_layer,
                    region=SimpleNamespace(width=REGIONS[cls.bl_region_type]), preferences=bpy.context.preferences,
                    window_manager=bpy.context.window_manager,
                    engine=bpy.context.scene.render.engine, screen=bpy.context.window_manager.windows[0].screen)
    layout = Layout()
    cls.draw(SimpleNamespace(layout=layout), SimpleNamespace(**(defaults | context)))
    assert not layout.cut(WIDTHS[cls.bl_region_type]), cls
    return layout.record


def texts(record, kind="label"):
    return [text for what, text, _ in record if what == kind]


@pytest.fixture
def panels(module):
    return {cls.__name__: cls for cls in module("ui").CLASSES if issubclass(cls, bpy.types.Panel)}


@pytest.fixture
def obj(fg, make_model, model_file):
    """An imported object: 1234 Gaussians, 48 frames at 29.97 frames a second."""
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(1234, clip=fg.Clip(48, 29.97))))
    return bpy.context.object


def test_every_panel_draws(panels, obj):
    for name, cls in panels.items():
        assert drawn(cls), name


def test_no_text_is_cut_whatever_is_set(panels, obj, scene):
    """drawn() asks whether all texts fit."""
    settings, training = obj.fastgs, scene.fastgs.training
    bpy.ops.fastgs.add_crop_box()
    for preset in ('COLOUR', 'LARGE', 'FLOATERS'):
        bpy.context.view_layer.objects.active = obj
        assert bpy.ops.fastgs.add_filter(preset=preset) == {'FINISHED'}
    settings.mask, settings.echoes, settings.after, settings.points, settings.has_backdrop = "1234 x", 3, 'LOOP', 'ALL', True
    settings.camera_count, settings.use_capture_frame = 12, True
    scene.view_settings.view_transform = 'AgX'
    bpy.ops.mesh.primitive_cube_add()
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", 'SUN'))
    scene.collection.objects.link(sun)
    sun.fastgs.splat_shadow = True
    for engine in ('FASTGS', 'CYCLES'):
        for source in ('FOLDER', 'CAMERAS', 'SCENE'):
            training.source, training.cameras = source, 'DOME'
            for cls in panels.values():
                drawn(cls, object=obj, engine=engine)


def test_there_is_one_panel_of_that_name(panels):
    """And its sub-panels, which lie in the object's properties as it does."""
    assert [name for name, cls in panels.items() if "4D Gaussians" in cls.bl_label] == ["FASTGS_PT_object"]
    inside = {"FASTGS_PT_object"}
    for name, cls in panels.items():  # a parent is registered before its children
        if getattr(cls, "bl_parent_id", "") in inside:
            inside.add(name)
            assert cls.bl_context == "object" and cls.bl_space_type == 'PROPERTIES'
    assert {"FASTGS_PT_object_time", "FASTGS_PT_object_sound", "FASTGS_PT_object_engines", "FASTGS_PT_object_cut"} < inside


def test_time_opens_with_four_settings(panels, obj):
    """All others lie in sub-panels that are closed at first."""
    assert texts(drawn(panels["FASTGS_PT_object_time"]), "prop") == ["start_frame", "speed", "before", "after"]
    rest = [cls for cls in panels.values() if getattr(cls, "bl_parent_id", "") == "FASTGS_PT_object_time"]
    assert rest and all('DEFAULT_CLOSED' in cls.bl_options for cls in rest)
    found = {text for cls in rest for text in texts(drawn(cls), "prop")}
    assert {"trim_start", "trim_end", "offset", "fade", "capture_frame", "echoes", "echo_spacing", "echo_fade"} == found


def test_a_still_has_a_native_copy_and_no_time(panels, make_model, model_file):
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(20), "still.safetensors"))
    here = SimpleNamespace(object=bpy.context.object)
    assert panels["FASTGS_PT_object_engines"].poll(here) and not panels["FASTGS_PT_object_sound"].poll(here)
    assert texts(drawn(panels["FASTGS_PT_object_engines"]), "operator") == ["fastgs.make_mesh", "fastgs.native_copy"]


def test_the_size_stands_beside_the_scale(panels, module, scene, fg, model_file):
    """In the scene's unit of length, however the object is scaled: in Blender's Transform, in our panel, and beside Set Scale."""
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 6)] * 3), -1).reshape(-1, 3)
    model = fg.GaussianModel(position=grid * (1.0, 0.5, 2.0), rotation=np.tile([1.0, 0, 0, 0], (216, 1)), scale=np.full((216, 3), -9.0),
                             opacity=np.full(216, 4.0), features=np.full((216, 3), 0.5), axes="RFU")
    bpy.ops.import_scene.fastgs(filepath=model_file(model, "grid.safetensors"))
    obj, size = bpy.context.object, module("scene.cameras.subjects").size_of
    np.testing.assert_allclose(size(obj), (2, 1, 4), rtol=0.05)
    obj.scale, obj.rotation_euler = (3, 3, 3), (0.3, 0.2, 1.0)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(size(obj), (6, 3, 12), rtol=0.05)
    layout = Layout()
    module("ui.object_panels").draw_size(SimpleNamespace(layout=layout), bpy.context)
    labels, sides = texts(layout.record)[::2], texts(layout.record)[1::2]
    assert labels == ["Size X", "Y", "Z"] and all(side.endswith(" m") for side in sides)
    assert [float(side.split()[0]) for side in sides] == pytest.approx([6, 3, 12], rel=0.05)
    assert not layout.cut(168), "even in a window that is 1280 pixels wide"
    for name in ("FASTGS_PT_object", "FASTGS_PT_capture"):
        assert " x ".join(sides) in texts(drawn(panels[name]))
    scene.unit_settings.scale_length = 0.01
    layout = Layout()
    module("ui.object_panels").draw_size(SimpleNamespace(layout=layout), bpy.context)
    assert all(side.endswith(" cm") for side in texts(layout.record)[1::2])
    assert tuple(size(bpy.data.objects.new("Empty", None))) == (0, 0, 0)


def test_panels_draw_in_edit_mode(panels, module, obj):
    """Blender keeps the points' attributes elsewhere then."""
    bpy.ops.object.mode_set(mode='EDIT')
    layout = Layout()
    module("ui.object_panels").draw_size(SimpleNamespace(layout=layout), bpy.context)
    assert not texts(layout.record)
    for cls in panels.values():
        drawn(cls)
    assert module("scene.cameras.subjects").middle_and_radius([obj])[1] > 0


def test_a_speed_of_the_moment_is_called_so(panels, obj):
    """A driver that needs Python is not integrated; one of the frame is."""
    driver = obj.driver_add("fastgs.speed").driver
    driver.expression = "frame / 10"
    assert not any("driver" in text for text in texts(drawn(panels["FASTGS_PT_object_time"])))
    driver.expression = "__import__('os').getpid()"
    assert any("driver" in text for text in texts(drawn(panels["FASTGS_PT_object_time"])))


def test_entries_of_menus_are_short_and_where_an_artist_looks(module):
    menus, found = module("ui.menus"), {}
    for menu, draw in menus.MENUS:
        if draw is menus.draw_size:
            continue
        layout = Layout()
        draw(SimpleNamespace(layout=layout), bpy.context)
        found.setdefault(menu.__name__, []).extend(texts(layout.record, "operator"))
        assert not layout.cut(250), "Blender's own longest entry there takes 210 pixels"
    for name in ("VIEW3D_MT_camera_add", "VIEW3D_MT_view_cameras", "VIEW3D_MT_view_align", "VIEW3D_MT_object_context_menu"):
        assert "fastgs.camera_from_view" in found[name]
    assert "fastgs.add_sound" in found["SEQUENCER_MT_add"]


def test_headings_of_panels_fit(panels):
    for name, cls in panels.items():
        assert text_width(cls.bl_label) + 40 < WIDTHS[cls.bl_region_type], name


def test_facts(panels, obj):
    record = drawn(panels["FASTGS_PT_object"])
    assert "1,234" in texts(record)
    assert "48 at 29.97 fps (1.60 s)" in texts(record)
    assert any(text.endswith("KiB") for text in texts(record))
    assert not any(alert for _, _, alert in record)


def test_missing_file_is_red_and_can_be_reloaded(panels, obj):
    obj.fastgs.filepath = "/nowhere/lost.ply"
    for name in ("FASTGS_PT_object", "FASTGS_PT_splats"):
        record = drawn(panels[name])
        assert (("prop", "filepath", True) in record) is (name == "FASTGS_PT_object")
        red = " ".join(text for kind, text, alert in record if alert and kind == "label")
        assert os.path.abspath("/nowhere/lost.ply") in red and "no such file" in red
        assert max(len(text) for text in texts(record)) <= 40
        assert texts(record, "operator").count("fastgs.reload") == 1 + (name == "FASTGS_PT_object")


def test_broken_file_is_red_once_it_was_tried(panels, obj, tmp_path):
    broken = tmp_path / "broken.ply"
    broken.write_bytes(b"ply\nformat ascii 1.0\nelement vertex 5\n")
    obj.fastgs.filepath = str(broken)
    with pytest.raises(RuntimeError):
        bpy.ops.fastgs.reload()
    record = drawn(panels["FASTGS_PT_object"])
    assert "broken.ply" in "".join(text for kind, text, alert in record if alert and kind == "label")


def test_crop_boxes_are_listed(panels, obj):
    assert texts(drawn(panels["FASTGS_PT_parts_crop"]), "operator") == ["fastgs.add_crop_box"]
    bpy.ops.fastgs.add_crop_box()
    record = drawn(panels["FASTGS_PT_parts_crop"])
    assert texts(record, "prop") == ["use", "object", "shape", "mode", "soft"]
    assert texts(record, "operator") == ["fastgs.remove_crop_box", "fastgs.add_crop_box"]


def test_threads_say_what_they_mean(panels, module, scene, monkeypatch):
    settings, available = module("scene.settings"), module("fastgs_blender.util.threads").available()
    everything = f"{available} (all)"
    for mode, chosen, wanted in (('AUTO', 0, everything), ('AUTO', 3, "3 (preferences)"), ('FIXED', 3, None)):
        scene.render.threads_mode = mode
        monkeypatch.setattr(settings, "threads", chosen)
        record = drawn(panels["FASTGS_PT_render"])
        assert ("threads" in texts(record, "prop")) is (wanted is None)
        assert wanted is None or wanted in texts(record)


def test_preferences_have_headings_and_say_what_zero_threads_are(module):
    layout, preferences = Layout(), module("scene.settings").preferences()
    kind, before = module("ui.preferences").FASTGS_AP_preferences, preferences.threads
    names = list(kind.__annotations__)
    try:
        for threads in (0, 2):
            preferences.threads, layout = threads, Layout()
            shown = SimpleNamespace(layout=layout, bl_rna=preferences.bl_rna, **{name: getattr(preferences, name) for name in names})
            kind.draw(shown, SimpleNamespace(region=SimpleNamespace(width=300), preferences=bpy.context.preferences))
            labels = texts(layout.record)
            assert [text for text in labels if text in ("Rendering", "Training", "Help")] == ["Rendering", "Training", "Help"]
            assert any("on this machine" in text for text in labels) is (threads == 0)
    finally:
        preferences.threads = before


def test_viewports_that_cannot_show_splats_say_so(panels, obj, module, monkeypatch):
    assert not texts(drawn(panels["FASTGS_PT_viewport"]))[2:]
    viewports = module("engine.viewport.spaces").viewports
    monkeypatch.setattr(viewports, "trouble", lambda: "the models do not fit into the GPU's textures: too bad.")
    assert "do not fit" in " ".join(texts(drawn(panels["FASTGS_PT_viewport"])))


def test_button_for_the_engine_only_where_another_is_used(panels, obj, scene):
    assert "wm.context_set_enum" not in texts(drawn(panels["FASTGS_PT_object"], engine='FASTGS'), "operator")
    assert "wm.context_set_enum" in texts(drawn(panels["FASTGS_PT_object"], engine='CYCLES'), "operator")


@pytest.mark.parametrize("panel", ["FASTGS_PT_render", "FASTGS_PT_viewport"])
def test_meshes_that_are_not_rendered_are_told_beside_the_button(panels, obj, scene, panel):
    assert "render_meshes" not in texts(drawn(panels[panel]), "prop_menu_enum")
    bpy.ops.mesh.primitive_cube_add()
    bpy.context.object.name = "Chair"
    record = drawn(panels[panel])
    assert "Chair" in " ".join(texts(record)) and "render_meshes" in texts(record, "prop_menu_enum")
    scene.fastgs.render_meshes = 'CYCLES'
    assert "Chair" not in " ".join(texts(drawn(panels[panel])))


def test_what_only_final_renders_show_is_told(panels, obj, scene):
    assert "only" not in " ".join(texts(drawn(panels["FASTGS_PT_viewport"])))
    scene.render.use_motion_blur = True
    assert "Motion Blur" in " ".join(texts(drawn(panels["FASTGS_PT_viewport"])))


def test_polls(panels, obj, scene):
    def polls(name, **context):
        return panels[name].poll(SimpleNamespace(**(dict(object=obj, engine='CYCLES') | context)))

    empty = bpy.data.objects.new("Empty", None)
    for name in ("object", "object_time", "object_trim"):
        assert polls(f"FASTGS_PT_{name}")
        assert not polls(f"FASTGS_PT_{name}", object=None) and not polls(f"FASTGS_PT_{name}", object=empty)
    assert polls("FASTGS_PT_object_engines")
    for name in ("render", "film", "passes"):
        assert polls(f"FASTGS_PT_{name}", engine='FASTGS') and not polls(f"FASTGS_PT_{name}")
    obj.fastgs.filepath = ""
    assert polls("FASTGS_PT_object"), "where else could the path be put back?"


def test_objects_made_without_the_importer(panels, splat_object, scene):
    made = splat_object("/nowhere/x.ply")
    for name in ("FASTGS_PT_object", "FASTGS_PT_object_time"):
        assert drawn(panels[name], object=made)
    obj = bpy.data.objects.new("Empty", None)
    wanted = ["import_scene.fastgs", "fastgs.import_example", "fastgs.bake"]
    assert texts(drawn(panels["FASTGS_PT_splats"], object=obj), "operator") == wanted


def test_frame_that_is_shown(module, obj, scene):
    shown = module("ui.facts").shown_now
    scene.render.fps, scene.render.fps_base = 30, 30 / 29.97
    obj.fastgs.start_frame, obj.fastgs.before = 1, 'HIDE'
    scene.frame_set(11, subframe=0.25)
    assert shown(obj, scene) == "Frame 10.25 (of 0 to 47)"
    scene.frame_set(1)
    assert shown(obj, scene) == "Frame 0 (of 0 to 47)"
    scene.frame_set(-5)
    assert shown(obj, scene) == "Nothing"
    scene.frame_set(48)
    assert shown(obj, scene) == "Frame 47 (of 0 to 47)"


def test_numbers_in_words(module):
    facts = module("ui.facts")
    assert [facts.size(n) for n in (0, 1023, 1024, 1536, 5 * 2**20, 3 * 2**30, 2**43)] == [
        "0 B", "1023 B", "1.0 KiB", "1.5 KiB", "5.0 MiB", "3.0 GiB", "8192.0 GiB"]
    assert [facts.number(x) for x in (0, 10, 29.97, 23.976, 2.5, 100)] == ["0", "10", "29.97", "23.98", "2.5", "100"]


def test_scene_summary(module, obj, scene, make_model, model_file):
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(66), "second.safetensors"))
    rows = dict(module("ui.facts").scene_facts(scene))
    assert (rows["Objects"], rows["Gaussians"]) == ("2", "1,300")


def test_import_options_draw(module):
    operator = module("operators.import_model").FASTGS_OT_import
    names, labels = [], []
    layout = SimpleNamespace(prop=lambda data, name, text=None: names.append(name))
    layout.column = lambda heading="", align=False: layout
    layout.panel = lambda name, default_closed: (layout, layout)
    layout.label = lambda text, translate=True: labels.append(text)
    operator.draw(SimpleNamespace(layout=layout, paths=list), bpy.context)
    assert set(names) <= set(bpy.ops.import_scene.fastgs.get_rna_type().properties.keys())
    assert {"relative_path", "as_sequence", "level", "orientation", "proxy_points", "view", "set_scene_range", "use_engine",
            "camera"} == set(names)
    assert labels[1:] == [f"{known.name} ({', '.join(known.reads)})" for known in module("fastgs_blender.formats").FORMATS]


def test_the_manual_of_every_operator_and_property_is_a_page_that_is_there(module):
    from urllib.parse import urlparse
    from urllib.request import url2pathname

    from bl_operators.wm import WM_OT_doc_view_manual as manual

    names = [f"bpy.ops.{cls.bl_idname}" for cls in module("operators").CLASSES if issubclass(cls, bpy.types.Operator)]
    names += ["bpy.types.FASTGS_PG_object.start_frame", "bpy.types.FASTGS_PG_training.capture"]
    pages = {name: Path(url2pathname(urlparse(manual._lookup_rna_url(name, verbose=False)).path)) for name in names}
    assert all(page.is_file() for page in pages.values())
    assert (pages["bpy.ops.fastgs.bake"].name, pages["bpy.ops.fastgs.train"].name) == ("baking.md", "training-in-blender.md")


def test_the_toolbar_selects_and_erases(module, obj, scene):
    """The left button, with Shift and with Ctrl; the tools' header says what to do; keys as in Edit Mode, and those of the size."""
    tools, keymaps = module("ui.tools"), bpy.context.window_manager.keyconfigs.addon.keymaps
    shapes = ['CLICK', 'BOX', 'LASSO', 'CIRCLE', 'BALL', 'CIRCLE', 'LASSO', 'BOX']
    for number, (tool, shape) in enumerate(zip(tools.TOOLS, shapes, strict=True)):
        erases = number > 4
        items = keymaps[tool._bl_tool.keymap[0]].keymap_items
        strokes = [item for item in items if item.idname == "fastgs.select_gaussians"]
        assert [(item.type, item.value, item.shift, item.ctrl) for item in strokes] == [
            ('LEFTMOUSE', 'PRESS', shift, ctrl) for shift, ctrl in ((False, False), (True, False), (False, True))]
        assert [(item.properties.what, item.properties.mode) for item in strokes] == (
            [('ERASE', 'SET'), ('RESTORE', 'SET'), ('RESTORE', 'SET')] if erases else
            [('SELECT', 'SET'), ('SELECT', 'ADD'), ('SELECT', 'SUBTRACT')])
        assert {item.properties.shape for item in strokes} == {shape}
        layout = Layout(kind="row")
        tool.draw_settings(bpy.context, layout, SimpleNamespace(idname=tool.bl_idname))
        assert ("brush_radius" in texts(layout.record, "prop")) is (shape in {'CIRCLE', 'BALL'})
        assert ("select_through" in texts(layout.record, "prop")) is (not erases and shape != 'CLICK')
        layout = Layout(kind="row")
        tool.draw_settings(SimpleNamespace(object=None), layout, SimpleNamespace(idname=tool.bl_idname))
        assert "Select" in texts(layout.record)[0]
        assert {item.idname for item in items} >= {"fastgs.separate", "fastgs.erase", "fastgs.show_hidden", "fastgs.join_parts"}
    sizes = {item.type: item for item in keymaps[tools.ERASING[0]._bl_tool.keymap[0]].keymap_items if item.idname.startswith("wm.")}
    scene.fastgs.brush_radius = 40
    assert sizes['F'].properties.data_path_primary == "scene.fastgs.brush_radius"
    for key, radius in (('RIGHT_BRACKET', 46), ('LEFT_BRACKET', 40)):
        props = sizes[key].properties
        bpy.ops.wm.context_scale_float(data_path=props.data_path, value=props.value)
        assert scene.fastgs.brush_radius == pytest.approx(radius, abs=0.1)


def test_the_sidebar_shows_the_objects_panel(panels, obj):
    """The button sets the tab of a properties editor of the window; without one it says where to look."""
    screen = bpy.context.window_manager.windows[0].screen
    number = next(i for i, area in enumerate(screen.areas) if area.type == 'PROPERTIES')
    made = []

    class Noting(Layout):
        def operator(self, name, text=None, icon='NONE'):
            super().operator(name, text, icon)
            made.append(SimpleNamespace(name=name))
            return made[-1]

        def _inside(self, kind, options):
            return self

        def __init__(self):
            super().__init__()

    context = SimpleNamespace(object=obj, screen=screen, engine='FASTGS', scene=bpy.context.scene, region=SimpleNamespace(width=280))
    panels["FASTGS_PT_splats"].draw(SimpleNamespace(layout=Noting()), context)
    button = next(props for props in made if hasattr(props, "data_path"))
    screen.areas[number].spaces.active.context = 'SCENE'
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0], screen=screen):
        bpy.ops.wm.context_set_enum(data_path=button.data_path, value=button.value)
    assert screen.areas[number].spaces.active.context == 'OBJECT'
    record = drawn(panels["FASTGS_PT_splats"], screen=SimpleNamespace(areas=[]))
    assert any("Object Properties" in text for text in texts(record))


def test_passes_of_meshes_are_switched_on_where_the_splats_are(panels, obj, scene, module):
    panel = panels["FASTGS_PT_mesh_passes"]
    assert not panel.poll(bpy.context)
    for engine in ('EEVEE', 'CYCLES'):
        scene.fastgs.render_meshes = engine
        assert panel.poll(bpy.context) and "write_passes" in texts(drawn(panel), "prop")
        assert ("use_pass_diffuse_indirect" in texts(drawn(panel), "prop")) == (engine == 'CYCLES')

# SPDX-License-Identifier: GPL-3.0-or-later
"""Registering and unregistering the extension twenty times leaves Blender as it was."""
import bpy
import pytest
from bl_ui.space_toolsystem_common import ToolSelectPanelHelper


def traces():
    """Everything that an add-on can leave behind, as plain values that can be compared."""
    menus = [cls for base in (bpy.types.Menu, bpy.types.Header, bpy.types.Panel) for cls in base.__subclasses__()]
    keyconfigs = bpy.context.window_manager.keyconfigs
    toolbar = ToolSelectPanelHelper._tool_class_from_space_type('VIEW_3D')
    return {
        "types": set(dir(bpy.types)),
        "operators": {f"{module}.{name}" for module in dir(bpy.ops) for name in dir(getattr(bpy.ops, module))},
        "properties": {(owner.__name__, name) for owner in (
            bpy.types.Object, bpy.types.Scene, bpy.types.ViewLayer, bpy.types.Camera, bpy.types.Mesh, bpy.types.WindowManager,
            bpy.types.World, bpy.types.Collection) for name in owner.bl_rna.properties.keys()},  # noqa: SIM118
        "drawn": {cls.__name__: [f.__qualname__ for f in getattr(cls.draw, "_draw_funcs", ())] for cls in menus if hasattr(cls, "draw")
                  and "FASTGS" not in cls.__name__},
        "engines": {cls.__name__: sorted(cls.COMPAT_ENGINES) for cls in bpy.types.Panel.__subclasses__()
                    if hasattr(cls, "COMPAT_ENGINES") and "FASTGS" not in cls.__name__},
        "handlers": {name: [getattr(f, "__qualname__", str(f)) for f in getattr(bpy.app.handlers, name)]
                     for name in dir(bpy.app.handlers) if isinstance(getattr(bpy.app.handlers, name), list)},
        "tools": {tool.idname for tool in ToolSelectPanelHelper._tools_flatten(toolbar._tools['OBJECT']) if hasattr(tool, "idname")},
        "keymaps": {(config.name, keymap.name): len(keymap.keymap_items) for config in keyconfigs for keymap in config.keymaps},
    }


@pytest.fixture
def absent(addon):
    """The extension switched off for the time of a test."""
    addon.unregister()
    yield addon
    if not hasattr(bpy.types.Object, "fastgs"):
        addon.register()


def test_many_times_leave_nothing(absent):
    nothing = traces()
    everything = None
    for _ in range(6):
        absent.register()
        here = traces()
        assert everything in (None, here)
        everything = here
        absent.unregister()
        assert traces() == nothing


def test_it_is_all_ours(absent):
    """What the extension adds bears its name, and it takes nothing away."""
    before = traces()
    absent.register()
    after = traces()
    for key in ("types", "operators", "properties", "tools"):
        assert before[key] < after[key]
        assert all("fastgs" in str(name).lower() for name in after[key] - before[key])
    absent.unregister()
    assert "FASTGS" not in str(traces()["engines"])


def test_the_snapshot_sees_what_is_left(absent):
    """Each kind of trace is one that the comparison finds."""
    before = traces()
    absent.register()
    changed = {key for key, value in traces().items() if value != before[key]}
    absent.unregister()
    assert changed == {"types", "operators", "properties", "drawn", "engines", "handlers", "keymaps", "tools"}


def test_names_follow_blenders_rules(addon, module):
    for package in ("operators", "ui"):
        for cls in module(package).CLASSES:
            assert cls.__name__.startswith("FASTGS_"), cls
            if issubclass(cls, bpy.types.Panel):
                assert getattr(cls, "bl_idname", cls.__name__) == cls.__name__ and "_PT_" in cls.__name__
            if issubclass(cls, bpy.types.Operator):
                assert "_OT_" in cls.__name__ and cls.bl_idname.endswith((".fastgs", cls.__name__.split("_OT_")[1]))
                assert cls.__doc__ and not cls.__doc__.strip().endswith(".")

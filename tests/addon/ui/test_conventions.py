# SPDX-License-Identifier: GPL-3.0-or-later
"""Every button and setting keeps Blender's conventions: tooltip, undo step, Python path, place, test and a row in docs/buttons.md."""
import re
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest

ROOT = Path(__file__).resolve().parents[3]
NO_UNDO = {
    "write files": "capture_scene store_view export_native export_page export_camera_path",
    "change what Blender's undo leaves out, such as the view": "frame_capture copy_diagnostics use_gpu open_guide",
    "work outside of the scene": "check_capture sync_cameras compile_kernels clear_kernels test_gpus test_training_python "
                                 "make_training_python train train_check train_pause train_resume train_stop train_forget train_report",
}
"""Operators that change nothing that can be undone, by the reason."""


@pytest.fixture
def operators(addon):
    """The registered operators by their names in bpy.ops."""
    found = {cls.bl_idname: cls for cls in bpy.types.Operator.__subclasses__() if cls.__name__.startswith("FASTGS_OT_")}
    assert len(found) > 50
    return found


def rna(name):
    module, _, function = name.partition(".")
    return getattr(getattr(bpy.ops, module), function).get_rna_type()


def texts(*folders):
    return "\n".join(path.read_text("utf-8") for folder in folders for path in sorted((ROOT / folder).rglob("*.py")))


def test_every_button_and_setting_has_a_tooltip(operators):
    for name in operators:
        properties = [p for p in rna(name).properties if p.identifier != "rna_type" and not p.is_hidden]
        assert rna(name).description and "\n" not in rna(name).description, name
        assert not [p.identifier for p in properties if not p.name or not p.description], name
    groups = [cls for cls in bpy.types.PropertyGroup.__subclasses__() if cls.__name__.startswith("FASTGS_PG_")]
    assert len(groups) >= 8
    for group in groups:
        bare = [p.identifier for p in group.bl_rna.properties if p.identifier not in ("rna_type", "name") and not p.description]
        assert not bare, (group.__name__, bare)


def test_what_changes_the_scene_can_be_undone(operators):
    without = {name for name, cls in operators.items() if 'UNDO' not in getattr(cls, "bl_options", ())}
    excused = {f"fastgs.{name}" for names in NO_UNDO.values() for name in names.split()} | {"export_scene.fastgs"}
    assert without == excused


def test_every_button_is_shown_somewhere_and_pressed_by_a_test(operators):
    shown, pressed = texts("ui", "operators"), texts("tests")
    for name in operators.keys() - {"fastgs.select"}:  # which is a click in the 3D view (tests/blender)
        assert f'"{name}"' in shown.replace(f'bl_idname = "{name}"', ""), f"no panel, menu or key has {name}"
        module, _, function = name.partition(".")
        assert re.search(rf"\b{module}\.{function}\b|\"{function}\"", pressed), f"no test calls {name}"


def test_the_documentation_lists_every_button(operators):
    """With its label, its tooltip and its Python path; the row that is missing is the message."""
    rows = (ROOT / "docs" / "buttons.md").read_text("utf-8").splitlines()
    for name, cls in operators.items():
        begin, end = f"| {cls.bl_label} |", f"| `{name}` | {rna(name).description} |"
        assert any(row.startswith(begin) and row.endswith(end) for row in rows), f"{begin} where {end}"
    listed = re.findall(r"\| `([a-z_]+\.[a-z_]+)` \|", "\n".join(rows))
    assert sorted(listed) == sorted(operators), "and nothing else"


def test_buttons_that_no_other_test_presses(module, monkeypatch):
    """Copy Diagnostics and User Guide."""
    assert bpy.ops.fastgs.copy_diagnostics() == {'FINISHED'}
    maintenance, opened = module("operators.maintenance"), []

    def path_open(filepath):
        opened.append(filepath)

    monkeypatch.setattr(maintenance, "bpy", SimpleNamespace(ops=SimpleNamespace(wm=SimpleNamespace(path_open=path_open))))
    assert bpy.ops.fastgs.open_guide() == {'FINISHED'}
    assert Path(opened[0]).is_file() and Path(opened[0]).name == "guide.md"  # in the zip: guide.html


def test_stop_asks_a_run_to_stop(module, monkeypatch):
    runs, asked = module("operators.training_runs"), []
    known, job = SimpleNamespace(ask=lambda job, what: asked.append((job.name, what))), SimpleNamespace(name="dance")
    state = SimpleNamespace(kind='TRAINING')
    monkeypatch.setattr(runs._JobOperator, "found", lambda self: (known, job, state))
    monkeypatch.setattr(runs.FASTGS_OT_train_stop, "poll", classmethod(lambda cls, context: True))
    assert bpy.ops.fastgs.train_stop() == {'FINISHED'} and asked == [("dance", 'STOP')]
    state.kind = 'FINISHED'
    with pytest.raises(RuntimeError, match="Dance.*ended"):
        bpy.ops.fastgs.train_stop()

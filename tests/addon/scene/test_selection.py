# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians that are hidden by hand: what F12 shows, what undo and .blend files keep, the operators."""
from __future__ import annotations

from types import SimpleNamespace

import bpy
import dirty_rooms
import numpy as np
import pytest


@pytest.fixture
def row(fg, model_file, add_camera, scene):
    """Ten Gaussians along x from -0.9 to 0.9, imported, before a camera 64 pixels and 4 units wide."""
    x = np.linspace(-0.9, 0.9, 10)
    model = fg.GaussianModel(
        position=np.stack([x, 0 * x, 0 * x], 1), rotation=np.tile([1.0, 0, 0, 0], (10, 1)), scale=np.full((10, 3), np.log(0.02)),
        opacity=np.full(10, 4.0), features=np.full((10, 3), 0.8), axes="RFU")
    add_camera(type='ORTHO', ortho_scale=4.0)
    scene.render.film_transparent = True
    bpy.ops.import_scene.fastgs(filepath=model_file(model))
    return bpy.context.object


def count(render):
    columns = np.flatnonzero(render()["ViewLayer.Combined"][..., 3].max(0) > 0.2)
    return int((np.diff(columns) > 1).sum() + 1) if len(columns) else 0


@pytest.fixture
def stroke(module, row, scene, now):
    """stroke(low, high, hide=True): a box over these pixels in x, in the scene's camera."""
    selection, shapes = module("scene.selection"), module("fastgs_blender.selecting.shapes")

    def go(low, high, hide=True):
        bpy.context.view_layer.update()
        sight = selection.Sight(bpy.context.evaluated_depsgraph_get(), now(scene.camera))
        return selection.erase(row, sight.under(row, shapes.Box((low, 0), (high, 48)), erased=not hide), hide)

    return go


def test_hidden_shown_inverted(row, stroke, render):
    assert count(render) == 10
    assert stroke(0, 32) == 5 and count(render) == 5
    assert stroke(0, 38) == 2 and stroke(0, 38) == 0 and count(render) == 3
    assert stroke(20, 30, hide=False) == 3 and count(render) == 6
    bpy.ops.fastgs.invert_hidden()
    assert count(render) == 4
    copy = row.copy()
    assert copy.fastgs.mask == row.fastgs.mask
    bpy.ops.fastgs.show_hidden()
    assert count(render) == 10 and not bpy.ops.fastgs.show_hidden.poll()


def test_undo_and_files_keep_it(row, stroke, tmp_path, module):
    name = row.name
    bpy.ops.ed.undo_push(message="before")
    stroke(0, 32)
    bpy.ops.ed.undo_push(message="Hide Gaussians")
    kept = row.fastgs.mask
    assert kept
    bpy.ops.ed.undo()
    assert not bpy.data.objects[name].fastgs.mask
    bpy.ops.ed.redo()
    assert bpy.data.objects[name].fastgs.mask == kept
    path = str(tmp_path / "kept.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    assert bpy.data.objects[name].fastgs.mask == kept and module("scene.selection").bits(bpy.data.objects[name], "mask").sum() == 5


def test_strokes_want_a_view(row):
    with pytest.raises(RuntimeError, match="in a 3D view"):
        bpy.ops.fastgs.select_gaussians(path=[{"name": "", "loc": (1, 1), "time": 0}])


def test_strokes_and_kinds_select(row, module, stroke, fg):
    """Strokes set, add and take away, and remember what was taken away; kinds forget the strokes and leave out what was erased."""
    selection = module("scene.selection")
    bits = lambda name="selection": np.flatnonzero(selection.bits(row, name)).tolist()  # noqa: E731
    some = lambda *rows: np.isin(np.arange(10), rows)  # noqa: E731
    assert selection.drawn(row, some(1, 2, 3), 'SET') and selection.drawn(row, some(5), 'ADD')
    assert selection.drawn(row, some(2, 8), 'SUBTRACT')
    assert (bits(), bits("wanted"), bits("refused")) == ([1, 3, 5], [1, 3, 5], [2, 8])
    assert not selection.drawn(row, some(2, 8), 'SUBTRACT')
    stroke(0, 20)  # erases two
    erased = bits("mask")
    assert erased and bpy.ops.fastgs.select_kind(kind='ALL') == {'FINISHED'}
    assert bits() == sorted(set(range(10)) - set(erased)) and not bits("wanted") and not bits("refused")
    bpy.ops.fastgs.select_kind(kind='NONE')
    assert not row.fastgs.selection and not bpy.ops.fastgs.separate.poll() and not bpy.ops.fastgs.erase.poll()
    assert bpy.ops.fastgs.select_kind(kind='MOVING') == {'FINISHED'} and not bits(), "nothing moves"
    selection.select(row, some(9))
    bpy.ops.fastgs.select_kind(kind='INVERSE')
    assert bits() == sorted(set(range(9)) - set(erased))
    bpy.ops.fastgs.select_kind(kind='COLOUR', colour=(0.8, 0.8, 0.8))
    assert len(bits()) == 10 - len(erased)
    bpy.ops.fastgs.select_kind(kind='COLOUR', colour=(0.0, 0.8, 0.8), mode='AND')
    assert not bits()
    selection.select(row, some(4, 5))
    assert bpy.ops.fastgs.erase() == {'FINISHED'} and bits("mask") == sorted([*erased, 4, 5]) and not bits()


def test_selecting_evaluates_no_mesh(row, module, monkeypatch):
    """The points that stand for Gaussians do not show what is selected, so that they are left as they are; views are drawn again."""
    selection, moved, drawn = module("scene.selection"), [], []
    monkeypatch.setattr(module("scene.splats.proxy_motion"), "_move", lambda *_: moved.append(1))
    monkeypatch.setattr(module("scene.updates"), "listeners", [lambda: drawn.append(1)])
    selection.drawn(row, np.arange(10) < 4, 'SET')
    bpy.context.view_layer.update()
    assert drawn and not moved
    assert len(module("scene.snapshot").take(bpy.context.evaluated_depsgraph_get(), rendered=False).tinted().instances) == 2
    selection.erase(row, np.arange(10) < 1)
    bpy.context.view_layer.update()
    assert moved


def test_buttons_are_drawn_again_with_the_views(module, monkeypatch):
    """What is selected has no update callback, after which Blender draws all windows again: buttons that need a selection wait for us."""
    spaces, drawn = module("engine.viewport.spaces"), []
    areas = [SimpleNamespace(type=kind, tag_redraw=lambda kind=kind: drawn.append(kind)) for kind in ('VIEW_3D', 'PROPERTIES', 'OUTLINER')]
    manager = SimpleNamespace(windows=[SimpleNamespace(screen=SimpleNamespace(areas=areas))])
    monkeypatch.setattr(spaces, "bpy", SimpleNamespace(context=SimpleNamespace(window_manager=manager),
                                                       app=SimpleNamespace(is_job_running=lambda _: True, timers=bpy.app.timers)))
    spaces.viewports.redraw()
    assert drawn == ['VIEW_3D', 'PROPERTIES']


def test_wireframe_shows_what_is_selected_and_nothing_else(row, module):
    selection, snapshot = module("scene.selection"), module("scene.snapshot")
    taken = lambda: snapshot.take(bpy.context.evaluated_depsgraph_get(), rendered=False)  # noqa: E731
    assert not taken().tinted(alone=True).instances
    selection.drawn(row, np.isin(np.arange(10), (1, 2, 3)), 'SET')
    selection.drawn(row, np.isin(np.arange(10), (3,)), 'SUBTRACT')
    bpy.context.view_layer.update()
    shown = [np.flatnonzero(~instance.hidden).tolist() for instance in taken().tinted(alone=True).load()[0]]
    assert shown == [[1, 2], [3]] and len(taken().tinted().instances) == 3


def test_only_what_is_seen_is_selected_unless_through(fg, module, model_file, add_camera, scene, now):
    """A small Gaussian behind an opaque wall of many is selected through the wall alone; a ball takes what is near its middle in space."""
    x, z = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 30), np.linspace(-1, 1, 30)))
    place = np.concatenate([np.stack([x, 0 * x, z], 1), [[0.0, 2.0, 0.0]]])
    model = fg.GaussianModel(position=place, rotation=np.tile([1.0, 0, 0, 0], (901, 1)), scale=np.full((901, 3), np.log(0.05)),
                             opacity=np.full(901, 6.0), features=np.full((901, 3), 0.5), axes="RFU")
    add_camera(type='ORTHO', ortho_scale=4.0)
    bpy.ops.import_scene.fastgs(filepath=model_file(model))
    selection, shapes, obj = module("scene.selection"), module("fastgs_blender.selecting.shapes"), bpy.context.object
    sight = selection.Sight(bpy.context.evaluated_depsgraph_get(), now(scene.camera))
    around = shapes.Box((28, 20), (36, 28))
    seen, through = (sight.under(obj, around, through) for through in (False, True))
    assert through[900] and not seen[900] and not (seen & ~through).any() and 0.8 < seen.sum() / through[:900].sum() <= 1
    ball = sight.ball((32, 24), 8)
    inside = sight.under(obj, ball)
    assert not inside[900] and np.array_equal(np.flatnonzero(inside), np.flatnonzero(np.hypot(*place[:, ::2].T) * (place[:, 1] == 0)
                                              + 9 * (place[:, 1] > 0) <= ball.radius)) and 0.45 < ball.radius < 0.55
    assert sight.ball((2, 2), 8) is None


@pytest.fixture
def dirty(fg, model_file):
    """The room of dirty_rooms.py, imported; its model."""
    model = dirty_rooms.dirty_room(fg)
    bpy.ops.import_scene.fastgs(filepath=model_file(model))
    return model


def test_clean_up_hides_what_the_library_proposes_and_its_strength_changes_it(dirty, fg, module):
    """The same Gaussians as fg.clean(), at each strength and choice of kinds; nothing at 0; selected on demand."""
    obj, selection = bpy.context.object, module("scene.selection")
    for strength in (1.0, 0.5):
        assert bpy.ops.fastgs.clean_up(strength=strength) == {'FINISHED'}
        assert np.array_equal(selection.bits(obj, "mask"), fg.clean(dirty, strength).taken) and obj.fastgs.mask
        bpy.ops.fastgs.show_hidden()
    bpy.ops.fastgs.clean_up(strength=0.0)
    assert not obj.fastgs.mask
    bpy.ops.fastgs.clean_up(strength=1.0, select=True, floaters=False, unseen=False)
    assert not obj.fastgs.mask
    assert np.array_equal(selection.bits(obj, "selection"), fg.clean(dirty, 1.0, kinds=["haze", "colours"]).taken)
    bpy.ops.fastgs.clean_up(strength=1.0, show=True)
    assert bpy.context.window_manager.fastgs.show_erased and selection.bits(obj, "mask").any()


def test_looking_at_what_was_erased_leaves_the_panel_of_clean_up(dirty, module):
    """The key's operator is no step of undo, and no other step changes what it has set."""
    bpy.ops.ed.undo_push(message="Imported")
    assert bpy.ops.fastgs.clean_up('EXEC_DEFAULT', True, strength=1.0) == {'FINISHED'}
    operator, _, told = next(entry for entry in module("ui.tools").KEYS if entry[1]["type"] == 'E')
    assert operator == "wm.context_toggle" and bpy.ops.wm.context_toggle('EXEC_DEFAULT', True, **dict(told["properties"])) == {'CANCELLED'}
    bpy.ops.ed.undo()
    assert bpy.context.window_manager.fastgs.show_erased and not bpy.context.object.fastgs.mask
    bpy.context.window_manager.fastgs.show_erased = False


def test_clean_up_leaves_other_parts_alone(dirty, fg, module):
    """An object that shows a part hides of its own Gaussians alone, for what the whole file's cameras saw."""
    obj, selection = bpy.context.object, module("scene.selection")
    selection.select(obj, np.arange(len(dirty)) % 2 == 0)
    bpy.ops.fastgs.separate()
    part = next(each for each in bpy.data.objects if each.fastgs.part and each is not obj)
    bpy.context.view_layer.objects.active = part
    bpy.ops.fastgs.clean_up(strength=1.0)
    taken = fg.clean(dirty, 1.0).taken
    assert np.array_equal(selection.bits(part, "mask"), taken & (np.arange(len(dirty)) % 2 == 0)) and not obj.fastgs.mask


def test_clean_up_of_an_object_that_shows_nothing_is_refused_at_once(dirty, module, monkeypatch):
    """Nothing is looked for where all is erased."""
    obj, selection = bpy.context.object, module("scene.selection")
    monkeypatch.setattr(module("operators.clean_up"), "clean", lambda *_, **__: pytest.fail("it has looked at pictures first"))
    selection.erase(obj, np.ones(len(dirty), bool))
    with pytest.raises(RuntimeError, match="shows none"):
        bpy.ops.fastgs.clean_up()


def test_swap_hides_no_gaussians_of_other_parts(dirty, module):
    """What is joined with an object whose erasing was swapped is shown."""
    obj, selection = bpy.context.object, module("scene.selection")
    half = np.arange(len(dirty)) % 2 == 0
    selection.select(obj, half)
    bpy.ops.fastgs.separate()
    part = bpy.context.object
    selection.erase(obj, ~half & (np.arange(len(dirty)) < 10))
    bpy.context.view_layer.objects.active = obj
    bpy.ops.fastgs.invert_hidden()
    part.select_set(True)
    assert bpy.ops.fastgs.join_parts() == {'FINISHED'}
    assert np.array_equal(selection.own(obj), half | (np.arange(len(dirty)) < 10))


@pytest.fixture
def balls(fg, make_model, model_file, add_camera, scene):
    """balls(blue=1.0): two balls of many Gaussians that touch: the first is red, blue above that height, and rises, the second green and
    at rest; [N] which are the first's, and which are blue."""
    def made(blue=1.0):
        return _balls(fg, make_model, model_file, add_camera, blue)

    return made


@pytest.fixture
def two_balls(balls):
    return balls()[:2]


def _balls(fg, make_model, model_file, add_camera, blue):
    rng, n = np.random.default_rng(8), 900
    red = np.arange(n) % 3 == 0
    place = rng.normal(size=(n, 3))
    place *= 0.5 * rng.random((n, 1)) ** (1 / 3) / np.linalg.norm(place, axis=1, keepdims=True)
    cap = red & (place[:, 2] > blue)
    model = make_model(n, position=place + np.where(red[:, None], (-0.5, 0, 0), (0.5, 0, 0)), scale=np.full((n, 3), np.log(0.04)),
                       opacity=np.full(n, 4.0), basis=fg.Polynomial(1),
                       features=np.where(cap[:, None], (0.1, 0.1, 0.9), np.where(red[:, None], (0.8, 0.1, 0.1), (0.1, 0.7, 0.1))),
                       motion=np.where(red[:, None, None], (0, 0, 0.6), (0, 0, 0)), mu_tau=np.zeros(n), clip=fg.Clip(10, 24.0), axes="RFU")
    add_camera(type='ORTHO', ortho_scale=4.0)
    bpy.ops.import_scene.fastgs(filepath=model_file(model))
    return bpy.context.object, red, cap


def test_a_stroke_grows_to_the_thing(two_balls, module, now, scene, monkeypatch):
    """Two strokes, one of them of what does not belong to it, on one frame; then the part is the ball."""
    (obj, red), selection, shapes = two_balls, module("scene.selection"), module("fastgs_blender.selecting.shapes")
    assert not bpy.ops.fastgs.grow.poll()
    sight = selection.Sight(bpy.context.evaluated_depsgraph_get(), now(scene.camera))
    for x, how in ((24, 'SET'), (40, 'SUBTRACT')):
        stroke = shapes.Stroke(((x, 22), (x, 26)), 2.0)
        selection.drawn(obj, sight.under(obj, stroke, False), how, sight.touched(obj, stroke))
    assert selection.bits(obj, "wanted")[red].any() and selection.bits(obj, "refused")[~red].any()
    assert bpy.ops.fastgs.grow() == {'FINISHED'}
    found = selection.bits(obj, "selection")
    assert (found & red).sum() / (found | red).sum() > 0.9
    assert obj.fastgs.wanted and obj.fastgs.refused  # for a further stroke
    asked = []
    monkeypatch.setattr(module("operators.grow"), "grow", lambda model, yes, no, reach: asked.append(reach) or yes)
    assert bpy.ops.fastgs.grow(reach=0.5) == {'FINISHED'} and asked == [0.5]
    selection.put(obj, selection=found)
    assert bpy.ops.fastgs.separate() == {'FINISHED'} and bpy.context.object.fastgs.gaussian_count == found.sum()
    bpy.ops.fastgs.select_kind(kind='ALL')
    assert bpy.ops.fastgs.grow(to='CONNECTED') == {'FINISHED'}
    assert selection.bits(bpy.context.object, "selection").sum() == found.sum()


def test_what_grow_is_unsure_of_is_shown_until_strokes_say(balls, module, now, scene, capfd, tmp_path):
    """A ball with a blue cap, of which a stroke goes over the red alone.  It is asked for the cap; a stroke over the cap decides it."""
    (obj, _, cap), selection, shapes = balls(blue=0.1), module("scene.selection"), module("fastgs_blender.selecting.shapes")
    snapshot = module("scene.snapshot")

    def draw(how, *pixels):
        sight, stroke = selection.Sight(bpy.context.evaluated_depsgraph_get(), now(scene.camera)), shapes.Stroke(pixels, 2.0)
        selection.drawn(obj, sight.under(obj, stroke, False), how, sight.touched(obj, stroke))

    def unsure():
        return selection.bits(bpy.context.object, "unsure")

    draw('SET', (24, 27), (24, 29))
    draw('SUBTRACT', (40, 22), (40, 26))
    assert bpy.ops.fastgs.grow() == {'FINISHED'} and unsure()[cap].mean() > 0.9 and unsure()[~cap].mean() < 0.1
    assert "1 part" in capfd.readouterr().out
    shown = snapshot.take(bpy.context.evaluated_depsgraph_get(), rendered=False).tinted(alone=True).load()[0]
    looks, marked = [instance.settings.tint for instance in shown], [~instance.hidden for instance in shown]
    assert (sum(marked) <= 1).all() and np.array_equal(marked[-2] | marked[-1], unsure()) and len(set(looks)) == 4  # one colour each
    assert not (marked[-2] & selection.bits(obj, "selection")).any() and (marked[-1] <= selection.bits(obj, "selection")).all()
    draw('SUBTRACT', (24, 17), (24, 18))
    assert 0 < unsure().sum() < cap.sum()  # the stroke shows
    assert bpy.ops.fastgs.grow() == {'FINISHED'} and not unsure().any()
    assert not (selection.bits(obj, "selection") & cap).any() and "unsure" not in capfd.readouterr().out
    for forgets in (lambda: selection.select(obj, cap), lambda: draw('SET', (24, 27), (24, 29)),
                    lambda: bpy.ops.fastgs.grow(to='CONNECTED'), lambda: bpy.ops.fastgs.select_kind(kind='NONE')):
        selection.put(obj, unsure=cap, wanted=cap, selection=cap)
        forgets()
        assert not obj.fastgs.unsure
    name, file = obj.name, str(tmp_path / "a.blend")
    bpy.ops.ed.undo_push(message="before")
    selection.put(obj, unsure=cap)
    bpy.ops.ed.undo_push(message="Grow")
    kept = obj.fastgs.unsure
    bpy.ops.ed.undo()
    assert not bpy.data.objects[name].fastgs.unsure
    bpy.ops.ed.redo()
    bpy.ops.wm.save_as_mainfile(filepath=file)
    bpy.ops.wm.open_mainfile(filepath=file)
    assert bpy.data.objects[name].fastgs.unsure == kept
